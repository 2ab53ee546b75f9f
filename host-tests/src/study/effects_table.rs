//! Each effect of real hardware alone, at several sizes: what the calibration says, and whether it is right.

use super::monte_carlo::{ErrorSource, MonteCarlo, RunResult};
use crate::calibration::{HostMethod, Precision};
use crate::files::unit_file::UnitConfig;
use crate::virtual_unit::unit::Effects;
use anyhow::Result;
use rins_selfcal::base::hardware::{HARDWARE, Hardware, HardwareSize};
use rins_selfcal::model::error_model::{PARAMETER_INFO, block};
use rins_selfcal::scheme::Scheme;
use std::sync::Mutex;

/// What happened to the runs with one effect at one size on one scheme.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Number of runs.
    pub runs: u64,
    /// Runs that were accepted.
    pub accepted: u64,
    /// Runs that were accepted with one of the twelve or the non-perpendicularity wrong.
    pub wrong: u64,
    /// The largest mean square of error over sigma among the parameters of accepted runs, and the parameter.
    pub dishonest: (f64, &'static str),
    /// The most frequent code of the first reason, and how often it came.
    pub reason: Option<(String, u64)>,
}

/// The effects that a unit of navigation grade has.
pub fn effects() -> impl Iterator<Item = &'static HardwareSize> {
    HARDWARE.iter().filter(|size| size.get(&Hardware::NAVIGATION) > 0.0)
}

/// Units with one effect of the hardware at this many times its typical size.
pub fn alone(effect: &HardwareSize, times: f64) -> ErrorSource {
    let mut hardware = Hardware::IDEAL;
    effect.set(&mut hardware, times * effect.get(&Hardware::NAVIGATION));
    ErrorSource::With(Box::new(hardware))
}

/// Keys of the hardware whose effects have no state in the filter: it takes them as noise.
pub const NOISE_KEYS: [&str; 6] = [
    "accel_cross_quadratic_ug_g2",
    "gyro_g_sensitivity_deg_h_g",
    "encoder_subdivision_arcsec",
    "base_rocking_arcsec",
    "gyro_pulse_arcsec",
    "accel_pulse_mm_s",
];

/// An effect that no size of the hardware describes.
pub struct Further {
    /// Name, with the unit.
    pub name: &'static str,
    /// Sizes, the harmless one first.
    pub sizes: &'static [f64],
    set: fn(&mut Effects, f64),
}

impl Further {
    /// Units with this effect alone.
    pub fn alone(&self, size: f64) -> ErrorSource {
        let mut effects = Effects::default();
        (self.set)(&mut effects, size);
        ErrorSource::Beside(Box::new(effects))
    }
}

/// The site is elsewhere than configured, at half to five times the sigmas of a site that is given. Height and gravity
/// are one: no scheme tells them from the scale that the accelerometers have in common.
pub static SITE: [Further; 3] = [
    Further {
        name: "latitude_error_deg",
        sizes: &[0.01, 0.02, 0.04, 0.1],
        set: |effects, size| effects.hardware.latitude_error_deg = size,
    },
    Further {
        name: "height_error_m",
        sizes: &[15.0, 30.0, 60.0, 150.0],
        set: |effects, size| effects.hardware.height_error_m = size,
    },
    Further {
        name: "gravity_anomaly_mgal",
        sizes: &[10.0, 20.0, 40.0, 100.0],
        set: |effects, size| effects.hardware.gravity_anomaly_mgal = size,
    },
];

/// The effects that no size of the hardware describes.
pub static FURTHER: [Further; 6] = [
    Further {
        name: "lever_arm_m",
        sizes: &[0.05, 0.1, 0.2, 0.5, 1.0],
        set: |effects, size| effects.lever_arm_m = [size, -size, size],
    },
    Further {
        name: "sensor_bandwidth_hz",
        sizes: &[50.0, 20.0, 10.0, 5.0, 2.0],
        set: |effects, size| effects.sensor_bandwidth_hz = Some(size),
    },
    Further {
        name: "sensor_delay_ms",
        sizes: &[1.0, 2.0, 5.0, 10.0, 20.0],
        set: |effects, size| effects.sensor_delay_ms = size,
    },
    Further {
        name: "encoder_bits",
        sizes: &[26.0, 24.0, 22.0, 20.0, 18.0],
        set: |effects, size| effects.encoder_bits = Some(size as u8),
    },
    Further {
        name: "hunting_3_hz_arcsec",
        sizes: &[0.3, 1.0, 3.0, 8.0, 20.0],
        set: |effects, size| (effects.hunting_arcsec, effects.hunting_hz) = (size, 3.0),
    },
    Further {
        name: "accel_bias_ramp_ug_h",
        sizes: &[20.0, 50.0, 100.0, 200.0, 500.0],
        set: |effects, size| effects.accel_bias_ramp_ug_h = [size, -size, size],
    },
];

/// Runs units of a source on a scheme, with hardware of navigation grade configured.
///
/// # Errors
/// The core refuses the configuration.
pub fn row(errors: ErrorSource, scheme: &Scheme, runs: u64, seed: u64) -> Result<Row> {
    let campaign = MonteCarlo {
        runs,
        methods: vec![HostMethod::Joint],
        precision: Precision::F64,
        scheme: scheme.clone(),
        axes: Default::default(),
        closed_loop: false,
        errors,
        refuse_unobserved: true,
        unit: UnitConfig::default().somewhere(),
        rate_hz: 200.0,
        seed,
    };
    let results = Mutex::new(Vec::<RunResult>::new());
    campaign.run(|of_methods| {
        if let Ok(mut results) = results.lock() {
            results.extend_from_slice(of_methods);
        }
    })?;
    let mut results = results.into_inner().unwrap_or_default();
    // The runs end in any order, which must not change the figures.
    results.sort_by(|a, b| a.normalized(0).total_cmp(&b.normalized(0)));
    Ok(Row {
        runs,
        accepted: results.iter().filter(|run| run.accepted()).count() as u64,
        wrong: results.iter().filter(|run| run.accepted() && run.is_wrong()).count() as u64,
        dishonest: dishonest(&results),
        reason: most_frequent(results.iter().filter_map(RunResult::first_code)),
    })
}

/// The heading is left out: near its limits it is not normally distributed.
fn dishonest(results: &[RunResult]) -> (f64, &'static str) {
    let accepted: Vec<_> = results.iter().filter(|run| run.accepted()).collect();
    let of = |parameter: usize| {
        let squares = accepted.iter().map(|run| run.normalized(parameter).powi(2));
        (squares.sum::<f64>() / accepted.len().max(1) as f64, PARAMETER_INFO[parameter].name)
    };
    (0..block::HEADING).map(of).fold((0.0, ""), |worst, of| if of.0 > worst.0 { of } else { worst })
}

fn most_frequent<'a>(codes: impl Iterator<Item = &'a str> + Clone) -> Option<(String, u64)> {
    let count = |code: &str| codes.clone().filter(|other| *other == code).count() as u64;
    let best = codes.clone().max_by_key(|code| (count(code), *code))?;
    Some((best.into(), count(best)))
}
