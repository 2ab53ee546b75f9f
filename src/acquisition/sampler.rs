//! Work of the IMU interrupt (data-ready or UART): read the IMU, combine its reading with the gimbal angles at the time
//! stamp, and queue this sample with the gimbal status.

use crate::acquisition::queue::{SampleProducer, SampleWithGimbal};
use crate::base::angle::Angle;
use crate::base::linear::Real;
use crate::base::loss::LossReason;
use crate::base::sample::RawSample;
use crate::drivers::adis16495::Adis16495;
use crate::drivers::kvh1750::Kvh1750;
use crate::drivers::{ImuFault, ImuReading};
use crate::gimbal::GimbalStatus;
use embedded_hal::spi::SpiDevice;

/// Outer and inner angle at a time and the gimbal status, or the reason why an angle is missing.
pub type GimbalView = Result<([Angle; 2], GimbalStatus), LossReason>;

/// Combines readings and angles into samples, and counts the lost samples.
pub struct Sampler<'q, T: Real> {
    producer: SampleProducer<'q, T>,
}

impl<'q, T: Real> Sampler<'q, T> {
    /// A sampler that writes to the interrupt's end of the queue.
    pub fn new(producer: SampleProducer<'q, T>) -> Self {
        Self { producer }
    }

    /// Queues one sample: the reading and the angles at its time stamp, which `view_at` returns.
    ///
    /// # Errors
    /// The sample was lost for the returned reason. The loss is already counted.
    pub fn take<E>(
        &mut self,
        reading: Result<ImuReading<T>, ImuFault<E>>,
        view_at: impl FnOnce(u64) -> GimbalView,
    ) -> Result<(), LossReason> {
        match self.observed(reading, view_at) {
            Ok(observed) => self.producer.push(observed),
            Err(loss) => {
                self.producer.count(loss, 1);
                Err(loss)
            }
        }
    }

    fn observed<E>(
        &mut self,
        reading: Result<ImuReading<T>, ImuFault<E>>,
        view_at: impl FnOnce(u64) -> GimbalView,
    ) -> Result<SampleWithGimbal<T>, LossReason> {
        let ImuReading { time_us, missed, omega_g, force_a, temperature_c } = reading.map_err(loss_of)?;
        self.producer.count(LossReason::Unread, missed);
        let ([outer, inner], gimbal) = view_at(time_us)?;
        Ok(SampleWithGimbal { sample: RawSample { time_us, omega_g, force_a, outer, inner, temperature_c }, gimbal })
    }
}

/// An IMU with a data-ready line, and the sampler that queues its readings.
pub struct Acquisition<'q, T: Real, S> {
    imu: Adis16495<S>,
    sampler: Sampler<'q, T>,
}

impl<'q, T: Real, S: SpiDevice> Acquisition<'q, T, S> {
    /// Connects the IMU to the queue.
    pub fn new(imu: Adis16495<S>, producer: SampleProducer<'q, T>) -> Self {
        Self { imu, sampler: Sampler::new(producer) }
    }

    /// Reads the IMU and queues the sample. Call this function once for every data-ready edge, with the time of the
    /// edge. It makes one bus transfer and does not wait.
    ///
    /// # Errors
    /// The sample was lost for the returned reason. The loss is already counted.
    pub fn on_data_ready(&mut self, edge_us: u64, view_at: impl FnOnce(u64) -> GimbalView) -> Result<(), LossReason> {
        self.sampler.take(self.imu.read(edge_us), view_at)
    }
}

/// An IMU that sends by itself, and the sampler that queues its readings. Use it in the UART interrupt of the IMU:
///
/// ```
/// use rins_selfcal::acquisition::{Streaming, GimbalView};
/// use rins_selfcal::drivers::kvh1750::{Kvh1750, Kvh1750Settings};
/// use rins_selfcal::acquisition::queue::SampleQueue;
///
/// # fn received() -> [u8; 3] { [0xfe, 0x81, 0xff] }
/// # fn now_us() -> u64 { 0 }
/// # fn view_at(_: u64) -> GimbalView { Err(rins_selfcal::base::loss::LossReason::Status) }
/// let mut queue = SampleQueue::<f64, 64>::new();
/// let (producer, samples) = queue.split();
/// let mut streaming = Streaming::new(Kvh1750::new(&Kvh1750Settings::default()), producer);
/// // In the UART interrupt; `view_at` calls `Control::view`.
/// for byte in received() {
///     streaming.on_byte(byte, now_us(), view_at);
/// }
/// # assert!(samples.is_empty());
/// ```
pub struct Streaming<'q, T: Real> {
    imu: Kvh1750,
    sampler: Sampler<'q, T>,
}

