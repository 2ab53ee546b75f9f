//! What the data-ready interrupt does: read the IMU and both encoders, make one raw sample of them, queue it.

use crate::device::{DeviceError, Encoder, Imu};
use crate::linear::Real;
use crate::queue::{Loss, SampleProducer};
use crate::sample::RawSample;
use embedded_hal::spi::SpiDevice;

/// Outcome of one data-ready edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Acquired {
    /// A sample is in the queue.
    Sample,
    /// There is no sample, and the queue has counted the reason.
    Lost(Loss),
    /// The instrument is switched off; there is nothing to count.
    PoweredOff,
}

/// The devices that measure, and the interrupt's end of the queue.
pub struct Acquisition<'q, T: Real, S, O, I> {
    imu: Imu<S>,
    outer: Encoder<O>,
    inner: Encoder<I>,
    producer: SampleProducer<'q, T>,
    /// Sample number the IMU shall report next; `None` before the first.
    next_count: Option<u32>,
}

impl<'q, T: Real, S: SpiDevice, O: SpiDevice, I: SpiDevice> Acquisition<'q, T, S, O, I> {
    /// Puts the devices together.
    pub fn new(imu: Imu<S>, outer: Encoder<O>, inner: Encoder<I>, producer: SampleProducer<'q, T>) -> Self {
        Self { imu, outer, inner, producer, next_count: None }
    }

    /// Reads the three devices and queues the sample: call it once for every data-ready edge. It takes three transfers
    /// and does not wait.
    pub fn on_data_ready(&mut self) -> Acquired {
        match self.read() {
            Ok(sample) => self.producer.push(sample).map_or_else(Acquired::Lost, |()| Acquired::Sample),
            Err(None) => Acquired::PoweredOff,
            Err(Some(loss)) => {
                self.producer.count(loss, 1);
                Acquired::Lost(loss)
            }
        }
    }

    fn read(&mut self) -> Result<RawSample<T>, Option<Loss>> {
        let reading = self.imu.read().map_err(loss);
        self.count_unread(reading.as_ref().ok().map(|imu| imu.count));
        let imu = reading?;
        let outer = self.outer.read().map_err(loss)?;
        let inner = self.inner.read().map_err(loss)?;
        let (time_us, temperature_c) = (imu.time_us, imu.temperature_c);
        Ok(RawSample { time_us, omega_g: imu.omega_g, force_a: imu.force_a, outer, inner, temperature_c })
    }

    /// Compares the IMU's sample number with the expected one. A failed read is one edge, and counted by its own reason.
    fn count_unread(&mut self, count: Option<u32>) {
        if let (Some(count), Some(expected)) = (count, self.next_count) {
            // A number from the past is an IMU that restarted: nothing is known to be missing.
            let unread = u32::try_from(count.wrapping_sub(expected).cast_signed()).unwrap_or(0);
            self.producer.count(Loss::Unread, unread);
        }
        self.next_count = count.or(self.next_count).map(|count| count.wrapping_add(1));
    }
}

/// The reason to count; none for an instrument that is switched off.
fn loss<E>(error: DeviceError<E>) -> Option<Loss> {
    match error {
        DeviceError::Bus(_) => Some(Loss::Bus),
        DeviceError::Crc => Some(Loss::Crc),
        DeviceError::Status(_) => Some(Loss::Status),
        DeviceError::PoweredOff => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::Angle;
    use crate::device::{CRC_IMU, CRC_SHORT, STATUS_OK, STATUS_POWERED_OFF};
    use crate::queue::{Losses, SampleQueue};
    use embedded_hal::spi::{ErrorKind, ErrorType, Operation};
    use std::collections::VecDeque;

    /// Answers each transfer with the next frame; an empty one is a fault of the bus.
    struct Script(VecDeque<Vec<u8>>);

    impl ErrorType for Script {
        type Error = ErrorKind;
    }

    impl SpiDevice for Script {
        fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
            let [Operation::TransferInPlace(frame)] = operations else { panic!("one transfer") };
            let answer = self.0.pop_front().filter(|answer| !answer.is_empty()).ok_or(ErrorKind::Other)?;
            frame.copy_from_slice(&answer);
            Ok(())
        }
    }

    fn imu(status: u8, count: u32) -> Vec<u8> {
        let mut frame = vec![0, status];
        frame.extend((u64::from(count) * 5000).to_le_bytes());
        frame.extend(count.to_le_bytes());
        frame.extend([0; 52]);
        frame.extend(CRC_IMU.checksum(&frame[1..]).to_le_bytes());
        frame
    }

    fn encoder(ticks: u32) -> Vec<u8> {
        let mut frame = vec![0, STATUS_OK];
        frame.extend(ticks.to_le_bytes());
        frame.push(CRC_SHORT.checksum(&frame[1..]));
        frame
    }

    fn damaged(mut frame: Vec<u8>) -> Vec<u8> {
        frame[4] ^= 0x10;
        frame
    }

    /// Runs one edge per IMU frame and returns outcomes, samples and losses.
    fn run(imus: &[Vec<u8>], outers: &[Vec<u8>]) -> (Vec<Acquired>, Vec<RawSample<f64>>, Losses) {
        let mut queue = SampleQueue::<f64, 8>::new();
        let (producer, mut consumer) = queue.split();
        let script = |frames: &[Vec<u8>]| Script(frames.iter().cloned().collect());
        let inner = script(&vec![encoder(2); imus.len()]);
        let (imu, outer, inner) = (Imu::new(script(imus)), Encoder::new(script(outers)), Encoder::new(inner));
        let mut acquisition = Acquisition::new(imu, outer, inner, producer);
        let outcomes = imus.iter().map(|_| acquisition.on_data_ready()).collect();
        (outcomes, core::iter::from_fn(|| consumer.pop()).collect(), consumer.losses())
    }

    #[test]
    fn a_sample_joins_the_three_devices() {
        let (outcomes, samples, losses) = run(&[imu(STATUS_OK, 3)], &[encoder(1)]);
        assert_eq!(outcomes, [Acquired::Sample]);
        assert_eq!((samples[0].time_us, samples[0].outer, samples[0].inner.ticks()), (15_000, Angle::from_ticks(1), 2));
        assert_eq!(losses, Losses::default());
    }

    #[test]
    fn every_missing_sample_is_counted_once() {
        let imus =
            [imu(STATUS_OK, 0), damaged(imu(STATUS_OK, 1)), vec![], imu(7, 3), imu(STATUS_OK, 6), imu(STATUS_OK, 7)];
        let outers = [encoder(1), damaged(encoder(1)), encoder(1)];
        let (outcomes, samples, losses) = run(&imus, &outers);
        assert_eq!(samples.iter().map(|sample| sample.time_us / 5000).collect::<Vec<_>>(), [0, 7]);
        assert_eq!(losses, Losses { crc: 2, bus: 1, status: 1, unread: 2, overrun: 0 });
        assert_eq!(outcomes[4], Acquired::Lost(Loss::Crc));
    }

    #[test]
    fn a_restarted_imu_is_not_a_loss() {
        let (_, samples, losses) = run(&[imu(STATUS_OK, 500), imu(STATUS_OK, 0)], &[encoder(1), encoder(1)]);
        assert_eq!((samples.len(), losses.total()), (2, 0));
    }

    #[test]
    fn powered_off_is_not_a_loss() {
        let (outcomes, samples, losses) = run(&[imu(STATUS_POWERED_OFF, 0)], &[]);
        assert_eq!((outcomes, samples.len(), losses.total()), (vec![Acquired::PoweredOff], 0, 0));
    }
}
