//! Charts as inline SVG. Lines and text have the page's text colour, so that a chart is legible on light and dark pages
//! and in print.

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;
use std::ops::Range;

/// SVG text of a figure.
pub type Drawn = Result<String>;
/// Drawing area of a chart.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type DrawResult = Result<(), Box<dyn std::error::Error>>;

/// Colours that can be told apart on light and dark pages, and by the colour-blind. (after Okabe and Ito 2008)
const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 124, 190),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(196, 100, 160),
    RGBColor(190, 140, 0),
    RGBColor(96, 125, 145),
];
const FONT: &str = "sans-serif";
const TEXT: i32 = 13;

/// Colour of a curve, by number.
fn colour(number: usize) -> RGBColor {
    COLOURS[number % COLOURS.len()]
}

/// Width of a curve, by number and number of all curves. If there are more curves than colours, the first ones are
/// thick and the others, in the same colours, thin.
fn width(number: usize, all: usize) -> u32 {
    match (all > COLOURS.len(), number < COLOURS.len()) {
        (false, _) => 2,
        (true, true) => 3,
        (true, false) => 1,
    }
}

/// Draws a figure of the given width and height, SVG units.
pub fn figure(size: (u32, u32), draw: impl FnOnce(&Area) -> DrawResult) -> Drawn {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        draw(&area).map_err(|error| anyhow!("{error}"))?;
        area.present()?;
    }
    // The page sets the size and the text colour.
    let fixed = format!("width=\"{}\" height=\"{}\" viewBox", size.0, size.1);
    Ok(svg.replacen(&fixed, "viewBox", 1).replace("#000000", "currentColor"))
}

/// A line or a set of points, with a name.
pub struct Curve {
    name: String,
    points: Vec<(f64, f64)>,
}

impl Curve {
    /// A curve through points. Points that are not finite are left out.
    pub fn new(name: &str, points: impl Iterator<Item = (f64, f64)>) -> Self {
        Self { name: name.into(), points: points.filter(|(x, y)| x.is_finite() && y.is_finite()).collect() }
    }
}

/// The vertical axis.
#[derive(Clone, Copy, PartialEq)]
pub enum Scale {
    /// Range of the values.
    Fitted,
    /// From this value to the largest value.
    From(f64),
    /// Range of the values, logarithmic.
    Logarithmic,
}

/// A chart with a title and axes.
pub struct Figure<'a> {
    title: &'a str,
    size: (u32, u32),
    scale: Scale,
    /// Names and units of the horizontal and the vertical axis.
    axes: Option<[&'a str; 2]>,
}

impl<'a> Figure<'a> {
    /// A chart of the given width and height, SVG units.
    pub fn new(title: &'a str, size: (u32, u32)) -> Self {
        Self { title, size, scale: Scale::Fitted, axes: None }
    }

    /// The same chart with names and units of the horizontal and the vertical axis.
    pub fn axes(self, x: &'a str, y: &'a str) -> Self {
        Self { axes: Some([x, y]), ..self }
    }

    /// The same chart with another vertical axis.
    pub fn scaled(self, scale: Scale) -> Self {
        Self { scale, ..self }
    }

    /// Draws lines, with a legend if there are several.
    pub fn lines(self, lines: &[Curve]) -> Drawn {
        let all = || lines.iter().flat_map(|line| line.points.iter().copied());
        let x = with_legend(range(all().map(|(x, _)| x), 0.0), lines);
        let y = range(all().map(|(_, y)| y), 0.05);
        let decades = all().map(|(_, y)| y).fold(y.end, f64::min) / 2.0..2.0 * y.end;
        figure(self.size, |area| match self.scale {
            Scale::Logarithmic => draw_lines(&mut self.chart(area, x, decades.log_scale())?, lines),
            Scale::From(start) => draw_lines(&mut self.chart(area, x, start..y.end)?, lines),
            Scale::Fitted => draw_lines(&mut self.chart(area, x, y)?, lines),
        })
    }

    /// Draws a line with a band around it (x, [low, line, high]), and the true value. Where the line leaves the range of
    /// the vertical axis, it is broken; the band ends at the frame.
    pub fn band(self, points: &[(f64, [f64; 3])], truth: Option<f64>, y: Range<f64>) -> Drawn {
        let x = range(points.iter().map(|(x, _)| *x), 0.0);
        figure(self.size, |area| {
            let mut chart = self.chart(area, x.clone(), y.clone())?;
            let edge = |which: usize| points.iter().map(move |(x, values)| (*x, values[which]));
            let outline = edge(0).chain(points.iter().rev().map(|(x, values)| (*x, values[2])));
            let outline: Vec<_> = outline.map(|(x, value)| (x, value.clamp(y.start, y.end))).collect();
            chart.draw_series([Polygon::new(outline, colour(0).mix(0.25))])?;
            let inside = |(_, values): &(f64, [f64; 3])| y.contains(&values[1]);
            for piece in points.chunk_by(|a, b| inside(a) && inside(b)).filter(|piece| inside(&piece[0])) {
                let line = piece.iter().map(|(x, values)| (*x, values[1]));
                chart.draw_series(LineSeries::new(line, colour(0).stroke_width(2)))?;
            }
            if let Some(truth) = truth {
                let ends = [(x.start, truth), (x.end, truth)];
                chart.draw_series(DashedLineSeries::new(ends, 5, 4, colour(1).stroke_width(2)))?;
            }
            Ok(())
        })
    }

