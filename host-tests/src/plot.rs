//! Predicted sigmas against scheme time, as an SVG.

use crate::prediction::{Prediction, SegmentGain};
use anyhow::{Result, anyhow};
use plotters::prelude::*;
use rins_selfcal::observability::INSTALLATION_STATES;
use std::path::Path;

const SIZE: (u32, u32) = (960, 600);
/// The axis begins where all parameters have been seen, so at no more than this, arcsec.
const HIGHEST_ARCSEC: f64 = 1000.0;

/// Draws the sigmas of Bai's twelve, arcsec, on a logarithmic axis.
///
/// # Errors
/// The file cannot be written; the message names it.
pub fn write_sigmas(path: &Path, prediction: &Prediction) -> Result<()> {
    draw(path, prediction).map_err(|error| anyhow!("{}: {error}", path.display()))
}

fn draw(path: &Path, prediction: &Prediction) -> Result<(), Box<dyn std::error::Error>> {
    let area = SVGBackend::new(path, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let of = |gain: &SegmentGain| gain.sigmas.0.iter().take(INSTALLATION_STATES).map(|(_, sigma)| *sigma).collect();
    let sigmas: Vec<Vec<f64>> = prediction.segments.iter().map(of).collect();
    let lowest = sigmas.iter().flatten().copied().fold(HIGHEST_ARCSEC, f64::min) / 1.5;
    let title = format!("scheme {}: predicted sigmas, arcsec, against time, s", prediction.scheme);
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(32)
        .y_label_area_size(56)
        .build_cartesian_2d(0.0..prediction.duration_s, (lowest..HIGHEST_ARCSEC).log_scale())?;
    chart.configure_mesh().draw()?;
    let names = prediction.segments.first().map(|first| &first.sigmas.0[..]).unwrap_or_default();
    for (number, (name, _)) in names.iter().take(INSTALLATION_STATES).enumerate() {
        let times = prediction.segments.iter().map(|gain| gain.time_s);
        let points = times.zip(&sigmas).map(|(time_s, sigmas)| (time_s, sigmas[number].min(HIGHEST_ARCSEC)));
        let colour = HSLColor(number as f64 / INSTALLATION_STATES as f64, 0.8, 0.4);
        let line = chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?;
        line.label(*name).legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(2)));
    }
    chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3)).draw()?;
    area.present()?;
    Ok(())
}
