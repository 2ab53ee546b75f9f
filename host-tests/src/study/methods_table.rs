//! All methods on the same data: the scheme of the paper with units of its two tables, and with units that have what a
//! real one has.

use super::monte_carlo::{ErrorSource, MethodStatistics, MonteCarlo};
use super::separating::{SeparatedStatistics, SeparatingStudy, separating_studies};
use super::statistics::ErrorStatistics;
use crate::base::quantity::{fixed, significant};
use crate::calibration::{HostMethod, Precision};
use crate::files::unit_file::{Noise, UnitConfig};
use crate::result::table;
use crate::separating::SeparatingMethod;
use anyhow::Result;
use clap::ValueEnum;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, PARAMETER_INFO};
use rins_selfcal::scheme::Scheme;

/// Units of one kind.
#[derive(Clone, Copy, Debug)]
pub struct UnitKind {
    /// Name, as [`ErrorSource::named`] knows it.
    pub errors: &'static str,
    /// What the errors and the noise are, in words.
    pub title: &'static str,
    config: fn() -> UnitConfig,
}

/// The noise of the paper's simulation, and nothing else.
fn of_the_paper() -> UnitConfig {
    UnitConfig { noise: Noise::bai(), ..UnitConfig::ideal() }
}

/// The units of the table.
pub static UNITS: [UnitKind; 4] = [
    UnitKind { errors: "table1", title: "the twelve errors of Table 1, noise bai", config: of_the_paper },
    UnitKind { errors: "table3", title: "the twelve errors of Table 3, noise bai", config: of_the_paper },
    UnitKind {
        errors: "real",
        title: "Table 3, with biases, scale factors, non-perpendicularity and tilt, noise bai",
        config: of_the_paper,
    },
    UnitKind {
        errors: "typical",
        title: "random errors and all imperfections of navigation grade, noise navigation",
        config: || UnitConfig::default().somewhere(),
    },
];

