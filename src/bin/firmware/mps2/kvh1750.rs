//! The IMU KVH 1750 on a serial line. As with a UART, each byte has its interrupt.
//!
//! The host simulates the receiver, which stores the bytes with their times of arrival. One transfer fetches many
//! bytes, because a transfer costs far more time than its bytes:
//!
//! ```text
//! received  0      number of bytes that follow
//!           1-     three for each received byte: its age at the end of the last control period, u16, us, low byte
//!                  first, and then the byte itself
//! ```
//! The control periods are the clock here too. The stamp of a sample, the middle of its interval, depends on the times
//! when its bytes arrived. It does not depend on the times when they were fetched or processed.

use super::pipe_spi::{Chip, PipeBus, PipeSpi};
use super::wire::MAX_TRANSFER_BYTES;
use super::{now_us, view};
use crate::Scalar;
use embedded_hal::spi::SpiDevice;
use rins_selfcal::acquisition::Streaming;
use rins_selfcal::acquisition::queue::SampleProducer;
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::drivers::kvh1750::{Kvh1750, Kvh1750Settings};

/// Largest number of received bytes in one transfer.
const MOST_BYTES: usize = (MAX_TRANSFER_BYTES - 1) / 3;

/// The data of the IMU's interrupt.
pub struct Imu {
    receiver: PipeSpi,
    fetched: [u8; 1 + 3 * MOST_BYTES],
    /// Number of fetched bytes that have been processed.
    taken: usize,
    /// End of the control period to which the ages refer, us.
    end_us: u64,
    streaming: Streaming<'static, Scalar>,
}

impl Imu {
    /// Always succeeds, because the IMU sends without a request.
    pub fn start(bus: PipeBus, producer: SampleProducer<'static, Scalar>) -> Option<Self> {
        let streaming = Streaming::new(Kvh1750::new(&Kvh1750Settings::default()), producer);
        let receiver = bus.device(Chip::Imu);
        Some(Self { receiver, fetched: [0; 1 + 3 * MOST_BYTES], taken: 0, end_us: 0, streaming })
    }

    /// Product and serial number, if the driver knows them.
    pub fn identity(&self) -> Option<ImuIdentity> {
        self.streaming.imu().identity()
    }

    /// Processes one byte. Returns whether the interrupt must be called again for the next byte.
    pub fn on_interrupt(&mut self) -> bool {
        if self.taken >= self.count() {
            self.fetch();
        }
        if let Some((byte, came_us)) = self.next() {
            // The queue counts a lost sample, so the result is not needed.
            let _ = self.streaming.on_byte(byte, came_us, view);
        }
        // A full transfer may have left bytes at the host. If a period has ended meanwhile, its request of this
        // interrupt was lost.
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
        // No period may end between the reading of the clock and the transfer.
        let done = critical_section::with(|_| {
            self.end_us = now_us();
            self.receiver.transfer_in_place(&mut self.fetched)
        });
        if done.is_err() {
            self.fetched = [0; 1 + 3 * MOST_BYTES];
        }
    }
}
