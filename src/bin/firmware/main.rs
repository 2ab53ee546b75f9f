//! The firmware: it reads samples, moves the gimbals, calibrates, and corrects samples.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

mod board;
mod devices;
mod fault;
mod inbox;
#[cfg(any(feature = "mps2-an500", feature = "mps2-an386"))]
mod mps2;
mod recorder;
mod stack;
#[cfg(feature = "stm32h743")]
mod stm32h743;
mod watchdog;
mod work;

use board::{Board, ThisBoard};
use cortex_m::singleton;
use cortex_m_rt::entry;
use devices::Devices;
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::base::restart::Task as Supervised;
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::gimbal::Gimbal;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::MotorAndLoad;
use rins_selfcal::instrument::{Instrument, Recording, Startup};
use rins_selfcal::link::Link;
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::calibrator::Calibrator;
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::ConfigError;

/// The floating-point type of this image.
#[cfg(not(feature = "single-precision"))]
pub type Scalar = f64;
/// The floating-point type of this image.
#[cfg(feature = "single-precision")]
pub type Scalar = f32;

type ImageCalibrator = Calibrator<Scalar, MAX_SEGMENTS>;

#[entry]
fn main() -> ! {
    let mut board = ThisBoard::start();
    let calibrator = singleton!(: ImageCalibrator = Calibrator::UNCONFIGURED);
    let status = match calibrator.zip(singleton!(: Link = Link::new())) {
        Some((calibrator, link)) => run(&mut board, link, calibrator),
        None => Err(()),
    };
    board.finish(status)
}

fn run(board: &mut impl Board, link: &mut Link, calibrator: &mut ImageCalibrator) -> Result<(), ()> {
    match &mut task(board) {
        Task::SelfCalibrate(startup) => self_calibrate(board, link, startup, calibrator),
        Task::Replay(config) => replay(board, link, config, calibrator),
    }
}

/// What to do after power-up.
#[expect(clippy::large_enum_variant, reason = "there is no heap to box on")]
enum Task {
    SelfCalibrate(Startup),
    Replay(CalibratorConfig),
}

/// What the host assigns. Without an assignment, the instrument calibrates with the configuration in its memory. Not
/// inlined, as the functions below, so that their stack is free again when the run begins.
#[inline(never)]
fn task(board: &mut impl Board) -> Task {
    let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
    let restart = board.parts().restart.clone();
    match board.configuration(&mut buffer).map(postcard::from_bytes) {
        Some(Ok(Assignment::SelfCalibrate(config))) => Task::SelfCalibrate(Startup::assigned(config, restart)),
        Some(Ok(Assignment::Replay(config))) => Task::Replay(config),
        assigned => {
            if assigned.is_some() {
                defmt::error!("the assignment cannot be read; the stored configuration is used");
            }
            Task::SelfCalibrate(Startup::stored(&mut Devices::new(board), board::configuration, restart))
        }
    }
}

#[inline(never)]
fn self_calibrate(
    board: &mut impl Board,
    link: &mut Link,
    startup: &mut Startup,
    calibrator: &mut ImageCalibrator,
) -> Result<(), ()> {
    // The instrument is borrowed in place. If it were moved, it would be on the stack twice.
    match &mut power_up(board, link, startup, calibrator) {
        Ok(instrument) => {
            let config = instrument.run().config();
            begin(board, &config.axes, &config.motors);
            while board.powered() {
                watchdog::report(Supervised::Main, board.now_us());
                instrument.turn(&mut Devices::new(board));
                board.wait();
            }
            instrument.power_off(&mut Devices::new(board));
            Ok(())
        }
        Err(_) => Err(()),
    }
}

#[inline(never)]
fn power_up<'m>(
    board: &mut impl Board,
    link: &'m mut Link,
    startup: &'m mut Startup,
    calibrator: &'m mut ImageCalibrator,
) -> Result<Instrument<'m, Scalar>, ConfigError> {
    defmt::info!("scheme {=str}", startup.config().scheme.name.as_str());
    if let Some(ImuIdentity { product, serial }) = board.parts().imu {
        defmt::info!("IMU {=u16}, serial number {=u32}", product, serial);
    }
    Instrument::power_up(startup, link, calibrator, &mut Devices::new(board))
}

/// Starts control and sampling.
#[inline(never)]
fn begin(board: &mut impl Board, axes: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
    board.begin(Gimbal::new(axes, motors));
}

#[inline(never)]
fn replay(
    board: &mut impl Board,
    link: &mut Link,
    config: &CalibratorConfig,
    calibrator: &mut ImageCalibrator,
) -> Result<(), ()> {
    let mut recording = Recording::new(config, link, calibrator);
    begin(board, &[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
    while board.powered() {
        watchdog::report(Supervised::Main, board.now_us());
        recording.turn(&mut Devices::new(board));
        board.wait();
    }
    recording.conclude(&mut Devices::new(board));
    Ok(())
}
