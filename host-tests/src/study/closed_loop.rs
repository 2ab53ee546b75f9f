//! The virtual RINS in closed loop. After power-up the core turns it, measures, solves, judges, stores and corrects,
//! in this process or as firmware in the emulator.

use crate::bench::emulator::image::{Board, Image, Variant, build};
use crate::bench::emulator::{self, Run};
use crate::bench::power_up::{Switched, in_emulator, in_process, share};
use crate::bench::{Bench, Imu};
use crate::calibration::refusal::refused;
use crate::calibration::virtual_run::VirtualRun;
use crate::calibration::{Outcome, Precision, Record, Setup};
use crate::result::signals::{Recorded, SharedSignals};
use crate::virtual_unit::drive::move_durations_s;
use crate::virtual_unit::driven::DrivenRins;
use crate::virtual_unit::plant::Paced;
use anyhow::{Context, Result, anyhow, ensure};
use rins_selfcal::drivers::kvh1750::Kvh1750Settings;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::PERIOD_US;
use rins_selfcal::model::error_model::InstrumentErrors;
use rins_selfcal::run::abort::Abort;
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig};
use rins_selfcal::run::policy::{Decision, PowerUpPolicy};
use rins_selfcal::run::sequencer::Pace;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::verdict::VerdictLimits;
use std::cell::{Cell, RefCell};
use std::path::Path;
use std::rc::Rc;
use std::time::Duration;

/// Number of corrected samples that are reported (one a second) before the instrument is switched off.
const CORRECTED_MESSAGES: u32 = 3;

/// How a run ended.
#[derive(Clone, Debug)]
pub enum Ended {
    /// The run ended with a result, accepted or rejected.
    Judged(Box<Outcome>),
    /// No run was due: the instrument corrects with the stored calibration, or stands by without one.
    NoRun(Decision),
    /// The run was aborted without a result.
    Aborted(Abort),
}

/// Conditions for the begin, the end and the result of a run.
#[derive(Clone, Copy, Debug)]
pub struct Terms {
    /// When a run begins.
    pub policy: PowerUpPolicy,
    /// Time of power-up, seconds since 1970-01-01 UTC.
    pub utc_s: Option<u64>,
    /// When a run ends.
    pub pace: Pace,
    /// Requirements for an accepted result.
    pub limits: VerdictLimits,
    /// Largest ratio of noise variance to configured variance for which a stop is lengthened in proportion.
    pub noise_margin: f64,
    /// Limits of the outer and the inner axis.
    pub axes: [AxisLimits; 2],
    /// Whether a scheme that leaves parameters unobserved is refused. Otherwise it is run and its result rejected.
    pub refuse_unobserved: bool,
}

impl Default for Terms {
    /// The defaults of the core.
    fn default() -> Self {
        Self {
            policy: PowerUpPolicy::default(),
            utc_s: None,
            pace: Pace::default(),
            limits: VerdictLimits::default(),
            noise_margin: 1.0,
            axes: Default::default(),
            refuse_unobserved: true,
        }
    }
}

/// One power-up, to the first corrected samples or until the gimbals are parked.
pub struct PowerUp<'a> {
    run: &'a VirtualRun,
    setup: &'a Setup,
    terms: Terms,
    imu: Imu,
    board: Option<Board>,
    signals: SharedSignals,
}

impl<'a> PowerUp<'a> {
    /// A power-up of a unit with this setup and the default terms.
    pub fn new(run: &'a VirtualRun, setup: &'a Setup) -> Self {
        Self {
            run,
            setup,
            terms: Terms::default(),
            imu: Imu::default(),
            board: None,
            signals: SharedSignals::default(),
        }
    }

    /// The same power-up with other terms.
    #[must_use]
    pub fn on_terms(self, terms: Terms) -> Self {
        Self { terms, ..self }
    }

    /// The same power-up with another IMU.
    #[must_use]
    pub fn with_imu(self, imu: Imu) -> Self {
        Self { imu, ..self }
    }

    /// The same power-up on another board. `None`: the emulated board with the floating-point type of the setup.
    #[must_use]
    pub fn on_board(self, board: Option<Board>) -> Self {
        Self { board, ..self }
    }

    /// Signals of the IMU and the encoders over all power-ups so far.
    pub fn signals(&self) -> &SharedSignals {
        &self.signals
    }

    /// Runs the core in this process with an empty store. `on_message` receives all messages of the core.
    ///
    /// # Errors
    /// The reason why the core refuses the configuration.
    pub fn in_process(&self, on_message: impl FnMut(&Message)) -> Result<Ended> {
        let mut watch = Watch::new(self.run, &self.signals, on_message);
        let bench = share(Bench::with_imu(watch.plant(), self.imu));
        let (assignment, told) = (self.assignment(), |message: &Message| watch.note(message));
        match self.setup.precision {
            Precision::F64 => in_process::<f64, _>(&assignment, None, &bench, told)?,
            Precision::F32 => in_process::<f32, _>(&assignment, None, &bench, told)?,
        };
        watch.ended(self)
    }

    /// Runs the firmware in the emulator; `eeprom` is the file of its store. `on_log` receives the lines of its log.
    ///
    /// # Errors
    /// The reason why the firmware refuses the configuration, or why the emulator does not run the firmware.
    pub fn in_emulator(
        &self,
        eeprom: &Path,
        on_log: impl FnMut(&str),
        on_message: impl FnMut(&Message),
    ) -> Result<(Ended, Run)> {
        let image = self.image()?;
        let mut watch = Watch::new(self.run, &self.signals, on_message);
        let mut bench = Bench::with_imu(watch.plant(), self.imu);
        let told = |message: &Message| watch.note(message);
        let run = in_emulator(&self.assignment(), &image, Some(eeprom), &mut bench, on_log, told)?;
        Ok((watch.ended(self)?, run))
    }

