//! What the data-ready interrupt does: read the IMU and both encoders, make one raw sample of them, queue it.
//!
//! The encoders latch their position when they are asked, and here they are asked at the edge. Their angles belong to the
//! sample's stamp only if they hold what they latched then; where they are read at times of their own, take the angles
//! from an [`AngleHistory`](crate::angle_history::AngleHistory).

use crate::angle::Angle;
use crate::drivers::adis16495::Adis16495;
use crate::drivers::biss::{BissEncoder, EncoderFault};
use crate::drivers::{ImuFault, ImuReading};
use crate::linear::Real;
use crate::queue::{Loss, SampleProducer};
use crate::sample::RawSample;
use embedded_hal::spi::SpiDevice;

/// Makes samples of readings and angles, and accounts for those that are lost.
pub struct Sampler<'q, T: Real> {
    producer: SampleProducer<'q, T>,
}

impl<'q, T: Real> Sampler<'q, T> {
    /// With the interrupt's end of the queue.
    pub fn new(producer: SampleProducer<'q, T>) -> Self {
        Self { producer }
    }

    /// Queues the sample of a reading with the angles of (outer, inner) at its stamp, for which `angles_at` is asked.
    ///
    /// # Errors
    /// There is no sample, and the queue has counted the reason.
    pub fn take<E>(
        &mut self,
        reading: Result<ImuReading<T>, ImuFault<E>>,
        angles_at: impl FnOnce(u64) -> Result<[Angle; 2], Loss>,
    ) -> Result<(), Loss> {
        match self.sample(reading, angles_at) {
            Ok(sample) => self.producer.push(sample),
            Err(loss) => {
                self.producer.count(loss, 1);
                Err(loss)
            }
        }
    }

    fn sample<E>(
        &mut self,
        reading: Result<ImuReading<T>, ImuFault<E>>,
        angles_at: impl FnOnce(u64) -> Result<[Angle; 2], Loss>,
    ) -> Result<RawSample<T>, Loss> {
        let ImuReading { time_us, missed, omega_g, force_a, temperature_c } = reading.map_err(of_imu)?;
        self.producer.count(Loss::Unread, missed);
        let [outer, inner] = angles_at(time_us)?;
        Ok(RawSample { time_us, omega_g, force_a, outer, inner, temperature_c })
    }
}

/// The devices that measure, read at the data-ready edge.
pub struct Acquisition<'q, T: Real, S, O, I> {
    imu: Adis16495<S>,
    outer: BissEncoder<O>,
    inner: BissEncoder<I>,
    sampler: Sampler<'q, T>,
}

impl<'q, T: Real, S: SpiDevice, O: SpiDevice, I: SpiDevice> Acquisition<'q, T, S, O, I> {
    /// Puts the devices together.
    pub fn new(
        imu: Adis16495<S>,
        outer: BissEncoder<O>,
        inner: BissEncoder<I>,
        producer: SampleProducer<'q, T>,
    ) -> Self {
        Self { imu, outer, inner, sampler: Sampler::new(producer) }
    }

    /// Reads the three devices and queues the sample: call it once for every data-ready edge, with its time. It takes
    /// three transfers and does not wait.
    ///
    /// # Errors
    /// There is no sample, and the queue has counted the reason.
    pub fn on_data_ready(&mut self, edge_us: u64) -> Result<(), Loss> {
        let Self { imu, outer, inner, sampler } = self;
        sampler.take(imu.read(edge_us), |_| Ok([outer.read().map_err(of_encoder)?, inner.read().map_err(of_encoder)?]))
    }
}

fn of_imu<E>(fault: ImuFault<E>) -> Loss {
    match fault {
        ImuFault::Bus(_) => Loss::Bus,
        ImuFault::NoAnswer | ImuFault::Crc => Loss::Crc,
        ImuFault::Status(_) => Loss::Status,
    }
}

fn of_encoder<E>(fault: EncoderFault<E>) -> Loss {
    match fault {
        EncoderFault::Bus(_) => Loss::Bus,
        EncoderFault::Framing | EncoderFault::Crc => Loss::Crc,
        EncoderFault::NoAnswer | EncoderFault::NotReady | EncoderFault::Error => Loss::Status,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linear::Vector3;
    use crate::queue::{Losses, SampleQueue};
    use core::convert::Infallible;

    type Read = Result<ImuReading<f64>, ImuFault<Infallible>>;

    fn reading(time_us: u64, missed: u32) -> Read {
        let (omega_g, force_a) = (Vector3::new(1.0, 2.0, 3.0), Vector3::new(4.0, 5.0, 6.0));
        Ok(ImuReading { time_us, missed, omega_g, force_a, temperature_c: 21.0 })
    }

    /// Takes the readings, each with the angles that belong to it; outcomes, samples and losses.
    fn run(readings: &[(Read, Result<u32, Loss>)]) -> (Vec<Result<(), Loss>>, Vec<RawSample<f64>>, Losses) {
        let mut queue = SampleQueue::<f64, 8>::new();
        let (producer, mut consumer) = queue.split();
        let mut sampler = Sampler::new(producer);
        let angles = |ticks| [Angle::from_ticks(ticks), Angle::from_ticks(2)];
        let outcomes = readings.iter().map(|(reading, outer)| sampler.take(*reading, |_| outer.map(angles))).collect();
        (outcomes, core::iter::from_fn(|| consumer.pop()).collect(), consumer.losses())
    }

    #[test]
    fn a_sample_joins_reading_and_angles() {
        let (outcomes, samples, losses) = run(&[(reading(15_000, 0), Ok(7))]);
        let RawSample { time_us, omega_g, force_a, outer, inner, temperature_c } = samples[0];
        assert_eq!((outcomes[0], time_us, outer.ticks(), inner.ticks(), temperature_c), (Ok(()), 15_000, 7, 2, 21.0));
        assert_eq!((omega_g, force_a), (Vector3::new(1.0, 2.0, 3.0), Vector3::new(4.0, 5.0, 6.0)));
        assert_eq!(losses, Losses::default());
    }

    #[test]
    fn the_angles_are_those_of_the_stamp() {
        let mut queue = SampleQueue::<f64, 8>::new();
        let mut sampler = Sampler::new(queue.split().0);
        let mut asked = 0;
        let taken = sampler.take(reading(4321, 0), |time_us| {
            asked = time_us;
            Ok([Angle::default(); 2])
        });
        assert_eq!((taken, asked), (Ok(()), 4321));
    }

    #[test]
    fn every_missing_sample_is_counted_once() {
        let encoder = |fault: EncoderFault<Infallible>| Err(of_encoder(fault));
        let readings = [
            (Err(ImuFault::Crc), Ok(1)),
            (Err(ImuFault::NoAnswer), Ok(1)),
            (Err(ImuFault::Status(4)), Ok(1)),
            (reading(0, 3), Ok(1)),
            (reading(1, 1), encoder(EncoderFault::Crc)),
            (reading(2, 0), encoder(EncoderFault::Error)),
        ];
        let (outcomes, samples, losses) = run(&readings);
        assert_eq!(samples.len(), 1);
        assert_eq!(losses, Losses { crc: 3, status: 2, unread: 4, bus: 0, overrun: 0 });
        assert_eq!(outcomes[5], Err(Loss::Status));
    }
}
