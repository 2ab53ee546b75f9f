//! What an instrument needs around it: small traits that a board, a virtual instrument or a test implements.

use crate::acquisition::queue::SampleWithGimbal;
use crate::base::angle::Angle;
use crate::base::clock_check::ClockFault;
use crate::base::imu_identity::ImuIdentity;
use crate::base::linear::Real;
use crate::base::loss::LossCounts;
use crate::base::sample::{CorrectedSample, SampleStatus};
use crate::gimbal::axis::AxisLimits;
use crate::gimbal::servo::MotorAndLoad;
use crate::gimbal::travel::LocateError;
use crate::gimbal::{GimbalStatus, MotionCommand};
use crate::keep::black_box::{Entry, Event};
use crate::keep::mark::Mark;
use crate::keep::medium::Medium;
use crate::keep::store::{CalibrationStore, Loaded, Piece, Wanted};
use crate::link::{Link, Refusal};
use crate::run::result::StoredCalibration;
use crate::run::state::State;
use crate::run::telemetry::Message;
use crate::run::unit::UnitConfiguration;

/// The user of the corrected samples: the navigation software, or a recorder.
pub trait CorrectedSink<T: Real> {
    /// Takes one corrected sample, with the outer and the inner gimbal angle at its time stamp.
    fn take(&mut self, sample: &CorrectedSample<T>, angles: [Angle; 2], status: SampleStatus);
}

/// The gimbal as the main loop sees it. The control interrupt moves the axes.
pub trait Axes {
    /// The state of both axes now.
    fn status(&mut self) -> GimbalStatus;

    /// Gives the gimbal a command that was computed from its status at the time `seen_us`.
    fn command(&mut self, motion: MotionCommand, seen_us: u64);

    /// Sets other limits and motors. Called only while no run is under way.
    fn reconfigure(&mut self, axes: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]);

    /// The angles of the outer and the inner axis now, counted over whole turns, rad; `None` if the turn is not known.
    fn angles_rad(&mut self) -> [Option<f64>; 2];

    /// Says at which angles, counted over whole turns, the outer and the inner axis stand, rad; `None` leaves an axis
    /// as it is.
    ///
    /// # Errors
    /// Why an axis cannot stand there.
    fn locate(&mut self, angles_rad: [Option<f64>; 2], tolerance_rad: f64) -> Result<(), LocateError>;
}

/// The content of the archive at power-up.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FoundRecord {
    /// The calibration to use, if there is an intact one.
    pub record: Option<StoredCalibration>,
    /// Whether a slot of the memory is damaged. An intact record of another version of the format is no damage.
    pub damaged: bool,
    /// The highest version of the format, a character, among the records that are intact and that this software cannot
    /// read.
    pub other_version: Option<u8>,
    /// Whether the memory does not answer, or is too small.
    pub fault: bool,
    /// Whether the memory can take the next record.
    pub writable: bool,
}

/// The configuration of the unit in the archive.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FoundConfiguration {
    /// The newest configuration, if it is intact and this software can read it.
    pub configuration: Option<UnitConfiguration>,
    /// Whether a newer configuration may be lost, because a slot of the memory is damaged.
    pub damaged: bool,
    /// The version of the format, a character, of the newest configuration if this software cannot read it.
    pub other_version: Option<u8>,
    /// Whether the memory does not answer, or is too small.
    pub fault: bool,
}

/// What an instrument keeps in non-volatile memory: calibrations, and, if the board has a memory for them, the
/// configuration of the unit and marks of motion. By default there is no such memory.
pub trait Archive {
    /// Looks for the calibration to use, and prepares the memory for the next record. Called once, at power-up, when no
    /// sample is waiting.
    fn power_up(&mut self) -> FoundRecord;

    /// Stores the result of a run, accepted or rejected. Returns whether the record is stored.
    fn save(&mut self, record: &StoredCalibration) -> bool;

    /// Reads the next piece of a calibration. While it returns [`Piece::More`], it is called again with the same
    /// argument, once in a turn of the main loop. A piece takes less than the interval of the samples.
    ///
    /// # Errors
    /// [`Refusal::Memory`]: the memory does not work.
    fn read_piece(&mut self, wanted: Wanted) -> Result<Piece, Refusal>;

    /// Erases all calibrations.
    ///
    /// # Errors
    /// [`Refusal::Memory`]: the memory does not work.
    fn erase(&mut self) -> Result<(), Refusal>;

    /// The configuration of the unit.
    fn configuration(&mut self) -> FoundConfiguration {
        FoundConfiguration::default()
    }

