//! Prints the sizes of the firmware's images, and checks what is linked into them.
//!
//! Builds the images of all boards. Prints flash, static RAM and stack. For images that run in the emulator, also
//! prints the depth of the queue, latencies and instructions by kind of work over a whole calibration.

use anyhow::{Context, Result};
use clap::Parser;
use host_tests::bench::emulator::image::{Board, Image, Variant, build};
use host_tests::bench::emulator::{Run, WORKS};
use host_tests::bench::firmware_sizes::{self, Sizes, SizesByImage};
use host_tests::bench::power_up::{Switched, in_emulator};
use host_tests::bench::{Bench, Imu};
use host_tests::files::hardware::profiles;
use host_tests::virtual_unit::drive::move_durations_s;
use host_tests::virtual_unit::driven::DrivenRins;
use host_tests::virtual_unit::unit::VirtualUnit;
use object::{Object, ObjectSymbol};
use rins_selfcal::base::hardware::Hardware;
use rins_selfcal::base::method::Method;
use rins_selfcal::drivers::kvh1750::MESSAGE_BYTES;
use rins_selfcal::gimbal::servo::PERIOD_S;
use rins_selfcal::run::assignment::Assignment;
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;
use std::path::PathBuf;
use std::process::ExitCode;

/// Size, stack, queue and instructions of the firmware's images. Exit status 1 if an allocation is linked, if a panic
/// is linked on a board of the emulator, or if a size differs from host-tests/data/firmware-sizes.toml.
#[derive(Parser)]
struct Arguments {
    /// An image for mps2-an500 with an ADIS16495, in place of the images of all boards; its sizes are not compared.
    image: Option<PathBuf>,
    /// Profile of the hardware for which the image calibrates: ideal, navigation, tactical or mems.
    #[arg(long, requires = "image", default_value = "navigation")]
    hardware: String,
    /// Write the sizes to the data file in place of comparing them.
    #[arg(long, conflicts_with = "image")]
    update: bool,
}

/// Parts of the demangled names of functions that are linked only with an allocation.
const ALLOCATION: [&str; 3] = ["__rust_alloc", "__rg_alloc", "alloc::"];
/// Parts of the demangled names of functions that are linked only with a panic.
const PANIC: [&str; 11] = [
    "core::panicking",
    "core::option::expect_failed",
    "core::option::unwrap_failed",
    "core::result::unwrap_failed",
    "core::cell::panic_",
    "core::slice::index::slice_",
    "core::str::slice_error_fail",
    "rust_begin_unwind",
    "panic_fmt",
    "panic_bounds_check",
    "len_mismatch_fail",
];

