//! The IMU KVH 1750 on a serial line: an interrupt for each byte, as of a UART.
//!
//! The receiver, played by the host, keeps the bytes with the times at which they came. It is emptied by transfers, since one
//! costs far more than what is in it:
//!
//! ```text
//! received  0      how many bytes follow
//!           1-     three for each: its age at the end of the last control period, u16, us, low byte first, and the byte
//! ```
//! The control periods are the clock here too: what a sample is stamped with, the middle of its interval, depends on when its
//! bytes came, and not on when they were fetched or taken in.

use super::pipe_spi::{Chip, PipeBus, PipeSpi};
use super::wire::MAX_TRANSFER_BYTES;
use super::{now_us, view};
use crate::Scalar;
use embedded_hal::spi::SpiDevice;
use rins_selfcal::acquisition::Streaming;
use rins_selfcal::acquisition::queue::SampleProducer;
use rins_selfcal::drivers::kvh1750::{Kvh1750, Kvh1750Settings};

/// Most bytes of the line to a transfer.
const MOST_BYTES: usize = (MAX_TRANSFER_BYTES - 1) / 3;

/// What the IMU's interrupt has.
pub struct Imu {
    receiver: PipeSpi,
    fetched: [u8; 1 + 3 * MOST_BYTES],
    /// How many of the fetched bytes have been taken in.
    taken: usize,
    /// End of the control period at which the ages are counted, us.
    end_us: u64,
    streaming: Streaming<'static, Scalar>,
}

impl Imu {
    /// The IMU sends by itself: nothing can fail here.
    pub fn start(bus: PipeBus, producer: SampleProducer<'static, Scalar>) -> Option<Self> {
        let streaming = Streaming::new(Kvh1750::new(&Kvh1750Settings::default()), producer);
        let receiver = bus.device(Chip::Imu);
        Some(Self { receiver, fetched: [0; 1 + 3 * MOST_BYTES], taken: 0, end_us: 0, streaming })
    }

    /// Takes in one byte; whether to come again, for the next.
    pub fn on_interrupt(&mut self) -> bool {
        if self.taken >= self.count() {
            self.fetch();
        }
        if let Some((byte, came_us)) = self.next() {
            // A sample that is lost has been counted.
            let _ = self.streaming.on_byte(byte, came_us, view);
        }
        // A full transfer may have left some behind, and a period that has ended meanwhile has asked in vain.
        self.taken < self.count() || self.count() == MOST_BYTES || now_us() != self.end_us
    }

    fn count(&self) -> usize {
        let [count, ..] = self.fetched;
        usize::from(count).min(MOST_BYTES)
    }

    fn next(&mut self) -> Option<(u8, u64)> {
        let [_, received @ ..] = &self.fetched;
        let [low, high, byte] = received.as_chunks().0.iter().take(self.count()).nth(self.taken)?;
        self.taken += 1;
        Some((*byte, self.end_us.saturating_sub(u16::from_le_bytes([*low, *high]).into())))
    }

    fn fetch(&mut self) {
        self.taken = 0;
        // No period ends between the look at the clock and that of the host.
        let done = critical_section::with(|_| {
            self.end_us = now_us();
            self.receiver.transfer_in_place(&mut self.fetched)
        });
        if done.is_err() {
            self.fetched = [0; 1 + 3 * MOST_BYTES];
        }
    }
}
