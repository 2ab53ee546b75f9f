//! The main loop of the instrument, from power-up on.

use super::commands::{Reply, carry_out, status};
use super::motion_log::MotionLog;
use super::startup::Startup;
use super::surroundings::{Archive, Done, FoundRecord, Surroundings};
use super::tell::tell;
use crate::acquisition::queue::SampleWithGimbal;
use crate::base::clock_check::ClockFault;
use crate::base::linear::Real;
use crate::base::sample::SampleStatus;
use crate::estimator::MAX_SEGMENTS;
use crate::gimbal::{GimbalStatus, MotionCommand};
use crate::keep::store::{Piece, Wanted};
use crate::link::{Answer, Hello, Link, Refusal};
use crate::run::abort::AbortReason;
use crate::run::calibrator::Calibrator;
use crate::run::config::ConfigError;
use crate::run::result::StoredCalibration;
use crate::run::self_calibration::{SelfCalibration, prepare};
use crate::run::telemetry::Message;
use crate::run::unit::UnitName;

/// Largest number of received bytes that one turn of the main loop processes: what the fastest line brings in 5 ms.
const BYTES_PER_TURN: usize = 512;

/// A dual-axis RINS from power-up to power-off. The caller owns the memory of link and calibrator; on a board they are
/// statics.
///
/// ```
/// use rins_selfcal::acquisition::queue::SampleWithGimbal;
/// use rins_selfcal::base::angle::Angle;
/// use rins_selfcal::base::linear::Vector3;
/// use rins_selfcal::base::loss::LossCounts;
/// use rins_selfcal::base::restart::Restart;
/// use rins_selfcal::base::sample::{CorrectedSample, RawSample, SampleStatus};
/// use rins_selfcal::gimbal::axis::AxisLimits;
/// use rins_selfcal::gimbal::servo::MotorAndLoad;
/// use rins_selfcal::gimbal::travel::LocateError;
/// use rins_selfcal::gimbal::{GimbalStatus, MotionCommand};
/// use rins_selfcal::instrument::{
///     Archive, Axes, CorrectedSink, Events, Instrument, SerialLine, Startup, Surroundings, Telemetry,
/// };
/// use rins_selfcal::keep::medium::Eeprom;
/// use rins_selfcal::keep::store::CalibrationStore;
/// use rins_selfcal::link::Link;
/// use rins_selfcal::run::assignment::Assignment;
/// use rins_selfcal::run::calibrator::Calibrator;
/// # use embedded_storage::{ReadStorage, Storage};
/// # #[derive(Debug)] struct Memory([u8; 8192]);
/// # impl ReadStorage for Memory {
/// #     type Error = core::convert::Infallible;
/// #     fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
/// #         bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
/// #         Ok(())
/// #     }
/// #     fn capacity(&self) -> usize { self.0.len() }
/// # }
/// # impl Storage for Memory {
/// #     fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
/// #         self.0[offset as usize..][..bytes.len()].copy_from_slice(bytes);
/// #         Ok(())
/// #     }
/// # }
///
/// /// A board in a test: its samples, its gimbal, its memory, and the number of corrected samples that it received.
/// struct TestBoard {
///     samples: Vec<RawSample<f64>>,
///     gimbal: GimbalStatus,
///     commands: Vec<MotionCommand>,
///     store: CalibrationStore<Eeprom<Memory>>,
///     corrected: usize,
/// }
///
/// impl Axes for TestBoard {
///     fn status(&mut self) -> GimbalStatus { self.gimbal }
///     fn command(&mut self, motion: MotionCommand, _seen_us: u64) {
///         self.gimbal.commands += 1;
///         self.commands.push(motion);
///     }
///     fn reconfigure(&mut self, _axes: &[AxisLimits; 2], _motors: &[MotorAndLoad; 2]) {}
///     fn angles_rad(&mut self) -> [Option<f64>; 2] { [Some(0.0); 2] }
///     fn locate(&mut self, _angles_rad: [Option<f64>; 2], _tolerance_rad: f64) -> Result<(), LocateError> { Ok(()) }
/// }
/// impl CorrectedSink<f64> for TestBoard {
///     fn take(&mut self, _sample: &CorrectedSample<f64>, _angles: [Angle; 2], _status: SampleStatus) { self.corrected += 1; }
/// }
/// impl Events for TestBoard {}
/// impl Telemetry for TestBoard {}
/// impl SerialLine for TestBoard {}
/// impl Surroundings<f64> for TestBoard {
///     fn now_us(&self) -> u64 { 0 }
///     fn next_sample(&mut self) -> Option<SampleWithGimbal<f64>> {
///         self.samples.pop().map(|sample| SampleWithGimbal { sample, gimbal: self.gimbal })
///     }
///     fn losses(&mut self) -> LossCounts { LossCounts::default() }
///     fn archive(&mut self) -> &mut impl Archive { &mut self.store }
/// }
///
/// let Assignment::SelfCalibrate(config) = Assignment::default() else { unreachable!() };
/// let sample = |number: u64| RawSample {
///     time_us: 5000 * number,
///     force_a: Vector3::new(0.0, 0.0, 9.79),
///     ..RawSample::default()
/// };
/// let mut board = TestBoard {
///     samples: (1..=300).rev().map(sample).collect(),
///     gimbal: GimbalStatus { at_rest: true, arrived: true, ..GimbalStatus::default() },
///     commands: Vec::new(),
///     store: CalibrationStore::new(Eeprom(Memory([0xff; 8192]))),
///     corrected: 0,
/// };
/// let (mut link, mut calibrator) = (Link::new(), Box::new(Calibrator::UNCONFIGURED));
/// let mut startup = Startup::assigned(config, Restart::PowerOn);
/// let mut instrument = Instrument::<f64>::power_up(&mut startup, &mut link, &mut calibrator, &mut board)?;
/// instrument.turn(&mut board);
/// // The axes are held until base and axes have been at rest for a second. Then they move to the start of the scheme.
/// assert_eq!(board.commands[0], MotionCommand::Hold);
/// assert!(matches!(board.commands.last(), Some(MotionCommand::MoveTo { angles_rad: [0.0, 0.0], .. })));
/// // Nothing is stored yet, so no sample is corrected.
/// assert_eq!((instrument.samples(), board.corrected), (300, 0));
/// # Ok::<(), rins_selfcal::run::config::ConfigError>(())
/// ```
#[derive(Debug)]
pub struct Instrument<'m, T: Real> {
    run: SelfCalibration<'m, T>,
    link: &'m mut Link,
    samples: u64,
    motion_log: MotionLog,
    /// Number of samples that were refused because the IMU had restarted.
    restarted: u32,
    /// The name of the unit in the archive.
    unit: Option<UnitName>,
    /// The number of the command that waits for a record, and the record.
    reading: Option<(u16, Wanted)>,
}