fn main() -> ExitCode {
    match report(&Arguments::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("firmware-report: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn report(arguments: &Arguments) -> Result<bool> {
    let hardware = Hardware::named(&arguments.hardware)
        .with_context(|| format!("--hardware: unknown '{}'; known: {}", arguments.hardware, profiles()))?;
    if let Some(path) = &arguments.image {
        return Ok(report_image(
            "image",
            &Image { path: path.clone(), board: Board::Mps2An500, imu: Imu::Adis16495 },
            &hardware,
        )?
        .1);
    }
    let kvh = |board: Board| Variant { imu: Imu::Kvh1750, ..board.into() };
    let emulated = [Board::Mps2An500.into(), kvh(Board::Mps2An500), Board::Mps2An386.into()];
    let (mut clean, mut sizes) = (true, SizesByImage::new());
    for variant in emulated.into_iter().chain([Board::Stm32h743.into(), kvh(Board::Stm32h743)]) {
        let (found, is_clean) = report_image(&variant.features(), &build(variant)?, &hardware)?;
        sizes.insert(variant.features(), found);
        clean &= is_clean;
    }
    let as_before = if arguments.update { update(&sizes)? } else { compare(&sizes)? };
    Ok(clean && as_before)
}

fn update(sizes: &SizesByImage) -> Result<bool> {
    let path = firmware_sizes::data_file();
    firmware_sizes::write(&path, sizes)?;
    println!("written: {}", path.display());
    Ok(true)
}

/// Whether all sizes agree with the data file.
fn compare(sizes: &SizesByImage) -> Result<bool> {
    let differences = firmware_sizes::differences(&firmware_sizes::read(&firmware_sizes::data_file())?, sizes);
    differences.iter().for_each(|line| println!("{line}"));
    match differences.as_slice() {
        [] => println!("all sizes agree with the data file"),
        _ => println!("if the differences are intended, --update writes them to the data file"),
    }
    Ok(differences.is_empty())
}

/// Prints the figures of one image. Returns its sizes, and whether nothing forbidden is linked.
fn report_image(name: &str, image: &Image, hardware: &Hardware) -> Result<(Sizes, bool)> {
    let bytes = image.read()?;
    let file = object::File::parse(&*bytes)?;
    let mut sizes = Sizes::of(&file);
    println!("{name}");
    println!("  flash                {:>8} bytes", sizes.flash);
    println!("  static RAM           {:>8} bytes", sizes.static_ram);
    if image.board.is_emulated() {
        sizes.stack_used = Some(report_calibration(image, hardware)?);
    } else {
        println!("  stack                       - bytes of {}: there is no emulator of the board", sizes.stack_room);
    }
    // The HAL of a real board can panic during its set-up, and its panics cannot be told from those of the library.
    let may_panic = !image.board.is_emulated();
    let (allocations, panics) = (linked(&file, &ALLOCATION), linked(&file, &PANIC));
    match panics.len() {
        0 => println!("  no panic linked"),
        count if may_panic => println!("  {count} functions for panics linked by the HAL"),
        _ => panics.iter().for_each(|name| println!("  linked: {name}")),
    }
    allocations.iter().for_each(|name| println!("  linked: {name}"));
    Ok((sizes, allocations.is_empty() && (may_panic || panics.is_empty())))
}

/// Prints the load of a calibration. Returns the used stack, bytes.
fn report_calibration(image: &Image, hardware: &Hardware) -> Result<u64> {
    let calibration = calibration(image, hardware)?;
    println!("  stack used           {:>8} bytes of {}", calibration.stack_used_bytes, calibration.stack_bytes);
    println!("  queue used           {:>8} samples of {}", calibration.queue_deepest, calibration.queue_length);
    println!("  {:<21}{:>8} {:>8}   instructions, without transfers and telemetry", "", "mean", "most");
    for (work, load) in WORKS.iter().zip(&calibration.loads) {
        println!("  {work:<21}{:>8.0} {:>8.0}", load.mean_instructions, load.most_instructions);
    }
    print_timing(&calibration, image.imu);
    Ok(calibration.stack_used_bytes)
}

/// Clock of the processor on the NUCLEO-H743ZI2, Hz.
const CORE_HZ: f64 = 480e6;

/// Prints the processor load of control at 1 kHz and sampling at 200 Hz, with one cycle per instruction at 480 MHz.
/// Every byte of a KVH 1750 is counted with the time of the slowest byte.
fn print_timing(run: &Run, imu: Imu) {
    let [control, acquire, ..] = run.loads;
    let interrupts = match imu {
        Imu::Adis16495 => 1.0,
        Imu::Kvh1750 => MESSAGE_BYTES as f64,
    };
    let percent = |instructions: f64, interval_s: f64| 100.0 * instructions / (CORE_HZ * interval_s);
    println!("  {:<21}{:>8} {:>8} {:>8}   instructions; % of the interval at 480 MHz", "", "latency", "in all", "%");
    for (name, latency, most, interval_s) in [
        ("control, 1 ms", run.control_latency, control.most_instructions, PERIOD_S),
        ("IMU, 5 ms", run.data_ready_latency, interrupts * acquire.most_instructions, 0.005),
    ] {
        let whole = latency + most;
        println!("  {name:<21}{latency:>8.0} {whole:>8.0} {:>8.2}", percent(whole, interval_s));
    }
    println!("  late periods {}, late commands {}", run.late_periods, run.late_commands);
}

/// Runs a whole calibration with short stops. Its last part needs the most stack.
fn calibration(image: &Image, hardware: &Hardware) -> Result<Run> {
    let unit = VirtualUnit::default();
    let scheme = Scheme::bai(1.0, 1);
    let mut calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    calibrator.estimator.hardware = *hardware;
    let assignment = Assignment::SelfCalibrate(SelfCalibrationConfig::new(calibrator, scheme.clone()));
    let mut rins = DrivenRins::new(&unit, 1);
    rins.expect_moves(&move_durations_s(&scheme, unit.rate_hz));
    let (plant, off) = Switched::new(rins);
    let switch = |message: &Message| {
        // Correction starts before the record is stored, so the queue must hold the samples during storing.
        if matches!(message, Message::State { state: State::Correcting | State::Parked, .. }) {
            off.set(true);
        }
    };
    in_emulator(&assignment, image, None, &mut Bench::with_imu(plant, image.imu), |_| (), switch)
}

/// Names of linked functions that must not be linked.
fn linked(file: &object::File<'_>, parts: &[&str]) -> Vec<String> {
    let names = file.symbols().filter(|symbol| symbol.is_definition()).filter_map(|symbol| symbol.name().ok());
    let demangled = names.map(|name| format!("{:#}", rustc_demangle::demangle(name)));
    demangled.filter(|name| parts.iter().any(|part| name.contains(part))).collect()
}
