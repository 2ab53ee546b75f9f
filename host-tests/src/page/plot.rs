//! Predicted sigmas against scheme time, as an SVG.

use crate::plan::prediction::{Prediction, SegmentGain};
use anyhow::{Result, anyhow};
use plotters::prelude::*;
use rins_selfcal::model::error_model::INSTALLATION_STATES;
use std::path::Path;

const SIZE: (u32, u32) = (960, 600);
/// Upper end of the vertical axis, arcsec. Larger sigmas, of parameters that no segment has shown yet, are drawn there.
const HIGHEST_ARCSEC: f64 = 1000.0;

/// Draws the sigmas of Bai's twelve states (arcsec), and with thinner lines the sigmas of the effects (units in
/// the legend), on a logarithmic axis.
///
/// # Errors
/// The file cannot be written; the message names it.
pub fn write_sigmas(path: &Path, prediction: &Prediction) -> Result<()> {
    draw(path, prediction).map_err(|error| anyhow!("{}: {error}", path.display()))
}

/// Sigmas of a state against time.
struct Curve {
    label: String,
    width: u32,
    points: Vec<(f64, f64)>,
}

fn curves(prediction: &Prediction) -> Vec<Curve> {
    let points = |place: usize| {
        let point = |gain: &SegmentGain| (gain.time_s, gain.sigmas.0[place].1.min(HIGHEST_ARCSEC));
        prediction.segments.iter().map(point).collect()
    };
    let installation = prediction.parameters.0.iter().take(INSTALLATION_STATES).enumerate();
    let installation =
        installation.map(|(place, (name, _))| Curve { label: (*name).into(), width: 2, points: points(place) });
    let effects = (prediction.parameters.0.len()..).zip(&prediction.effects.0);
    let effects = effects.map(|(place, (name, predicted))| Curve {
        label: format!("{name}, {}", predicted.unit),
        width: 1,
        points: points(place),
    });
    installation.chain(effects).collect()
}

fn draw(path: &Path, prediction: &Prediction) -> Result<(), Box<dyn std::error::Error>> {
    let area = SVGBackend::new(path, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let curves = curves(prediction);
    let all = curves.iter().flat_map(|curve| &curve.points);
    let lowest = all.map(|(_, sigma)| *sigma).fold(HIGHEST_ARCSEC, f64::min) / 1.5;
    let title = format!("scheme {}: predicted sigmas, arcsec, against time, s", prediction.scheme);
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(32)
        .y_label_area_size(56)
        .build_cartesian_2d(0.0..prediction.duration_s, (lowest..HIGHEST_ARCSEC).log_scale())?;
    chart.configure_mesh().draw()?;
    let count = curves.len() as f64;
    for (number, Curve { label, width, points }) in curves.into_iter().enumerate() {
        let style = HSLColor(number as f64 / count, 0.8, 0.4).stroke_width(width);
        let line = chart.draw_series(LineSeries::new(points, style))?;
        line.label(label).legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
    }
    chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3)).draw()?;
    area.present()?;
    Ok(())
}
