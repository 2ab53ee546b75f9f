//! Prints the cost of each optional effect, with data that have the effect or not, and with the effect estimated or
//! not.

use anyhow::Context;
use clap::Parser;
use comfy_table::{CellAlignment, Table, presets};
use host_tests::calibration::Precision;
use host_tests::files::unit_file::UnitConfig;
use host_tests::study::monte_carlo::{ErrorSource, MethodStatistics, MonteCarlo};
use host_tests::virtual_unit::encoder::Harmonic;
use host_tests::virtual_unit::presets::{UnitErrors, real};
use host_tests::virtual_unit::unit::Effects;
use indicatif::ProgressBar;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::{DEG_H, MICRO_G};
use rins_selfcal::model::error_model::block;
use rins_selfcal::model::options::Options;
use rins_selfcal::scheme::Scheme;

/// Errors and chi-square for each effect beyond the 28 parameters, present or not, and estimated or not
#[derive(Parser)]
struct Arguments {
    /// Runs of each row
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    runs: u64,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// A scheme of the library
    #[arg(long, default_value = "fast-180")]
    scheme: String,
    /// Floating-point type of the core
    #[arg(long, value_enum, default_value_t)]
    precision: Precision,
}

/// An effect of a unit, and the options with which the joint method models the effect.
struct Row {
    name: &'static str,
    effects: Effects,
    options: Options,
}

fn rows() -> [Row; 5] {
    const SQRT_HOUR: f64 = 60.0;
    let harmonic = |amplitude_arcsec, phase_deg| Harmonic { amplitude_arcsec, phase_deg };
    let row = |name, effects, options| Row { name, effects, options };
    [
        row(
            "bias ramps, 400 ug/h, 2 (deg/h)/h",
            Effects {
                accel_bias_ramp_ug_h: [400.0, -300.0, 200.0],
                gyro_bias_ramp_deg_h_h: [2.0, 1.0, -2.0],
                ..Effects::default()
            },
            Options { bias_ramp: true, ..Options::NONE },
        ),
        row(
            "bias walks, 40 ug/sqrt(h), 0.4 (deg/h)/sqrt(h)",
            Effects { accel_bias_walk_ug_sqrt_h: 40.0, gyro_bias_walk_deg_h_sqrt_h: 0.4, ..Effects::default() },
            Options {
                accel_bias_walk: 40.0 * MICRO_G / SQRT_HOUR,
                gyro_bias_walk: 0.4 * DEG_H / SQRT_HOUR,
                ..Options::NONE
            },
        ),
        row(
            "encoder eccentricity, 4 arcsec",
            Effects { encoder_eccentricity: [harmonic(4.0, 30.0), harmonic(3.0, 200.0)], ..Effects::default() },
            Options { encoder_eccentricity: true, ..Options::NONE },
        ),
        row(
            "encoder second harmonic, 3 arcsec",
            Effects { encoder_second_harmonic: [harmonic(2.0, 80.0), harmonic(3.0, -40.0)], ..Effects::default() },
            Options { encoder_second_harmonic: true, ..Options::NONE },
        ),
        row(
            "base tilt drift, 100 arcsec/h",
            Effects { base_tilt_drift_arcsec_h: [100.0, -60.0], ..Effects::default() },
            Options { base_tilt_drift: true, ..Options::NONE },
        ),
    ]
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let name = &arguments.scheme;
    let scheme = Scheme::named(name).with_context(|| format!("the library has no scheme {name}"))?;
    let rows = rows();
    let bar = ProgressBar::new(arguments.runs * (1 + 3 * rows.len() as u64));
    let statistics = |effects: &Effects, options: Options| {
        let campaign = MonteCarlo {
            runs: arguments.runs,
            methods: vec![Method::Joint],
            precision: arguments.precision,
            options,
            scheme: scheme.clone(),
            axes: Default::default(),
            closed_loop: false,
            errors: ErrorSource::Fixed(Box::new(UnitErrors { errors: real(3), effects: effects.clone() })),
            refuse_unobserved: true,
            unit: UnitConfig::default(),
            rate_hz: 200.0,
            seed: arguments.seed,
        };
        campaign.run(|_| bar.inc(1)).map(|mut of_methods| of_methods.remove(0))
    };
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(["effect", "acts", "estimated", "accepted", "worst RMS arcsec", "error^2/sigma^2", "chi-square"]);
    let none = Effects::default();
    table.add_row(cells("none", ["no", "no"], &statistics(&none, Options::NONE)?));
    for Row { name, effects, options } in rows {
        table.add_row(cells(name, ["no", "yes"], &statistics(&none, options)?));
        table.add_row(cells("", ["yes", "no"], &statistics(&effects, Options::NONE)?));
        table.add_row(cells("", ["yes", "yes"], &statistics(&effects, options)?));
    }
    for column in table.column_iter_mut().skip(3) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    bar.finish_and_clear();
    println!(
        "{} runs per row of the unit \"real\" on {}, joint method; figures of the twelve installation errors:",
        arguments.runs, arguments.scheme
    );
    println!("{table}");
    Ok(())
}

/// Row with the worst RMS error and the mean squared normalized error of the twelve installation errors.
fn cells(name: &str, acts_and_estimated: [&str; 2], found: &MethodStatistics) -> [String; 7] {
    let twelve = || found.states[..block::ACCEL_BIAS].iter().flatten();
    let worst = twelve().map(|state| state.rms_error).fold(0.0, f64::max);
    let squared = twelve().map(|state| state.mean_normalized_squared).sum::<f64>() / twelve().count() as f64;
    let fit = &found.fit;
    let [acts, estimated] = acts_and_estimated.map(String::from);
    [
        name.into(),
        acts,
        estimated,
        format!("{}/{}", found.accepted, found.runs),
        format!("{worst:.2}"),
        format!("{squared:.2}"),
        format!("{:.1}/{:.1}", fit.mean_chi_square, fit.mean_degrees_of_freedom),
    ]
}
