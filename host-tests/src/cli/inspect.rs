//! `rins inspect`

use super::ending::Ending;
use super::output::{note, say, sayln};
use super::{files, progress};
use crate::base::quantity::{fixed, significant, states};
use crate::files::json_file::write_json;
use crate::files::scheme_file::write_scheme;
use crate::files::unit_file::{Origin, UnitConfig};
use crate::inspect::noise::ChannelNoise;
use crate::inspect::shapes::Process;
use crate::inspect::{Inspection, Request, Sampling, SegmentSeen};
use crate::log::Mapping;
use crate::plan::prediction::Observed;
use crate::result::table;
use anyhow::{Context, bail};
use clap::Args;
use rins_selfcal::base::units::{DEG_H, DEG_SQRT_H, MICRO_G};
use rins_selfcal::segment::SegmentKind;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct InspectArguments {
    /// Log with any columns and units: CSV, Parquet or a raw matrix; CSV and matrix may be compressed with gzip
    #[arg(value_name = "LOG")]
    pub log: PathBuf,
    /// Mapping of the log's columns and units [default: recognized from the data]
    #[arg(long, value_name = "MAP.toml")]
    pub mapping: Option<PathBuf>,
    /// Site of the unit, and its noise if the log does not show the noise [default: unknown site, noise "navigation"]
    #[arg(long, value_name = "UNIT.toml")]
    pub config: Option<PathBuf>,
    /// Write the proposed mapping to this file
    #[arg(long, value_name = "MAP.toml", conflicts_with = "mapping")]
    pub write_mapping: Option<PathBuf>,
    /// Write the unit description with the measured noise to this file; without --config, edit the site in the file
    #[arg(long, value_name = "UNIT.toml")]
    pub write_config: Option<PathBuf>,
    /// Write the scheme that the log follows to this file
    #[arg(long, value_name = "SCHEME.toml")]
    pub write_scheme: Option<PathBuf>,
    /// Write all findings to this file
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
}

pub fn run(arguments: &InspectArguments) -> anyhow::Result<Ending> {
    let inputs = [
        ("LOG", Some(arguments.log.as_path())),
        ("--mapping", arguments.mapping.as_deref()),
        ("--config", arguments.config.as_deref()),
    ];
    let outputs = [
        ("--write-mapping", arguments.write_mapping.as_deref()),
        ("--write-config", arguments.write_config.as_deref()),
        ("--write-scheme", arguments.write_scheme.as_deref()),
        ("--json", arguments.json.as_deref()),
    ];
    files::check(&inputs, &outputs)?;
    let (unit, origin) =
        arguments.config.as_deref().map_or_else(|| Ok(Default::default()), UnitConfig::read_with_origin)?;
    let given = arguments.mapping.as_deref();
    let layout = given.map(|mapping| Mapping::read(mapping, &arguments.log)).transpose()?;
    let request = Request { log: &arguments.log, layout, unit };
    let counter = progress::counter("rows");
    let found = request.run(|doing, rows| {
        counter.set_message(doing.into());
        counter.set_position(rows);
    });
    drop(counter);
    let found = found?;
    write(arguments, &unit, &origin, &found)?;
    say!("{}", text(&arguments.log, &found));
    for (name, path) in
        outputs.iter().filter_map(|(name, path)| Some((name.trim_start_matches("--write-"), path.as_ref()?)))
    {
        sayln!("{}: {}", name.trim_start_matches("--"), path.display());
    }
    match found.stopped_by {
        Some(error) => bail!("{error}"),
        None => Ok(Ending::Done),
    }
}

fn write(arguments: &InspectArguments, unit: &UnitConfig, origin: &Origin, found: &Inspection) -> anyhow::Result<()> {
    if let Some(path) = &arguments.write_mapping {
        let mapping = found.mapping.clone().unwrap_or_default();
        write_text(path, &toml::to_string(&mapping)?)?;
    }
    if let Some(path) = &arguments.write_config {
        let seen = UnitConfig { noise: found.noise, hardware: found.hardware, ..*unit };
        write_unit(path, &seen, &origin.default_site_keys())?;
    }
    if let Some(path) = &arguments.write_scheme {
        let scheme = found
            .scheme
            .as_ref()
            .context("--write-scheme: the log shows no scheme that begins with a stop at (0, 0)")?;
        write_scheme(path, scheme)?;
    }
    if let Some(path) = &arguments.json {
        write_json(path, found)?;
    }
    Ok(())
}

