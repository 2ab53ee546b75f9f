//! Time per sample of the virtual RINS, at rest and turning, and per row of a log written and read: `cargo bench --bench plant_speed`.

use host_tests::files::unit_file::Noise;
use host_tests::log::{LogError, LogReader, LogWriter};
use host_tests::virtual_unit::presets::real;
use host_tests::virtual_unit::unit::{Effects, VirtualUnit};
use host_tests::virtual_unit::virtual_rins::VirtualRins;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

const SAMPLES: u32 = 4_000_000;

fn ns_per_sample(unit: &VirtualUnit, rates_rad_s: [f64; 2]) -> f64 {
    let mut rins = VirtualRins::new(unit, 1);
    let start = Instant::now();
    for _ in 0..SAMPLES {
        rins.command_rates(rates_rad_s);
        black_box(rins.advance());
    }
    start.elapsed().as_secs_f64() * 1e9 / f64::from(SAMPLES)
}

const ROWS: u32 = 300_000;

/// Times of writing and of reading, ns per row.
fn ns_per_row(unit: &VirtualUnit, path: &Path) -> Result<[f64; 2], LogError> {
    let mut rins = VirtualRins::new(unit, 1);
    let ns = |start: Instant| start.elapsed().as_secs_f64() * 1e9 / f64::from(ROWS);
    let start = Instant::now();
    let mut writer = LogWriter::create(path, false)?;
    for _ in 0..ROWS {
        writer.write(&rins.advance())?;
    }
    writer.finish()?;
    let write_ns = ns(start);
    let start = Instant::now();
    for row in LogReader::open(path)? {
        black_box(row?);
    }
    Ok([write_ns, ns(start)])
}

fn main() -> Result<(), LogError> {
    let effects = Effects { lever_arm_m: [0.02, -0.01, 0.03], ..Effects::default() };
    let unit = VirtualUnit { errors: real(1), noise: Noise::bai(), effects, ..VirtualUnit::default() };
    for (name, rates) in [("at rest", [0.0; 2]), ("one axis turning", [0.35, 0.0]), ("both turning", [0.35, 0.3])] {
        println!("{name}: {:.0} ns per sample", ns_per_sample(&unit, rates));
    }
    for name in ["plant_speed.csv", "plant_speed.csv.gz"] {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let [write, read] = ns_per_row(&unit, &path)?;
        println!("{name}: writing {write:.0}, reading {read:.0} ns per row");
    }
    Ok(())
}
