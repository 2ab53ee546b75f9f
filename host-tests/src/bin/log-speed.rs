//! Measures rows per second and peak memory while reading and replaying a long log in every format.

use anyhow::{Context, Result, ensure};
use clap::Parser;
use host_tests::calibration::Precision;
use host_tests::calibration::replay::Replay;
use host_tests::calibration::virtual_run::VirtualRun;
use host_tests::files::unit_file::UnitConfig;
use host_tests::log::{COLUMNS, Layout, LogReader, LogWriter, Mapping};
use host_tests::result::table::of_numbers;
use host_tests::virtual_unit::plant::Reading;
use host_tests::virtual_unit::presets::real;
use host_tests::virtual_unit::unit::VirtualUnit;
use nix::sys::resource::{UsageWho, getrusage};
use rins_selfcal::base::method::Method;
use rins_selfcal::scheme::Scheme;
use std::fs::File;
use std::hint::black_box;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Mapping of a matrix with the standard columns.
const MATRIX_MAPPING: &str = "[time]\ncolumn = 1\nstamp = \"middle\"\n[gyro]\ncolumns = [2, 3, 4]\nunit = \"rad/s\"\n[accel]\n\
                              columns = [5, 6, 7]\nunit = \"m/s^2\"\n";

/// Simulates a log of 7829 s of scheme bai, writes it in every format, and replays each file in a separate process.
#[derive(Parser)]
struct Arguments {
    /// Duration of every stop, s; a row is 5 ms
    #[arg(long, default_value_t = 200.0)]
    stop: f64,
    /// Only measure this log
    #[arg(long, hide = true)]
    measure: Option<PathBuf>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    match arguments.measure {
        Some(log) => measure(&log),
        None => compare(arguments.stop),
    }
}

fn compare(stop_s: f64) -> Result<()> {
    let folder = tempfile::tempdir()?;
    let logs = ["log.csv", "log.csv.gz", "log.parquet", "log.f64"].map(|name| folder.path().join(name));
    let unit = VirtualUnit { errors: real(1), ..VirtualUnit::default() };
    let rows = write(&VirtualRun { unit, scheme: Scheme::bai(stop_s, 2), seed: 1 }, &logs)?;
    println!("{rows} rows");
    let mut table = Vec::new();
    for log in &logs {
        let mut row = vec![
            log.file_name().unwrap_or_default().to_string_lossy().into(),
            format!("{:.0}", log.metadata()?.len() as f64 * 1e-6),
        ];
        let output = Command::new(std::env::current_exe()?).arg("--measure").arg(log).output()?;
        ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        row.extend(String::from_utf8(output.stdout)?.split_whitespace().map(String::from));
        table.push(row);
    }
    let columns = ["log", "MB", "read rows/s", "replay rows/s", "replay s", "of it CPU s", "peak memory MB"];
    print!("{}", of_numbers(&columns, table));
    Ok(())
}

fn write(run: &VirtualRun, logs: &[PathBuf; 4]) -> Result<u64> {
    let [csv, gzip, parquet, matrix] = logs;
    let mut writers = Vec::new();
    for path in [csv, gzip, parquet] {
        writers.push(LogWriter::create(path, false)?);
    }
    let mut output = BufWriter::new(File::create(matrix)?);
    std::fs::write(matrix.with_extension("toml"), MATRIX_MAPPING)?;
    let mut rows = 0;
    for reading in run.drive() {
        rows += 1;
        writers.iter_mut().try_for_each(|writer| writer.write(&reading))?;
        row(&reading).iter().try_for_each(|value| output.write_all(&value.to_le_bytes()))?;
    }
    output.flush()?;
    writers.into_iter().try_for_each(LogWriter::finish)?;
    Ok(rows)
}

fn row(reading: &Reading) -> [f64; COLUMNS.len()] {
    let ([gx, gy, gz], [ax, ay, az]) = (reading.omega_g, reading.force_a);
    [reading.time_us as f64 * 1e-6, gx, gy, gz, ax, ay, az, reading.outer_rad, reading.inner_rad]
}

fn measure(log: &Path) -> Result<()> {
    let layout = match log.extension() {
        Some(ending) if ending == "f64" => Mapping::read(&log.with_extension("toml"), log)?,
        _ => Layout::standard(log),
    };
    let start = Instant::now();
    let mut rows = 0;
    for row in LogReader::open_as(log, &layout)? {
        black_box(row?);
        rows += 1;
    }
    let read_s = start.elapsed().as_secs_f64();
    let (path, unit) = (log.into(), UnitConfig::default());
    let precision = Precision::F64;
    let replay = Replay { path, layout, unit, method: Method::Joint.into(), precision, adapt: false };
    let (start, cpu) = (Instant::now(), usage()?.0);
    let outcome = replay.run(|_| (), |_| ())?;
    let (wall_s, (now, peak_mb)) = (start.elapsed().as_secs_f64(), usage()?);
    ensure!(outcome.verdict.accepted(), "{}: {}", log.display(), outcome.reasons().join("; "));
    let rows = f64::from(rows);
    println!("{:.0} {:.0} {wall_s:.2} {:.2} {peak_mb:.0}", rows / read_s, rows / wall_s, now - cpu);
    Ok(())
}

/// Processor time, s, and peak memory so far, MB.
fn usage() -> Result<(f64, f64)> {
    let usage = getrusage(UsageWho::RUSAGE_SELF).context("the use of resources")?;
    let seconds = |time: nix::sys::time::TimeVal| time.tv_sec() as f64 + time.tv_usec() as f64 * 1e-6;
    Ok((seconds(usage.user_time()) + seconds(usage.system_time()), usage.max_rss() as f64 * 1024e-6))
}
