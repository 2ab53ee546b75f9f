//! The board as the instrument sees it, with the log and the measurement of processor time.

use crate::board::Board;
use crate::work::{Span, Work, count};
use crate::{Scalar, inbox, recorder, watchdog};
use rins_selfcal::acquisition::queue::SampleWithGimbal;
use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::clock_check::ClockFault;
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::base::loss::LossCounts;
use rins_selfcal::base::sample::{CorrectedSample, SampleStatus};
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::MotorAndLoad;
use rins_selfcal::gimbal::travel::LocateError;
use rins_selfcal::gimbal::{GimbalStatus, MotionCommand};
use rins_selfcal::instrument::{
    Archive, Axes, CorrectedSink, Done, Events, FoundConfiguration, FoundRecord, SerialLine, Surroundings, Telemetry,
};
use rins_selfcal::keep::black_box::{Entry, Event};
use rins_selfcal::keep::mark::Mark;
use rins_selfcal::keep::slots::StoreError;
use rins_selfcal::keep::store::{Piece, REJECTED_IN_A_ROW, Wanted};
use rins_selfcal::link::{Link, Refusal};
use rins_selfcal::run::result::StoredCalibration;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::run::unit::UnitConfiguration;

/// A board, for one turn of the main loop.
pub struct Devices<'b, B> {
    board: &'b mut B,
    /// The processor time of the last sample.
    span: Option<Span>,
    /// The kind of work for the last sample, if a message shows the kind.
    shown: Option<Work>,
}

impl<'b, B> Devices<'b, B> {
    /// The devices of a board.
    pub fn new(board: &'b mut B) -> Self {
        Self { board, span: None, shown: None }
    }
}

impl<B: Board> Surroundings<Scalar> for Devices<'_, B> {
    fn now_us(&self) -> u64 {
        self.board.now_us()
    }

    fn next_sample(&mut self) -> Option<SampleWithGimbal<Scalar>> {
        let observed = self.board.parts().samples.pop()?;
        watchdog::progress(self.board.now_us());
        (self.span, self.shown) = (Some(Span::start()), None);
        Some(observed)
    }

    fn done(&mut self, work: Done) {
        let kind = match work {
            Done::Sample { ends_segment: true, .. } => Work::Segment,
            Done::Sample { during, .. } => self.shown.unwrap_or_else(|| work_in(during)),
            Done::Refinement => Work::Solve,
        };
        if let Some(span) = self.span.replace(Span::start()) {
            count(kind, &span);
        }
    }

    fn losses(&mut self) -> LossCounts {
        self.board.parts().samples.losses()
    }

    fn imu(&mut self) -> Option<ImuIdentity> {
        self.board.parts().imu
    }

    fn clock_fault(&mut self) -> Option<ClockFault> {
        self.board.parts().clock
    }

    fn archive(&mut self) -> &mut impl Archive {
        self
    }
}

/// The kind of work for a sample in this state, if no message shows the kind.
fn work_in(state: State) -> Work {
    match state {
        State::Dwell(_) => Work::Stop,
        State::Turn(_) => Work::Move,
        State::Compute => Work::Solve,
        State::Correcting => Work::Correct,
        _ => Work::Other,
    }
}

impl<B: Board> Axes for Devices<'_, B> {
    fn status(&mut self) -> GimbalStatus {
        self.board.with_control(|control| control.status()).unwrap_or_default()
    }

    fn command(&mut self, motion: MotionCommand, seen_us: u64) {
        self.board.with_control(|control| control.command(motion, seen_us));
    }

    fn reconfigure(&mut self, axes: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
        self.board.with_control(|control| control.reconfigure(axes, motors));
    }

    fn angles_rad(&mut self) -> [Option<f64>; 2] {
        self.board.with_control(|control| control.angles_rad()).unwrap_or_default()
    }

    fn locate(&mut self, angles_rad: [Option<f64>; 2], tolerance_rad: f64) -> Result<(), LocateError> {
        self.board.with_control(|control| control.locate(angles_rad, tolerance_rad)).unwrap_or(Ok(()))
    }
}

impl<B: Board> CorrectedSink<Scalar> for Devices<'_, B> {
    /// The place of the navigation software. This firmware has none. The corrected samples can be requested on the
    /// serial line.
    fn take(&mut self, _sample: &CorrectedSample<Scalar>, _angles: [Angle; 2], _status: SampleStatus) {}
}

impl<B: Board> Events for Devices<'_, B> {
    fn record(&mut self, event: Event) {
        recorder::record(self.board.now_us(), event);
    }

    fn event(&mut self, back: u16) -> Option<Entry> {
        recorder::event(back)
    }
}