impl<'m, T: Real> Instrument<'m, T> {
    /// The sequence at power-up: the link reports what the instrument is, the archive is searched, the reason of the
    /// start is reported, and the configuration is checked. A stored configuration that is refused is replaced in
    /// `startup`, and the unit is then not commissioned. Nothing moves before the first [`Self::turn`].
    ///
    /// # Errors
    /// What is wrong with an assigned configuration. The refusal has already been reported.
    #[inline(never)]
    pub fn power_up(
        startup: &'m mut Startup,
        link: &'m mut Link,
        calibrator: &'m mut Calibrator<T, MAX_SEGMENTS>,
        outside: &mut impl Surroundings<T>,
    ) -> Result<Self, ConfigError> {
        link.greet(Hello::new::<T>());
        let stored = load(link, outside);
        let unit = unit_name(outside);
        tell(link, outside, &Message::Restarted(startup.restart().clone()));
        while let Err(error) = prepare(startup.config(), calibrator) {
            tell(link, outside, &Message::Refused(error));
            if !startup.replace_refused() {
                return Err(error);
            }
        }
        Ok(Self::ready(startup, (stored.as_ref(), unit, outside.clock_fault()), link, calibrator))
    }

    /// The instrument with a configuration that is checked. Not inlined, so that the check does not need its stack.
    #[inline(never)]
    fn ready(
        startup: &'m mut Startup,
        (stored, unit, clock): (Option<&StoredCalibration>, Option<UnitName>, Option<ClockFault>),
        link: &'m mut Link,
        calibrator: &'m mut Calibrator<T, MAX_SEGMENTS>,
    ) -> Self {
        let lock = startup.motion_lock();
        let mut run = SelfCalibration::prepared(startup.config_mut(), stored, calibrator);
        if let Some(lock) = lock {
            run.lock_motion(lock);
        }
        run.note_clock(clock);
        Self { run, link, samples: 0, motion_log: MotionLog::default(), restarted: 0, unit, reading: None }
    }

