//! Runs the image of the board STM32H743 on its register model and prints what the chapter `board` and a review need:
//! every register that was written, the pins, the times of the interrupts, and every access that the chip forbids.
//!
//! ```sh
//! cargo run --release -p host-tests --bin h743-report            # a whole calibration
//! cargo run --release -p host-tests --bin h743-report -- --short # power-up only
//! ```

use anyhow::{Result, ensure};
use clap::Parser;
use host_tests::bench::emulator::MachineSetup;
use host_tests::bench::emulator::h743::{Interrupt, Report, Written, run};
use host_tests::bench::emulator::image::{Board, Variant, build};
use host_tests::bench::power_up::Switched;
use host_tests::bench::{Bench, Imu};
use host_tests::virtual_unit::drive::move_durations_s;
use host_tests::virtual_unit::driven::DrivenRins;
use host_tests::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::method::Method;
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::config::{CalibratorConfig, SelfCalibrationConfig};
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;

#[derive(Debug, Parser)]
struct Arguments {
    /// IMU of the image
    #[arg(long, value_enum, default_value_t)]
    imu: Imu,
    /// End with the first turn
    #[arg(long)]
    short: bool,
    /// Arguments for the machine, such as --hse=absent
    #[arg(last = true)]
    machine: Vec<String>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let image = build(Variant { board: Board::Stm32h743, imu: arguments.imu })?;
    let unit = VirtualUnit::default();
    let scheme = Scheme::named("fast-60").expect("in the library");
    let mut rins = DrivenRins::new(&unit, 1);
    rins.expect_moves(&move_durations_s(&scheme, unit.rate_hz));
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    let assignment = Assignment::SelfCalibrate(SelfCalibrationConfig::new(calibrator, scheme));
    let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
    let configuration = postcard::to_slice(&assignment, &mut buffer)?;
    let (plant, off) = Switched::new(rins);
    let given: Vec<&str> = std::iter::once("--trace").chain(arguments.machine.iter().map(String::as_str)).collect();
    let setup = MachineSetup { configuration, arguments: &given, ..MachineSetup::new(&image) };
    let mut corrected = 0;
    let on_message = |message: &Message| {
        corrected += u32::from(matches!(message, Message::Corrected { .. }));
        let turns = matches!(message, Message::State { state: State::Turn(1), .. });
        off.set(off.get() || corrected >= 3 || arguments.short && turns);
    };
    let report = run(&setup, &mut Bench::with_imu(plant, arguments.imu), |line| println!("log: {line}"), on_message)?;
    print(&report);
    ensure!(report.violations.is_empty(), "the image accesses the chip in ways that it forbids");
    Ok(())
}

fn print(report: &Report) {
    println!("{:?} after {:.3} s, {:.1} s wall", report.ended, report.elapsed_us * 1e-6, report.wall_s);
    println!("{:18} {:8} {:>8} {:>8}  values; meaning of the last one", "register", "address", "reads", "writes");
    for Written { name, address, reads, writes, values, meaning } in &report.registers {
        let values: Vec<String> = values.iter().map(|value| format!("{value:x}")).collect();
        println!("{name:18} {address:08x} {reads:8} {writes:8}  {}; {meaning}", values.join(" "));
    }
    println!("\npins: {}\n", report.pins.join(", "));
    println!("{:20} {:>8} {:>18} {:>20}", "interrupt", "times", "longest wait, us", "longest handler, us");
    for Interrupt { name, taken, longest_wait_us, longest_run_us } in &report.interrupts {
        println!("{name:20} {taken:8} {longest_wait_us:18.1} {longest_run_us:20.1}");
    }
    println!(
        "at most {} handlers nested; interrupts masked for at most {:.1} us, until {:#x}; late control periods: {}",
        report.deepest_nesting, report.longest_masked_us, report.masked_until, report.late_periods
    );
    println!("stack {} of {} bytes; asleep {:.1} %", report.stack_used_bytes, report.stack_bytes, 100.0 * report.idle);
    println!("watchdog started at {:?} us; closed by the MPU: {:x?}", report.watchdog_started_us, report.closed);
    println!("bytes lost by overruns: {:?}; changes of the flash: {}", report.overruns, report.flash_changes.len());
    println!("accesses that the chip forbids: {:#?}", report.violations);
}