    /// Draws sets of points, and dashed lines at `levels`.
    pub fn points(self, clouds: &[Curve], levels: &[f64]) -> Drawn {
        let all = || clouds.iter().flat_map(|cloud| cloud.points.iter().copied());
        let x = with_legend(range(all().map(|(x, _)| x), 0.02), clouds);
        let y = range(all().map(|(_, y)| y).chain(levels.iter().copied()), 0.1);
        figure(self.size, |area| {
            let mut chart = self.chart(area, x.clone(), y)?;
            draw_levels(&mut chart, &x, levels)?;
            for (number, cloud) in clouds.iter().enumerate() {
                let dots = cloud.points.iter().map(|point| Circle::new(*point, 3, colour(number).filled()));
                let drawn = chart.draw_series(dots)?;
                drawn.label(&cloud.name).legend(move |at| Circle::new(at, 4, colour(number).filled()));
            }
            legend(&mut chart)
        })
    }

    /// Draws one bar for each name, and dashed lines at `levels`.
    pub fn bars(self, names: &[&str], values: &[f64], levels: &[f64]) -> Drawn {
        let x = -0.5..names.len() as f64 - 0.5;
        let y = range(values.iter().chain(levels).copied().filter(|value| value.is_finite()), 0.1);
        figure(self.size, |area| {
            let (chart_area, labels) = area.split_vertically(self.size.1 as i32 - 90);
            let mut chart = self.chart_without_x(&chart_area, x.clone(), y)?;
            draw_levels(&mut chart, &x, levels)?;
            chart.draw_series(values.iter().enumerate().filter(|(_, value)| value.is_finite()).map(
                |(number, value)| {
                    let at = number as f64;
                    Rectangle::new([(at - 0.3, 0.0), (at + 0.3, *value)], colour(0).filled())
                },
            ))?;
            let (left, right) = (56.0, f64::from(self.size.0) - 12.0);
            for (number, name) in names.iter().enumerate() {
                let at = left + (right - left) * (number as f64 + 0.5) / names.len() as f64;
                labels.draw(&Text::new(*name, (at as i32 + 4, 4), ink_text().transform(FontTransform::Rotate90)))?;
            }
            Ok(())
        })
    }

    fn chart<'b, Y>(&self, area: &Area<'b>, x: Range<f64>, y: Y) -> Result<Chart<'b, Y::CoordDescType>, BoxedError>
    where
        Y: AsRangedCoord<Value = f64>,
        Y::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let named = self.axes.is_some();
        let mut builder = self.builder(area);
        builder.x_label_area_size(if named { 42 } else { 26 }).y_label_area_size(if named { 72 } else { 56 });
        let mut chart = builder.build_cartesian_2d(x, y)?;
        let ticks = if self.size.0 > 500 { 12 } else { 4 };
        let mut mesh = chart.configure_mesh();
        mesh.x_labels(ticks).y_labels(if self.size.1 > 250 { 8 } else { 5 });
        mesh.label_style(ink_text()).axis_style(BLACK.mix(0.5));
        if let Some([x, y]) = self.axes {
            mesh.x_desc(x).y_desc(y).axis_desc_style(ink_text());
        }
        mesh.bold_line_style(BLACK.mix(0.15))
            .light_line_style(TRANSPARENT)
            .x_label_formatter(&tick)
            .y_label_formatter(&tick)
            .draw()?;
        Ok(chart)
    }

    fn chart_without_x<'b>(
        &self,
        area: &Area<'b>,
        x: Range<f64>,
        y: Range<f64>,
    ) -> Result<Chart<'b, plotters::coord::types::RangedCoordf64>, BoxedError> {
        let mut chart = self.builder(area).build_cartesian_2d(x, y)?;
        let mut mesh = chart.configure_mesh();
        mesh.disable_x_mesh().disable_x_axis().label_style(ink_text()).axis_style(BLACK.mix(0.5));
        mesh.bold_line_style(BLACK.mix(0.15)).light_line_style(TRANSPARENT).y_label_formatter(&tick).draw()?;
        Ok(chart)
    }

    fn builder<'b, 'c>(&self, area: &'c Area<'b>) -> ChartBuilder<'c, 'c, SVGBackend<'b>> {
        let mut builder = ChartBuilder::on(area);
        builder.margin(6).margin_right(12).y_label_area_size(56).caption(self.title, (FONT, TEXT + 2).into_font());
        builder
    }
}