    /// One turn of the main loop: processes all waiting samples, then checks the clock, then answers the received
    /// commands. Call it as often as samples arrive, and at least ten times a second. It never waits.
    pub fn turn(&mut self, outside: &mut impl Surroundings<T>) {
        while let Some(observed) = outside.next_sample() {
            let during = self.run.state();
            let ends_segment = self.sample(&observed, outside);
            outside.done(Done::Sample { during, ends_segment });
            if self.run.refine(&mut |message| tell(self.link, outside, message)) {
                outside.done(Done::Refinement);
            }
            // A backlog of samples gives more frames than the outbox holds.
            outside.transmit(self.link);
        }
        self.tick(outside);
        self.serve(outside);
        outside.transmit(self.link);
    }

    /// The last turn, at power-off: reports how many samples were taken and how many are missing.
    #[inline(never)]
    pub fn power_off(&mut self, outside: &mut impl Surroundings<T>) {
        let losses = outside.losses();
        tell(self.link, outside, &Message::Queue { samples: self.samples, losses });
    }

    /// Number of samples taken since power-up.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// The calibration run.
    pub fn run(&self) -> &SelfCalibration<'m, T> {
        &self.run
    }

    /// Processes a sample. Returns whether it has ended a segment.
    fn sample(
        &mut self,
        SampleWithGimbal { sample, gimbal }: &SampleWithGimbal<T>,
        outside: &mut impl Surroundings<T>,
    ) -> bool {
        if self.samples == 0 {
            self.run.identify_imu(outside.imu());
        }
        self.samples += 1;
        let step = self.run.step(sample, gimbal, &mut |message| tell(self.link, outside, message));
        self.command(step.motion, gimbal, outside);
        if let Some(corrected) = &step.corrected {
            let status = self.sample_status(gimbal, step.after_gap);
            let angles = [sample.outer, sample.inner];
            self.link.take(corrected, angles, status);
            outside.take(corrected, angles, status);
        }
        if step.note
            && let Some(record) = self.run.record()
        {
            // If the record of a rejected run cannot be stored, it is missing in the history only.
            outside.archive().save(&record);
        }
        if step.save {
            self.save(outside);
        }
        step.ends_segment
    }

    fn sample_status(&self, gimbal: &GimbalStatus, after_gap: bool) -> SampleStatus {
        SampleStatus::NONE
            .with(SampleStatus::CALIBRATED_NOW, self.run.has_calibrated())
            .with(SampleStatus::RUN_UNDER_WAY, self.run.state().is_under_way())
            .with(SampleStatus::AT_REST, gimbal.at_rest)
            .with(SampleStatus::GIMBAL_FAULT, gimbal.fault.is_some())
            .with(SampleStatus::SAMPLES_MISSED, after_gap)
    }

    #[inline(never)]
    fn save(&mut self, outside: &mut impl Surroundings<T>) {
        let saved = self.run.record().is_some_and(|record| outside.archive().save(&record));
        self.run.saved();
        tell(self.link, outside, &Message::Saved(saved));
    }

    fn tick(&mut self, outside: &mut impl Surroundings<T>) {
        self.note_restarts(outside);
        let (now_us, gimbal) = (outside.now_us(), outside.status());
        let motion = self.run.tick(now_us, &gimbal, &mut |message| tell(self.link, outside, message));
        self.command(motion, &gimbal, outside);
        self.motion_log.follow(&self.run, &gimbal, outside);
    }

    /// Ends the run if the IMU has restarted. The interval of the samples need not show that.
    fn note_restarts(&mut self, outside: &mut impl Surroundings<T>) {
        let restarted = outside.losses().restarted;
        if restarted != self.restarted && self.run.state().is_under_way() {
            self.run.abort_with(AbortReason::ImuRestarted);
        }
        self.restarted = restarted;
    }

    /// Gives the gimbal a command, if there is one. Before the first move the archive keeps that the axes have moved;
    /// if it cannot, axes whose turn it must know do not move.
    fn command(&mut self, motion: Option<MotionCommand>, gimbal: &GimbalStatus, outside: &mut impl Surroundings<T>) {
        let Some(motion) = motion else { return };
        let moves = matches!(motion, MotionCommand::MoveTo { .. });
        if moves && !self.motion_log.begin(self.run.config(), outside.archive()) {
            self.run.abort_with(AbortReason::NotMarked);
            return outside.command(MotionCommand::Hold, gimbal.time_us);
        }
        outside.command(motion, gimbal.time_us);
    }

    /// Answers the received command, and reports the status when it is due. The work is bounded, whatever arrives: while
    /// an answer waits to be sent, or a record to be read, received bytes stay where they are.
    #[inline(never)]
    fn serve(&mut self, outside: &mut impl Surroundings<T>) {
        self.link.note_overrun(outside.overrun());
        self.read_on(outside);
        for _ in 0..BYTES_PER_TURN {
            if !self.link.is_answered() || self.reading.is_some() {
                break;
            }
            let Some(byte) = outside.receive() else { break };
            if let Some((number, command)) = self.link.receive(byte) {
                let known = (&mut self.motion_log, &mut self.unit);
                match carry_out(&command, &mut self.run, known, self.link, outside) {
                    Ok(Reply::Now(answer)) => self.link.reply(number, &answer),
                    Ok(Reply::Record(wanted)) => self.reading = Some((number, wanted)),
                    Err(refusal) => self.link.reply(number, &Answer::Refused(refusal)),
                }
            }
        }
        if self.link.is_status_due(outside.now_us()) {
            let status = status(&self.run, self.link, outside);
            self.link.volunteer(&Answer::Status(status));
        }
    }

    /// Reads the next piece of the record that a command waits for. A whole record takes long in an EEPROM.
    #[inline(never)]
    fn read_on(&mut self, outside: &mut impl Surroundings<T>) {
        let Some((number, wanted)) = self.reading else { return };
        let answer = match outside.archive().read_piece(wanted) {
            Ok(Piece::More) => return,
            Ok(Piece::Whole(record)) => Answer::Calibration(record),
            Ok(Piece::Nothing) => Answer::Refused(Refusal::Nothing),
            Err(refusal) => Answer::Refused(refusal),
        };
        self.reading = None;
        self.link.reply(number, &answer);
    }
}

/// The stored calibration, if there is an intact one.
#[inline(never)]
fn load<T: Real>(link: &mut Link, outside: &mut impl Surroundings<T>) -> Option<StoredCalibration> {
    let FoundRecord { record, damaged, fault, other_version, .. } = outside.archive().power_up();
    tell(link, outside, &Message::Store { found: record.is_some(), damaged, fault, other_version });
    record
}

/// The name of the unit in the archive. Its configuration is long, so it is read at power-up only.
#[inline(never)]
fn unit_name<T: Real>(outside: &mut impl Surroundings<T>) -> Option<UnitName> {
    outside.archive().configuration().configuration.map(|found| found.unit)
}