/// Writes the unit description. If keys of the site are missing, a comment in the file and a note say so.
fn write_unit(path: &Path, unit: &UnitConfig, default_keys: &[&str]) -> anyhow::Result<()> {
    let text = toml::to_string(unit)?;
    if default_keys.is_empty() {
        return write_text(path, &text);
    }
    let what =
        format!("no site: {} of [site] should be given, because the log does not show it", default_keys.join(" and "));
    let why = "gravity is the scale of the accelerometers, and without a latitude the gyros must find it";
    write_text(path, &text.replacen("[site]\n", &format!("# {what}:\n# {why}.\n[site]\n"), 1))?;
    note!("{}: {what}", path.display());
    Ok(())
}

fn write_text(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| path.display().to_string())
}

fn text(log: &Path, found: &Inspection) -> String {
    let mut text = sampling(log, &found.sampling);
    if !found.columns.is_empty() {
        text += &columns(found);
    }
    text += &format!("\n{}\n", segments(&found.segments));
    text += &format!("{}\n{}", scheme(found), noise(found));
    if let Some(observed) = &found.observed {
        text += &format!("\n{}", observable(observed));
    }
    for remark in &found.remarks {
        text += &format!("note: {remark}\n");
    }
    text
}

fn sampling(log: &Path, sampling: &Sampling) -> String {
    let [first, last] = sampling.times_s;
    let mut text = format!(
        "{}: {} rows, {:.3} s from {first:.3} s on, {} Hz\n",
        log.display(),
        sampling.rows,
        last - first,
        significant(sampling.rate_hz)
    );
    text += &match sampling.longest_gap {
        Some(gap) => format!(
            "gaps: {}, {} samples missing; the longest {:.3} s before line {}, at {:.3} s\n",
            sampling.gaps, sampling.missing, gap.length_s, gap.line, gap.time_s
        ),
        None => "gaps: none\n".into(),
    };
    text += &format!("repeated stamps: {}\n", sampling.repeated);
    if let Some(early) = sampling.encoders_early {
        let moment = if early < 0.25 {
            "end"
        } else if early > 0.75 {
            "start"
        } else {
            "middle"
        };
        text += &format!(
            "encoders: read at the {moment} of the gyros' interval, {} of it before its end\n",
            fixed(early, 2)
        );
    }
    if let Some([low, high]) = sampling.temperature_c {
        text += &format!("temperature: {low:.1} to {high:.1} deg C\n");
    }
    if let Some(gravity) = sampling.gravity_m_s2 {
        text += &format!("force at the stops: {gravity:.5} m/s^2\n");
    }
    text
}

fn columns(found: &Inspection) -> String {
    let Some(mapping) = &found.mapping else { return "columns: the standard ones\n".into() };
    let used = |role: &str| if role.is_empty() { "not used".to_string() } else { role.to_string() };
    let rows = found.columns.iter().map(|taken| vec![taken.column.clone(), used(&taken.role)]);
    let toml = toml::to_string(mapping).unwrap_or_default();
    let toml: String = toml.lines().map(|line| format!("    {line}\n")).collect();
    format!("\n{}\nproposed mapping:\n{toml}", table::of_words(&["column", "taken for"], rows))
}

