//! `rins apply`

use super::arguments::log::LogArguments;
use super::ending::Ending;
use super::output::{note, sayln};
use super::{files, progress};
use crate::calibration::raw_sample;
use crate::log::{LogReader, LogWriter};
use crate::result::saved::Saved;
use crate::virtual_unit::plant::Reading;
use clap::{Args, ValueEnum};
use rins_selfcal::base::linear::Vector3;
use rins_selfcal::model::correction::Calibration;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct ApplyArguments {
    #[command(flatten)]
    pub source: LogArguments,
    /// Result of `replay --json` or `calibrate --json`
    #[arg(long, value_name = "CAL.json")]
    pub calibration: PathBuf,
    /// Corrected log to write: CSV, CSV compressed with gzip if the name ends in .gz, or Parquet
    #[arg(long, value_name = "CORRECTED.csv")]
    pub out: PathBuf,
    /// Frame of the corrected angular rates and specific forces
    #[arg(long, value_enum, default_value_t)]
    pub frame: FrameArgument,
}

/// Frame of the corrected angular rates and specific forces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum FrameArgument {
    /// IMU frame s: x along accelerometer x
    #[default]
    Imu,
    /// Rotation frame r: x along the outer axis at inner angle 0, z along the inner axis
    Rotation,
}

/// Rows between two updates of the progress counter.
const TICK: u64 = 10_000;

pub fn run(arguments: &ApplyArguments) -> anyhow::Result<Ending> {
    let [log, mapping] = arguments.source.inputs();
    let calibration = ("--calibration", Some(arguments.calibration.as_path()));
    files::check(&[log, mapping, calibration], &[("--out", Some(arguments.out.as_path()))])?;
    let saved = Saved::read(&arguments.calibration)?;
    if !saved.is_accepted() {
        note!("{} is {}", saved.path.display(), saved.verdict);
    }
    let reader = LogReader::open_as(&arguments.source.log, &arguments.source.layout()?)?;
    let rows = correct(reader, &saved.calibration(), arguments).inspect_err(|_| {
        // An incomplete log must not be taken for a complete log.
        if arguments.out.is_file() {
            let _ = std::fs::remove_file(&arguments.out);
        }
    })?;
    let frame = if arguments.frame == FrameArgument::Imu { "IMU" } else { "rotation" };
    sayln!("{}: {rows} rows corrected, in the {frame} frame", arguments.out.display());
    Ok(Ending::Done)
}

fn correct(reader: LogReader, calibration: &Calibration<f64>, arguments: &ApplyArguments) -> anyhow::Result<u64> {
    let mut writer = LogWriter::create(&arguments.out, reader.has_temperature())?;
    let counter = progress::counter("rows");
    let mut rows = 0;
    for row in reader {
        writer.write(&corrected(&row?.reading, calibration, arguments.frame))?;
        rows += 1;
        if rows % TICK == 0 {
            counter.set_position(rows);
        }
    }
    drop(counter);
    writer.finish()?;
    Ok(rows)
}

fn corrected(reading: &Reading, calibration: &Calibration<f64>, frame: FrameArgument) -> Reading {
    let sample = calibration.correct(&raw_sample(reading));
    let expressed = |vector_s: Vector3<f64>| match frame {
        FrameArgument::Imu => vector_s.into(),
        FrameArgument::Rotation => (calibration.rot_sr().transpose() * vector_s).into(),
    };
    Reading { omega_g: expressed(sample.omega_is_s), force_a: expressed(sample.force_s), ..*reading }
}