type BoxedError = Box<dyn std::error::Error>;
type Chart<'b, Y> = ChartContext<'b, SVGBackend<'b>, Cartesian2d<plotters::coord::types::RangedCoordf64, Y>>;

fn draw_lines<Y: Ranged<ValueType = f64>>(chart: &mut Chart<Y>, lines: &[Curve]) -> DrawResult {
    for (number, line) in lines.iter().enumerate() {
        let style = colour(number).stroke_width(width(number, lines.len()));
        let drawn = chart.draw_series(LineSeries::new(line.points.iter().copied(), style))?;
        drawn.label(&line.name).legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], style));
    }
    if lines.len() > 1 { legend(chart) } else { Ok(()) }
}

fn draw_levels<Y: Ranged<ValueType = f64>>(chart: &mut Chart<Y>, x: &Range<f64>, levels: &[f64]) -> DrawResult {
    for level in levels {
        let ends = [(x.start, *level), (x.end, *level)];
        chart.draw_series(DashedLineSeries::new(ends, 6, 4, BLACK.mix(0.6).stroke_width(1)))?;
    }
    Ok(())
}

fn legend<Y: Ranged<ValueType = f64>>(chart: &mut Chart<Y>) -> DrawResult {
    let mut labels = chart.configure_series_labels();
    labels.position(SeriesLabelPosition::UpperRight).label_font(ink_text()).border_style(BLACK.mix(0.3)).draw()?;
    Ok(())
}

fn ink_text() -> TextStyle<'static> {
    (FONT, TEXT).into_font().color(&BLACK)
}

/// Label of a tick; long numbers are in powers of ten.
fn tick(value: &f64) -> String {
    // Summing steps leaves a rounding error in place of zero.
    if value.abs() < 1e-12 {
        return "0".into();
    }
    let plain = format!("{}", (value * 1e6).round() / 1e6);
    if plain.len() <= 7 && value.abs() >= 1e-3 { plain } else { format!("{value:.1e}") }
}

/// Range from the least to the greatest value with a relative margin; never empty.
fn range(values: impl Iterator<Item = f64>, margin: f64) -> Range<f64> {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return 0.0..1.0;
    }
    let room = (high - low) * margin;
    if high - low > 0.0 { low - room..high + room } else { low - 1.0..high + 1.0 }
}

/// Adds space for the legend on the right, if there are several curves.
fn with_legend(x: Range<f64>, lines: &[Curve]) -> Range<f64> {
    let room = if lines.len() > 1 { 0.12 * (x.end - x.start) } else { 0.0 };
    x.start..x.end + room
}

/// A tint from 0 (none) to 1 (full).
pub fn shade(part: f64) -> RGBAColor {
    COLOURS[0].mix(part.clamp(0.0, 1.0))
}

/// As [`shade`], for -1 to 1, with another colour for negative numbers.
pub fn shade_signed(part: f64) -> RGBAColor {
    if part < 0.0 { COLOURS[0].mix((-part).min(1.0)) } else { COLOURS[1].mix(part.min(1.0)) }
}

/// Draws a table of coloured cells with a name for each row and column.
pub fn cells(area: &Area, rows: &[&str], columns: &[&str], cell: impl Fn(usize, usize) -> RGBAColor) -> DrawResult {
    let (width, height) = area.dim_in_pixel();
    let (left, top) = (150.0, if columns.iter().any(|name| name.len() > 3) { 150.0 } else { 24.0 });
    let step_x = (f64::from(width) - left - 8.0) / columns.len().max(1) as f64;
    let step_y = (f64::from(height) - top - 8.0) / rows.len().max(1) as f64;
    let at = |row: f64, column: f64| ((left + column * step_x) as i32, (top + row * step_y) as i32);
    for (row, name) in rows.iter().enumerate() {
        let (_, y) = at(row as f64 + 0.5, 0.0);
        area.draw(&Text::new(*name, (4, y - TEXT / 2), ink_text()))?;
        for column in 0..columns.len() {
            let corners = [at(row as f64, column as f64), at(row as f64 + 1.0, column as f64 + 1.0)];
            area.draw(&Rectangle::new(corners, cell(row, column).filled()))?;
        }
    }
    let every = (columns.len() as f64 * 22.0 / (f64::from(width) - left)).ceil().max(1.0) as usize;
    for (column, name) in columns.iter().enumerate() {
        let (x, _) = at(0.0, column as f64 + 0.5);
        if top > 100.0 {
            let upwards = ink_text().transform(FontTransform::Rotate270);
            area.draw(&Text::new(*name, (x - TEXT / 2, top as i32 - 4), upwards))?;
        } else if column % every == 0 {
            area.draw(&Text::new(*name, (x - 3 * name.len() as i32, 6), ink_text()))?;
        }
    }
    let frame = [at(0.0, 0.0), at(rows.len() as f64, columns.len() as f64)];
    area.draw(&Rectangle::new(frame, BLACK.mix(0.4).stroke_width(1)))?;
    Ok(())
}
