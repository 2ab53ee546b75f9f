//! The core processes a log: `cargo run --release -p host-tests --example host -- LOG.csv`
use anyhow::{Context, Result};
use host_tests::base::quantity::sigmas;
use host_tests::base::quantity::values;
use host_tests::calibration::raw_sample;
use host_tests::files::unit_file::UnitConfig;
use host_tests::log::LogReader;
use rins_selfcal::base::method::Method;
use rins_selfcal::estimator::Estimate;
use rins_selfcal::model::error_model::PARAMETER_INFO;
use rins_selfcal::run::calibrator::Calibrator;
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::verdict::VerdictLimits;

fn main() -> Result<()> {
    let (estimate, accepted) = calibrate(&std::env::args().nth(1).context("which log?")?)?;
    let (values, sigmas) = (values(&estimate.errors), sigmas(&estimate.sigmas));
    for (info, (value, sigma)) in PARAMETER_INFO.iter().zip(values.iter().zip(sigmas)) {
        println!("{:26} {value:12.4} +- {sigma:.4} {}", info.name, info.unit);
    }
    println!("accepted: {accepted}");
    Ok(())
}

/// Calibrates a log of an unknown site and with the default noise and hardware. Returns the estimate, and whether the
/// verdict accepts it.
pub fn calibrate(log: &str) -> Result<(Estimate, bool)> {
    let (reader, unit) = (LogReader::open(log.as_ref())?, UnitConfig::default());
    let rate_hz = 1e6 / reader.interval_us().context("a single sample")? as f64;
    let mut config = CalibratorConfig::new(Method::Joint, unit.site(), unit.noise.psd(), rate_hz);
    (config.estimator.hardware, config.estimator.site_sigmas) = (unit.hardware(), unit.site_sigmas());
    let mut calibrator = Box::new(Calibrator::<f64>::new(&config));
    for row in reader {
        let _estimate_so_far = calibrator.step(&raw_sample(&row?.reading));
    }
    let solution = calibrator.conclude(&mut |_message| ());
    Ok((solution.estimate, calibrator.judge(&solution, None, &VerdictLimits::default()).accepted()))
}