impl<B: Board> SerialLine for Devices<'_, B> {
    fn receive(&mut self) -> Option<u8> {
        inbox::pop()
    }

    fn overrun(&self) -> u32 {
        inbox::lost()
    }

    fn transmit(&mut self, link: &mut Link) {
        let span = Span::start();
        self.board.transmit(link);
        span.put_aside();
    }
}

impl<B: Board> Telemetry for Devices<'_, B> {
    fn tell(&mut self, message: &Message, frame: Option<&[u8]>) {
        let span = Span::start();
        self.shown = Some(Work::Other);
        log(message);
        if let Some(frame) = frame {
            self.board.show(frame);
        }
        span.put_aside();
    }
}

impl<B: Board> Archive for Devices<'_, B> {
    fn power_up(&mut self) -> FoundRecord {
        let found = Archive::power_up(&mut self.board.parts().memory);
        if !found.writable {
            defmt::warn!("the calibration memory cannot take a record");
        }
        found
    }

    fn save(&mut self, record: &StoredCalibration) -> bool {
        let span = Span::start();
        let saved = self.board.parts().memory.calibrations.save(record);
        match &saved {
            Ok(0) => {}
            Ok(failed) => {
                defmt::warn!("{=usize} slots of the store did not take the record; the next slot did", *failed)
            }
            Err(StoreError::Rejected) => {
                defmt::info!(
                    "the rejected run is not stored: only the first {=usize} in a row are kept",
                    REJECTED_IN_A_ROW
                )
            }
            Err(_) => defmt::warn!("the record cannot be stored"),
        }
        span.put_aside();
        saved.is_ok()
    }

    fn read_piece(&mut self, wanted: Wanted) -> Result<Piece, Refusal> {
        Archive::read_piece(&mut self.board.parts().memory, wanted)
    }

    fn erase(&mut self) -> Result<(), Refusal> {
        Archive::erase(&mut self.board.parts().memory)
    }

    fn configuration(&mut self) -> FoundConfiguration {
        self.board.parts().memory.configuration()
    }

    fn configure(&mut self, configuration: &UnitConfiguration) -> Result<(), Refusal> {
        self.board.parts().memory.configure(configuration)
    }

    fn erase_configuration(&mut self) -> Result<(), Refusal> {
        self.board.parts().memory.erase_configuration()
    }

    fn mark(&mut self, mark: Mark) -> bool {
        let span = Span::start();
        let stored = self.board.parts().memory.mark(mark);
        if !stored {
            defmt::warn!("the mark of motion cannot be stored");
        }
        span.put_aside();
        stored
    }

    fn last_mark(&mut self) -> Option<Mark> {
        self.board.parts().memory.last_mark()
    }
}

/// Logs the milestones of a run, for readers who do not receive the telemetry. The log has codes and numbers in place
/// of the texts: formatting numbers on the target would link panics, and a hundred kilobytes.
fn log(message: &Message) {
    match message {
        Message::State { time_us, state, .. } => {
            defmt::info!("{=u64:us}: {}", *time_us, defmt::Display2Format(state));
        }
        Message::Store { found, damaged, fault, other_version } => {
            defmt::info!(
                "calibration in store: {=bool}, a slot damaged: {=bool}, memory at fault: {=bool}",
                *found,
                *damaged,
                *fault
            );
            if let Some(version) = other_version {
                let version = char::from(*version);
                defmt::info!(
                    "the store has intact calibrations of format {=char}, which this software does not read",
                    version
                );
            }
        }
        Message::Refused(error) => defmt::error!("the configuration was refused: [{=str}] {}", error.code(), error),
        Message::Decided(decision) => defmt::info!("{}", decision),
        Message::Solved { solution, .. } => defmt::info!(
            "solved: chi-square {=f64} with {=u32} degrees of freedom",
            solution.fit.chi_square,
            solution.degrees_of_freedom
        ),
        Message::Judged(verdict) => {
            defmt::info!("{=str}", if verdict.accepted() { "accepted" } else { "rejected" });
            let told = verdict.reasons.iter().chain(&verdict.changes);
            told.for_each(|reason| defmt::info!("  [{=str}] {}", reason.code(), reason));
        }
        Message::Aborted(abort) => defmt::warn!("the run was aborted: [{=str}] {}", abort.reason.code(), abort),
        Message::Fault(fault) => defmt::warn!("[{=str}] {}", fault.kind.code(), fault),
        Message::Restarted(restart) => defmt::info!("{}", defmt::Display2Format(restart)),
        Message::Saved(saved) => defmt::info!("stored: {=bool}", *saved),
        Message::Queue { samples, losses } => {
            defmt::info!("{=u64} samples, {=u32} missing", *samples, losses.total());
        }
        // The telemetry carries live values and details, so the log leaves them out.
        Message::Released
        | Message::Segment(_)
        | Message::Innovations(_)
        | Message::Covariance { .. }
        | Message::Corrected { .. } => {}
    }
}