/// The runs of every row.
#[derive(Clone, Copy, Debug)]
pub struct Terms {
    /// Number of units of each kind.
    pub runs: u64,
    /// Duration of every stop of the scheme "bai", which is run twice, s.
    pub stop_s: f64,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// The statistics of every method, on the same units.
#[derive(Clone, Debug)]
pub struct Row {
    /// The methods of the core's chain.
    pub methods: Vec<MethodStatistics>,
    /// The separating methods.
    pub separated: Vec<SeparatingStudy>,
}

/// Runs every method on units of one kind.
///
/// # Errors
/// The core refuses the scheme.
pub fn row(kind: &UnitKind, terms: &Terms) -> Result<Row> {
    let campaign = MonteCarlo {
        runs: terms.runs,
        methods: HostMethod::value_variants().to_vec(),
        precision: Precision::F64,
        scheme: Scheme::bai(terms.stop_s, 2),
        axes: Default::default(),
        closed_loop: false,
        errors: ErrorSource::named(kind.errors)?,
        refuse_unobserved: true,
        unit: (kind.config)(),
        rate_hz: 200.0,
        seed: terms.seed,
    };
    let separated = separating_studies(&campaign, SeparatingMethod::value_variants(), || ());
    Ok(Row { methods: campaign.run(|_| ())?, separated })
}

/// The worst of the twelve installation errors with its name, and in how many of them the sigmas are honest.
pub fn summary(kind: &UnitKind, row: &Row) -> Vec<Vec<String>> {
    let of_method = |method: &MethodStatistics| {
        let twelve = || method.states[..INSTALLATION_STATES].iter().flatten().zip(&PARAMETER_INFO);
        let worst = |of: fn(&ErrorStatistics) -> f64| {
            let all = twelve().map(|(errors, info)| (of(errors), info.name));
            all.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
                .map_or_else(|| "-".to_string(), |(value, name)| format!("{} {name}", significant(value)))
        };
        let [low, high] = method.normalized_bounds;
        let inside = twelve().filter(|(errors, _)| (low..=high).contains(&errors.mean_normalized_squared)).count();
        vec![
            kind.errors.into(),
            method.method.name().into(),
            worst(|errors| errors.rms_error),
            worst(|errors| errors.mean_error),
            worst(|errors| errors.mean_normalized_squared),
            format!("{inside} of {INSTALLATION_STATES}"),
            format!("{} of {}", method.accepted, method.runs),
        ]
    };
    let of_study = |study: &SeparatingStudy| {
        let worst = |of: fn(&SeparatedStatistics) -> Option<f64>| {
            let all = study.installation.iter().flatten().zip(&PARAMETER_INFO);
            let all = all.filter_map(|(errors, info)| Some((of(errors)?, info.name)));
            all.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
                .map_or_else(|| "-".to_string(), |(value, name)| format!("{} {name}", significant(value)))
        };
        let [low, high] = study.normalized_bounds();
        let squares = || study.installation.iter().flatten().filter_map(|errors| errors.mean_normalized_squared);
        let inside = squares().filter(|squared| (low..=high).contains(squared)).count();
        vec![
            kind.errors.into(),
            study.method.name().into(),
            worst(|errors| Some(errors.rms_error)),
            worst(|errors| Some(errors.mean_error)),
            worst(|errors| errors.mean_normalized_squared),
            format!("{inside} of {}", squares().count()),
            "-".into(),
        ]
    };
    row.methods.iter().map(of_method).chain(row.separated.iter().map(of_study)).collect()
}

/// Heads of the columns of [`summary`].
pub const SUMMARY_COLUMNS: [&str; 7] =
    ["errors", "method", "worst RMS, arcsec", "worst mean", "worst (error/sigma)^2", "honest", "accepted"];

/// RMS error, mean error and mean (error/sigma)^2 of the twelve with every method, with a mark if the sigma is not honest.
pub fn parameters(row: &Row) -> String {
    let names = row.methods.iter().map(|method| method.method.name());
    let names = names.chain(row.separated.iter().map(|study| study.method.name()));
    let columns: Vec<String> =
        names.flat_map(|name| [format!("{name} RMS"), "mean".into(), "(error/sigma)^2".into()]).collect();
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    table::by_parameter(&columns, |index| {
        (index < INSTALLATION_STATES).then(|| {
            let of_method = row.methods.iter().flat_map(|method| {
                let errors = method.states[index];
                let of = |errors: ErrorStatistics| {
                    let squared = Some(errors.mean_normalized_squared);
                    cells(errors.rms_error, errors.mean_error, squared, method.normalized_bounds)
                };
                errors.map_or([const { String::new() }; 3], of)
            });
            let of_study = row.separated.iter().flat_map(|study| {
                let of = |errors: SeparatedStatistics| {
                    let squared = errors.mean_normalized_squared;
                    cells(errors.rms_error, errors.mean_error, squared, study.normalized_bounds())
                };
                study.installation[index].map_or([const { String::new() }; 3], of)
            });
            of_method.chain(of_study).collect()
        })
    })
}

/// Cells of one parameter with one method. A method without sigmas has no `(error/sigma)^2`.
fn cells(rms_error: f64, mean_error: f64, squared: Option<f64>, [low, high]: [f64; 2]) -> [String; 3] {
    let squared = table::number_or_none(squared, |squared| {
        fixed(squared, 2) + if (low..=high).contains(&squared) { " " } else { "!" }
    });
    [significant(rms_error), fixed(mean_error, 3), squared]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_papers_method_is_off_on_a_unit_with_other_errors() {
        let terms = Terms { runs: 4, stop_s: 2.0, seed: 1 };
        let [table1, _, real, _] = &UNITS;
        let worst = |kind: &UnitKind, method: HostMethod| {
            let rows = row(kind, &terms).expect("statistics");
            let found = rows.methods.iter().find(|row| row.method == method).expect("every method is in the table");
            found.states[..INSTALLATION_STATES]
                .iter()
                .flatten()
                .map(|errors| errors.mean_error.abs())
                .fold(0.0, f64::max)
        };
        // A bias of 30 ug is a tilt of 6 arcsec.
        assert!(worst(real, HostMethod::Bai) > 4.0);
        assert!(worst(table1, HostMethod::Bai) < 2.0 && worst(real, HostMethod::Joint) < 2.0);
        // The separating methods take the axes as perpendicular: their mounting angles alone are off, by 2 arcsec or more.
        for study in row(real, &terms).expect("statistics").separated {
            let means = study.installation.map(|errors| errors.expect("statistics").mean_error.abs());
            let [nine, mounting] = [&means[..9], &means[9..]].map(|means| means.iter().copied().fold(0.0, f64::max));
            assert!(nine < 0.5 && (1.5..4.0).contains(&mounting), "{:?}: {means:?}", study.method);
        }
    }
}