fn segments(segments: &[SegmentSeen]) -> String {
    let row = |(number, segment): (usize, &SegmentSeen)| {
        let [outer, inner] = segment.angles_deg.map(|angle| format!("{:.3}", (angle * 1e3).round() / 1e3 + 0.0));
        let (kind, sign) = if segment.kind == SegmentKind::Stop { ("stop", "at") } else { ("move", "by") };
        let broken = if segment.is_broken { "gap" } else { "" };
        vec![
            number.to_string(),
            kind.into(),
            format!("{:.1}", segment.start_s),
            format!("{:.1}", segment.duration_s),
            sign.into(),
            outer,
            inner,
            broken.into(),
        ]
    };
    let columns = ["segment", "kind", "from s", "for s", "", "outer deg", "inner deg", ""];
    table::of_numbers(&columns, segments.iter().enumerate().map(row))
}

fn scheme(found: &Inspection) -> String {
    let own = found.scheme.as_ref().map_or_else(String::new, |scheme| {
        let [rate, acceleration] =
            [scheme.rate_rad_s, scheme.acceleration_rad_s2].map(|rad| significant(rad.to_degrees()));
        format!("; moves at {rate} deg/s, {acceleration} deg/s^2")
    });
    match &found.nearest_scheme {
        Some(near) => format!(
            "scheme: like {}, {} period{}: angles within {} deg; stops of {:.1} s on average, in the library {:.1} s{own}\n",
            near.name,
            near.periods,
            if near.periods > 1 { "s" } else { "" },
            significant(near.apart_deg),
            near.stops_s[0],
            near.stops_s[1]
        ),
        None => format!("scheme: no scheme of the library has as many moves{own}\n"),
    }
}

fn noise(found: &Inspection) -> String {
    let row = |channel: &ChannelNoise| {
        let accel = channel.channel.starts_with("accel");
        let (white, white_unit) = if accel { (MICRO_G, "ug/sqrt(Hz)") } else { (DEG_SQRT_H, "deg/sqrt(h)") };
        let (bias, bias_unit) = if accel { (MICRO_G, "ug") } else { (DEG_H, "deg/h") };
        let shown = |process, unit_si: f64| {
            let size = channel.processes.size(process);
            size.map_or_else(|| "-".to_string(), |size| significant(size / unit_si))
        };
        let longest = channel.curve.last().map_or_else(
            || "-".to_string(),
            |point| format!("{} at {} s", significant(point.deviation / bias), significant(point.tau_s)),
        );
        vec![
            channel.channel.into(),
            shown(Process::White, white),
            white_unit.into(),
            shown(Process::Floor, bias),
            bias_unit.into(),
            longest,
        ]
    };
    let columns = ["channel", "white noise", "", "floor", "", "deviation"];
    let channels = table::of_numbers(&columns, found.stops.channels.iter().map(row));
    let mut text = format!("Allan deviation at the stops\n{channels}\n");
    if let Some(encoders) = found.residuals.as_ref().and_then(|residuals| residuals.encoders) {
        let [low, high] = encoders.range_arcsec.map(significant);
        text += &format!(
            "encoders: the segments agree with a noise of {} arcsec ({low} to {high}), {} degrees of freedom\n",
            significant(encoders.arcsec),
            encoders.degrees_of_freedom
        );
    }
    let rows = found.rows.iter().map(|row| {
        let [value, from] = row.described();
        vec![row.key.into(), value, row.unit.into(), from]
    });
    let columns = ["for the configuration", "", "", ""];
    text + &format!("\n{}\n", table::of_words(&columns, rows))
}

fn observable(observed: &Observed) -> String {
    let hidden = if observed.unobserved.is_empty() {
        String::new()
    } else {
        format!("not observed: {}\n", observed.unobserved.join(", "))
    };
    let names: Vec<_> = states().map(|info| info.name).collect();
    let sigmas = table::by_state(&["sigma"], |state| {
        let found = observed.parameters.0.iter().find(|(name, _)| *name == names[state]);
        found.map(|(_, predicted)| vec![significant(predicted.sigma)])
    });
    format!(
        "observable with this noise: rank {} of {}, condition number {}, weakest direction: {}\n{hidden}worst of Bai's 12: {} \
         arcsec\n\n{sigmas}\n",
        observed.rank,
        observed.states,
        significant(observed.condition_number),
        observed.weakest_direction,
        significant(observed.worst_arcsec)
    )
}
