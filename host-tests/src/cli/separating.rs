//! `--method separating` and `--method svd`: the methods that the paper compares itself with.

use super::arguments::log::LogArguments;
use super::ending::Ending;
use super::output::{say, sayln};
use super::progress;
use crate::base::quantity::{self, fixed, rounded, significant};
use crate::files::json_file::write_json;
use crate::files::truth::{ParameterTable, Truth};
use crate::files::unit_file::UnitConfig;
use crate::log::LogReader;
use crate::result::report::{Named, SOFTWARE, Software};
use crate::result::table;
use crate::separating::{RunBuilder, SensorNoise, Separated, SeparatingMethod, separate};
use crate::study::separating::{SeparatedStatistics, SeparatingStudy};
use anyhow::{Context, bail};
use rins_selfcal::model::error_model::{INSTALLATION_STATES, PARAMETER_INFO, ParameterInfo};
use serde::Serialize;
use std::path::Path;

/// Number of rows between two updates of the counter.
const ROWS_PER_TICK: u64 = 10_000;

/// Result of one calibration in the JSON file.
#[derive(Serialize)]
struct SeparatedReport {
    method: &'static str,
    parameters: Named<AngleReport>,
    software: Software,
}

#[derive(Serialize)]
struct AngleReport {
    value: f64,
    /// The methods for the mounting angles have no sigma.
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma: Option<f64>,
    unit: &'static str,
}

/// Files of `rins replay` that a separating method reads and writes.
pub struct Files<'a> {
    pub source: &'a LogArguments,
    pub truth: Option<&'a Path>,
    pub json: Option<&'a Path>,
}

/// `rins replay` with a separating method.
pub fn replay(files: &Files, unit: &UnitConfig, method: SeparatingMethod) -> anyhow::Result<Ending> {
    let name = method.name();
    if unit.site.latitude_deg.is_none() {
        bail!("--method {name} needs the latitude: give latitude_deg in the table [site] of --config");
    }
    let truth = files.truth.map(Truth::read).transpose()?;
    let log = files.source.log.as_path();
    let counter = progress::counter("rows");
    let mut builder = RunBuilder::default();
    for (row, number) in LogReader::open_as(log, &files.source.layout()?)?.zip(1..) {
        builder.note(&row?.reading);
        if number % ROWS_PER_TICK == 0 {
            counter.set_position(number);
        }
    }
    drop(counter);
    let of_log = || log.display().to_string();
    let run = builder.build().with_context(of_log)?;
    let found = separate(&run, &unit.site(), &SensorNoise::from(&unit.noise), method).with_context(of_log)?;
    if let Some(path) = files.json {
        write_json(path, &SeparatedReport::new(&found, method))?;
    }
    say!("{}", angles(&found, truth.as_ref().map(|truth| &truth.parameters)));
    sayln!("\n{name} method: {}", principle(method));
    if let Some(path) = files.json {
        sayln!("result: {}", path.display());
    }
    Ok(Ending::Done)
}

/// Where the angles come from, in words.
fn principle(method: SeparatingMethod) -> &'static str {
    match method {
        SeparatingMethod::ThinShell => {
            "non-orthogonality by [11], a Kalman filter on a strapdown navigation; mounting angles by [13], a thin-shell \
             search on the residual rotation; both take the axes as perpendicular, and there is no verdict"
        }
        SeparatingMethod::SingularValues => {
            "non-orthogonality by [11], a Kalman filter on a strapdown navigation; mounting angles by [14], the singular \
             values of the forces at the stops; both take the axes as perpendicular, and there is no verdict"
        }
    }
}

impl SeparatedReport {
    fn new(found: &Separated, method: SeparatingMethod) -> Self {
        let angle = |(info, (value, sigma)): (&'static ParameterInfo, _)| {
            (info.name, AngleReport { value, sigma, unit: info.unit })
        };
        let angles = PARAMETER_INFO.iter().zip(found.installation_arcsec()).map(angle).collect();
        Self { method: method.name(), parameters: Named(angles), software: SOFTWARE }
    }
}

/// Estimates with sigmas, and with errors if the truth is known.
fn angles(found: &Separated, truth: Option<&ParameterTable>) -> String {
    let columns: &[&str] = match truth {
        None => &["estimate", "sigma"],
        Some(_) => &["estimate", "sigma", "truth", "error"],
    };
    let angles = found.installation_arcsec();
    table::by_parameter(columns, |index| {
        let (value, sigma) = angles.get(index)?;
        let shown = |number: f64| sigma.map_or_else(|| fixed(number, 3), |sigma| rounded(number, sigma));
        let mut cells = vec![shown(*value), table::number_or_none(*sigma, significant)];
        if let Some(truth) = truth {
            let truth = truth.0[index];
            let error = truth.map(|truth| quantity::error(index, *value, truth));
            cells.extend([truth, error].map(|number| table::number_or_none(number, shown)));
        }
        Some(cells)
    })
}

/// Statistics of many runs as a table.
pub fn study_text(study: &SeparatingStudy) -> String {
    let name = study.method.name();
    let mut text = format!("{name} method: {} runs, {} without a result\n", study.runs, study.failures.len());
    for failure in study.failures.iter().take(1) {
        text += &format!("  - {failure}\n");
    }
    let columns = ["RMS error", "mean error", "sigma", "(error/sigma)^2"];
    let table = table::by_parameter(&columns, |index| {
        let found = study.installation.get(index)?.as_ref()?;
        Some(vec![
            significant(found.rms_error),
            rounded(found.mean_error, found.rms_error),
            table::number_or_none(found.sigma, significant),
            table::number_or_none(found.mean_normalized_squared, |mean| fixed(mean, 3)),
        ])
    });
    format!("{text}\n{table}")
}

/// Statistics of many runs in the JSON file.
#[derive(Serialize)]
pub struct SeparatingReport {
    runs: usize,
    without_result: usize,
    parameters: Named<SeparatedStatistics>,
}

impl From<&SeparatingStudy> for SeparatingReport {
    fn from(study: &SeparatingStudy) -> Self {
        let angles = PARAMETER_INFO[..INSTALLATION_STATES].iter().zip(&study.installation);
        let angles = angles.filter_map(|(info, found)| found.map(|found| (info.name, found))).collect();
        Self { runs: study.runs, without_result: study.failures.len(), parameters: Named(angles) }
    }
}