    /// Stores the configuration of the unit. Call it only while the gimbal is at rest, because an erase may take
    /// seconds.
    ///
    /// # Errors
    /// [`Refusal::Memory`]: the memory does not work, and the earlier configuration stays. [`Refusal::Nothing`]: there
    /// is no such memory.
    fn configure(&mut self, _configuration: &UnitConfiguration) -> Result<(), Refusal> {
        Err(Refusal::Nothing)
    }

    /// Erases the configuration of the unit. Call it only while the gimbal is at rest.
    ///
    /// # Errors
    /// [`Refusal::Memory`]: the memory does not work. [`Refusal::Nothing`]: there is no such memory.
    fn erase_configuration(&mut self) -> Result<(), Refusal> {
        Err(Refusal::Nothing)
    }

    /// Stores a mark of motion. Returns whether it is stored. If not, [`Self::last_mark`] may still give the mark
    /// before: [`Mark::Moving`] must be stored before anything moves.
    fn mark(&mut self, _mark: Mark) -> bool {
        false
    }

    /// The last mark of motion; `None` if nothing was ever marked, or if there is no such memory. If a newer mark may
    /// be lost, the answer is [`Mark::Moving`].
    fn last_mark(&mut self) -> Option<Mark> {
        None
    }
}

impl<M: Medium> Archive for CalibrationStore<M> {
    fn power_up(&mut self) -> FoundRecord {
        let (record, fault) = match self.load() {
            Ok(Loaded::Found { record, .. }) => (Some(record), false),
            Ok(Loaded::Empty | Loaded::Corrupt { .. }) => (None, false),
            Err(_) => (None, true),
        };
        let (damaged, other_version) = (self.damaged() > 0, self.other_version());
        // The next record may need an erase. The erase is done now, while no sample waits.
        FoundRecord { record, damaged, other_version, fault, writable: self.prepare().is_ok() }
    }

    fn save(&mut self, record: &StoredCalibration) -> bool {
        Self::save(self, record).is_ok()
    }

    fn read_piece(&mut self, wanted: Wanted) -> Result<Piece, Refusal> {
        Self::read_piece(self, wanted).map_err(|_| Refusal::Memory)
    }

    fn erase(&mut self) -> Result<(), Refusal> {
        Self::erase(self).map_err(|_| Refusal::Memory)
    }
}

/// The black box. By default there is none, and events are not recorded.
pub trait Events {
    /// Records an event.
    fn record(&mut self, _event: Event) {}

    /// An event, 0 for the newest; `None` beyond the last.
    fn event(&mut self, _back: u16) -> Option<Entry> {
        None
    }
}

/// Channels for messages besides the serial line: a log, a test bench. By default there is none.
pub trait Telemetry {
    /// Takes a message, and its frame if the message fits into a frame.
    fn tell(&mut self, _message: &Message, _frame: Option<&[u8]>) {}
}

/// The serial line. By default nothing is connected.
pub trait SerialLine {
    /// The next received byte.
    fn receive(&mut self) -> Option<u8> {
        None
    }

    /// Number of received bytes that were lost, since power-up.
    fn overrun(&self) -> u32 {
        0
    }

    /// Sends bytes of the link, as far as the line takes bytes now. It never waits.
    fn transmit(&mut self, link: &mut Link) {
        while link.transmit().is_some() {}
    }
}

/// Work that the main loop has done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Done {
    /// The work on a sample.
    Sample {
        /// State of the run before the sample.
        during: State,
        /// Whether the sample has ended a segment, which the filter has processed.
        ends_segment: bool,
    },
    /// A piece of the linearization that follows a stop.
    Refinement,
}

/// Everything around an instrument.
pub trait Surroundings<T: Real>: Axes + CorrectedSink<T> + Events + SerialLine + Telemetry {
    /// Time since power-up, us.
    fn now_us(&self) -> u64;

    /// The next sample that the IMU's interrupt has put into the queue.
    fn next_sample(&mut self) -> Option<SampleWithGimbal<T>>;

    /// Reports what was done since the last sample was taken or since the report before. For measurements of processor
    /// time.
    fn done(&mut self, _work: Done) {}

    /// The counts of missing samples, since power-up.
    fn losses(&mut self) -> LossCounts;

    /// Which IMU gives the samples; by default the IMU does not tell. Asked for at the first sample.
    fn imu(&mut self) -> Option<ImuIdentity> {
        None
    }

    /// What is wrong with the clock of the time stamps; by default nothing. Asked for at power-up.
    fn clock_fault(&mut self) -> Option<ClockFault> {
        None
    }

    /// The memory that keeps calibrations.
    fn archive(&mut self) -> &mut impl Archive;
}