    /// Runs the firmware in the emulator in real time, with its serial line at the Unix socket `serial`, until this
    /// program ends.
    ///
    /// # Errors
    /// The reason why the emulator does not run the firmware.
    pub fn on_line(&self, serial: &Path, eeprom: &Path, on_log: impl FnMut(&str)) -> Result<()> {
        let image = self.image()?;
        let mut rins = DrivenRins::new(&self.run.unit, self.run.seed);
        rins.expect_moves(&move_durations_s(&self.run.scheme, self.run.unit.rate_hz));
        let paced = Paced::new(rins, Duration::from_micros(PERIOD_US));
        let mut bench = Bench::with_imu(paced, self.imu);
        let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
        let configuration = postcard::to_slice(&self.assignment(), &mut buffer).context("too long for the board")?;
        let usual = emulator::MachineSetup::new(&image);
        let setup = emulator::MachineSetup {
            eeprom: Some(eeprom),
            configuration,
            reboots: true,
            serial: Some(serial),
            ..usual
        };
        emulator::run(&setup, &mut bench, on_log, |_| ()).map(drop)
    }

    fn image(&self) -> Result<Image> {
        // Both IMUs are configured for the same sample rate.
        let (asked_hz, rate_hz) = (self.run.unit.rate_hz, Kvh1750Settings::default().rate_hz);
        ensure!(asked_hz == rate_hz, "the firmware samples at {rate_hz} Hz, not at {asked_hz}");
        build(self.variant())
    }

    fn variant(&self) -> Variant {
        let usual = match self.setup.precision {
            Precision::F64 => Board::Mps2An500,
            Precision::F32 => Board::Mps2An386,
        };
        Variant { board: self.board.unwrap_or(usual), imu: self.imu }
    }

    fn assignment(&self) -> Assignment {
        let Terms { policy, utc_s, pace, limits, noise_margin, axes, refuse_unobserved } = self.terms;
        let mut calibrator = self.setup.config();
        calibrator.estimator.noise.margin = noise_margin;
        let usual = SelfCalibrationConfig::new(calibrator, self.run.scheme.clone());
        Assignment::SelfCalibrate(SelfCalibrationConfig {
            policy,
            utc_s,
            pace,
            limits,
            axes,
            refuse_unobserved,
            ..usual
        })
    }
}

/// Follows the messages of a run, and switches the instrument off after the last message of interest.
struct Watch<F> {
    plant: Option<Recorded<Switched<Rc<RefCell<DrivenRins>>>>>,
    rins: Rc<RefCell<DrivenRins>>,
    truth: InstrumentErrors<f64>,
    off: Rc<Cell<bool>>,
    record: Record,
    refused: Option<ConfigError>,
    decision: Option<Decision>,
    state: State,
    corrected: u32,
    on_message: F,
}

impl<F: FnMut(&Message)> Watch<F> {
    fn new(run: &VirtualRun, signals: &SharedSignals, on_message: F) -> Self {
        let mut rins = DrivenRins::new(&run.unit, run.seed);
        rins.expect_moves(&move_durations_s(&run.scheme, run.unit.rate_hz));
        let truth = rins.rins().errors_now();
        let rins = Rc::new(RefCell::new(rins));
        let (plant, off) = Switched::new(Rc::clone(&rins));
        Self {
            plant: Some(Recorded::new(plant, signals)),
            rins,
            truth,
            off,
            record: Record::default(),
            refused: None,
            decision: None,
            state: State::PowerUp,
            corrected: 0,
            on_message,
        }
    }

    /// The instrument, which can be taken once.
    fn plant(&mut self) -> Recorded<Switched<Rc<RefCell<DrivenRins>>>> {
        self.plant.take().expect("put on one bench")
    }

    fn note(&mut self, message: &Message) {
        self.record.note(message);
        match message {
            Message::State { state, .. } => self.state = *state,
            Message::Corrected { .. } => self.corrected += u32::from(self.state == State::Correcting),
            Message::Decided(decision) => self.decision = Some(*decision),
            Message::Segment(_) => self.truth = self.rins.borrow().rins().errors_now(),
            Message::Refused(error) => self.refused = Some(*error),
            _ => {}
        }
        if matches!(self.state, State::StandBy | State::Parked | State::Stranded)
            || self.corrected >= CORRECTED_MESSAGES
        {
            self.off.set(true);
        }
        (self.on_message)(message);
    }

    fn ended(self, power_up: &PowerUp) -> Result<Ended> {
        let setup = power_up.setup;
        if let Some(error) = self.refused {
            return Err(refused(error, &power_up.run.scheme, &power_up.terms.axes));
        }
        match (self.record.aborted(), self.record.outcome(setup), self.decision) {
            (Some(abort), ..) => Ok(Ended::Aborted(abort)),
            (None, Some(outcome), _) => Ok(Ended::Judged(Box::new(Outcome { truth: Some(self.truth), ..outcome }))),
            (None, None, Some(decision @ (Decision::UseStored(_) | Decision::StandBy(_)))) => {
                Ok(Ended::NoRun(decision))
            }
            (None, None, _) => Err(anyhow!("the instrument was switched off in state {:?}", self.state)),
        }
    }
}