impl<'q, T: Real> Streaming<'q, T> {
    /// Connects the IMU to the queue.
    pub fn new(imu: Kvh1750, producer: SampleProducer<'q, T>) -> Self {
        Self { imu, sampler: Sampler::new(producer) }
    }

    /// Takes one byte, received at `now_us`. The last byte of a message returns the outcome of its sample; if the
    /// sample was lost, the loss is already counted.
    pub fn on_byte(
        &mut self,
        byte: u8,
        now_us: u64,
        view_at: impl FnOnce(u64) -> GimbalView,
    ) -> Option<Result<(), LossReason>> {
        self.imu.push(byte, now_us).map(|reading| self.sampler.take(reading, view_at))
    }

    /// Driver of the IMU.
    pub fn imu(&self) -> &Kvh1750 {
        &self.imu
    }
}

fn loss_of<E>(fault: ImuFault<E>) -> LossReason {
    match fault {
        ImuFault::Bus(_) => LossReason::Bus,
        ImuFault::NoAnswer | ImuFault::Crc => LossReason::Crc,
        ImuFault::Status(_) => LossReason::Status,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::queue::SampleQueue;
    use crate::base::linear::Vector3;
    use crate::base::loss::LossCounts;
    use crate::gimbal::TurnState;
    use core::convert::Infallible;

    type Read = Result<ImuReading<f64>, ImuFault<Infallible>>;

    const STATUS: GimbalStatus = GimbalStatus {
        time_us: 17_000,
        commands: 3,
        arrived: true,
        at_rest: true,
        move_us: 5,
        turns: [TurnState::Known; 2],
        fault: None,
    };

    fn reading(time_us: u64, missed: u32) -> Read {
        let (omega_g, force_a) = (Vector3::new(1.0, 2.0, 3.0), Vector3::new(4.0, 5.0, 6.0));
        Ok(ImuReading { time_us, missed, omega_g, force_a, temperature_c: 21.0 })
    }

    /// Takes each reading with its angles. Returns the outcomes, the queued samples and the counters.
    fn run(
        readings: &[(Read, Result<u32, LossReason>)],
    ) -> (Vec<Result<(), LossReason>>, Vec<SampleWithGimbal<f64>>, LossCounts) {
        let mut queue = SampleQueue::<f64, 8>::new();
        let (producer, mut consumer) = queue.split();
        let mut sampler = Sampler::new(producer);
        let view = |ticks| ([Angle::from_ticks(ticks), Angle::from_ticks(2)], STATUS);
        let outcomes = readings.iter().map(|(reading, outer)| sampler.take(*reading, |_| outer.map(view))).collect();
        (outcomes, core::iter::from_fn(|| consumer.pop()).collect(), consumer.losses())
    }

    #[test]
    fn a_sample_joins_reading_and_angles() {
        let (outcomes, samples, losses) = run(&[(reading(15_000, 0), Ok(7))]);
        let RawSample { time_us, omega_g, force_a, outer, inner, temperature_c } = samples[0].sample;
        assert_eq!((outcomes[0], time_us, outer.ticks(), inner.ticks(), temperature_c), (Ok(()), 15_000, 7, 2, 21.0));
        assert_eq!((omega_g, force_a), (Vector3::new(1.0, 2.0, 3.0), Vector3::new(4.0, 5.0, 6.0)));
        assert_eq!((samples[0].gimbal, losses), (STATUS, LossCounts::default()));
    }

    #[test]
    fn the_angles_are_those_of_the_stamp() {
        let mut queue = SampleQueue::<f64, 8>::new();
        let mut sampler = Sampler::new(queue.split().0);
        let mut asked = 0;
        let taken = sampler.take(reading(4321, 0), |time_us| {
            asked = time_us;
            Ok(([Angle::default(); 2], STATUS))
        });
        assert_eq!((taken, asked), (Ok(()), 4321));
    }

    #[test]
    fn every_missing_sample_is_counted_once() {
        let readings = [
            (Err(ImuFault::Crc), Ok(1)),
            (Err(ImuFault::NoAnswer), Ok(1)),
            (Err(ImuFault::Status(4)), Ok(1)),
            (reading(0, 3), Ok(1)),
            (reading(1, 1), Err(LossReason::Crc)),
            (reading(2, 0), Err(LossReason::Status)),
        ];
        let (outcomes, samples, losses) = run(&readings);
        assert_eq!(samples.len(), 1);
        assert_eq!(losses, LossCounts { crc: 3, status: 2, unread: 4, bus: 0, overrun: 0 });
        assert_eq!(outcomes[5], Err(LossReason::Status));
    }
}
