//! The core on a log: `cargo run --release -p host-tests --example host -- LOG.csv`
use anyhow::{Context, Result};
use host_tests::{calibration::raw_sample, log::LogReader, quantity::sigmas, quantity::values, unit::UnitConfig};
use rins_selfcal::calibrator::{Calibrator, CalibratorConfig};
use rins_selfcal::{error_model::PARAMETER_INFO, method::Method, verdict::VerdictLimits};

fn main() -> Result<()> {
    let log = std::env::args().nth(1).context("which log?")?;
    let (reader, unit) = (LogReader::open(log.as_ref())?, UnitConfig::default());
    let rate_hz = 1e6 / reader.interval_us().context("a single sample")? as f64;
    let config = CalibratorConfig::new(Method::Joint, unit.site(), unit.noise.psd(), rate_hz);
    let mut calibrator = Box::new(Calibrator::<f64>::new(&config));
    for row in reader {
        let _estimate_so_far = calibrator.step(&raw_sample(&row?.reading));
    }
    let solution = calibrator.conclude(&mut |_message| ());
    let verdict = calibrator.judge(&solution, None, &VerdictLimits::default());
    let (values, sigmas) = (values(&solution.estimate.errors), sigmas(&solution.estimate.sigmas));
    for (info, (value, sigma)) in PARAMETER_INFO.iter().zip(values.iter().zip(sigmas)) {
        println!("{:26} {value:12.4} +- {sigma:.4} {}", info.name, info.unit);
    }
    println!("accepted: {}", verdict.accepted());
    Ok(())
}
