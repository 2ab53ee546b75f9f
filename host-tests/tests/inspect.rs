//! `rins inspect` on logs with other columns, units and time stamps: its report is right, and its mapping works.

use host_tests::calibration::virtual_run::VirtualRun;
use host_tests::files::unit_file::Noise;
use host_tests::virtual_unit::plant::Reading;
use host_tests::virtual_unit::presets::real;
use host_tests::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::units::{DEG, DEG_H};
use rins_selfcal::scheme::Scheme;
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

const INTERVAL_S: f64 = 0.005;
const G: f64 = 9.806_65;

fn scratch(name: &str) -> String {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("inspect");
    fs::create_dir_all(&folder).unwrap();
    folder.join(name).to_str().expect("UTF-8").into()
}

/// Runs the program and expects an exit status; both outputs.
fn run(status: i32, arguments: &[&str]) -> [String; 2] {
    let output = Command::new(env!("CARGO_BIN_EXE_rins")).args(arguments).output().expect("the program starts");
    let texts = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).expect("UTF-8"));
    assert_eq!(output.status.code(), Some(status), "{arguments:?}: {texts:?}");
    texts
}

fn read(path: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn virtual_run(scheme: Scheme) -> VirtualRun {
    VirtualRun { unit: VirtualUnit { errors: real(1), ..VirtualUnit::default() }, scheme, seed: 11 }
}

/// Readings whose stamps and angles are those at the end of each interval.
fn at_the_ends(run: &VirtualRun) -> Vec<Reading> {
    let readings: Vec<Reading> = run.drive().collect();
    let next = |index: usize| readings[(index + 1).min(readings.len() - 1)];
    let end = |(index, reading): (usize, &Reading)| Reading {
        time_us: reading.time_us + 2500,
        outer_rad: 0.5 * (reading.outer_rad + next(index).outer_rad),
        inner_rad: 0.5 * (reading.inner_rad + next(index).inner_rad),
        ..*reading
    };
    readings.iter().enumerate().map(end).collect()
}

/// The largest error over sigma of a result, against the true values.
fn worst_error(result: &Value, truth: &Value) -> f64 {
    let parameters = truth["parameters"].as_object().unwrap();
    assert_eq!(parameters.len(), 28);
    let normalized = parameters.iter().map(|(name, truth)| {
        let found = &result["parameters"][name];
        let error = found["value"].as_f64().unwrap() - truth.as_f64().unwrap();
        let error = if name == "heading" { (error + 180.0).rem_euclid(360.0) - 180.0 } else { error };
        (error / found["sigma"].as_f64().unwrap()).abs()
    });
    normalized.fold(0.0, f64::max)
}

/// A log with milliseconds, deg/h and mg. The outer encoder is reversed, in degrees and has its zero at 90; the inner
/// one is in counts; both are wrapped. The log has axes in another order, decimal commas, a line above the header, a
/// counter, words, gaps and repeated rows. Returns the number of rows too.
fn foreign_log(run: &VirtualRun) -> (String, usize) {
    let mut text = String::from("Messung 7\nNr;Stempel;a;b;c;d;e;f;A;B;Zustand\n");
    let (mut rows, mut missing) = (0, 0);
    for (number, reading) in at_the_ends(run).iter().enumerate() {
        // 15 samples are missing at a stop, and 2 in a move.
        if (700..715).contains(&number) || (2390..2392).contains(&number) {
            missing += 1;
            continue;
        }
        let [gx, gy, gz] = reading.omega_g.map(|omega| omega / DEG_H);
        let [ax, ay, az] = reading.force_a.map(|force| force / G * 1e3);
        let outer = (90.0 - reading.outer_rad / DEG).rem_euclid(360.0);
        let inner = (reading.inner_rad / TAU * 16_777_216.0).round().rem_euclid(16_777_216.0);
        let values = [number as f64, reading.time_us as f64 * 1e-3, gz, gx, gy, ax, az, ay, outer, inner];
        let fields: Vec<_> = values.iter().map(|value| value.to_string().replace('.', ",")).collect();
        for _ in 0..=usize::from(number == 300) {
            writeln!(text, "{};ok", fields.join(";")).unwrap();
            rows += 1;
        }
    }
    assert_eq!(missing, 17);
    let path = scratch("foreign.csv");
    fs::write(&path, text).unwrap();
    (path, rows)
}

#[test]
fn the_mapping_that_is_proposed_for_a_foreign_log_works() {
    let run_of = virtual_run(Scheme::named("fast-90").unwrap());
    let (log, rows) = foreign_log(&run_of);
    let [map, unit, seen, result] = ["map.toml", "unit.toml", "seen.json", "result.json"].map(scratch);
    let [stdout, stderr] =
        run(0, &["inspect", &log, "--write-mapping", &map, "--write-config", &unit, "--json", &seen]);
    // The log does not show where it was recorded.
    let warning = "no site: latitude_deg and height_m of [site] should be given";
    assert!(stderr.contains(warning) && fs::read_to_string(&unit).unwrap().contains(warning), "{stderr}");
    assert!(stdout.contains("A        outer encoder, deg, reversed, zero at 90\n"), "{stdout}");
    let seen = read(&seen);
    assert_eq!(seen["sampling"]["rows"], rows);
    assert_eq!((&seen["sampling"]["gaps"], &seen["sampling"]["missing"]), (&json!(2), &json!(17)));
    assert_eq!(seen["sampling"]["repeated"], 1);
    // Two lines are above the samples. Of the 715 samples before the end of the gap, 15 are missing, and one is there
    // twice.
    assert_eq!(seen["sampling"]["longest_gap"]["line"], 704);
    assert!((seen["sampling"]["rate_hz"].as_f64().unwrap() - 200.0).abs() < 1e-9);
    let mapping = &seen["mapping"];
    assert_eq!(mapping["text"], json!({"delimiter": ";", "decimal_comma": true, "skip_rows": 1, "header": true}));
    assert_eq!(mapping["time"], json!({"column": "Stempel", "unit": "ms", "stamp": "end"}));
    let gyro = json!({"columns": ["a", "b", "c"], "unit": "deg/h", "axes": ["y", "z", "x"]});
    assert_eq!(mapping["gyro"], gyro);
    assert_eq!(mapping["accel"], json!({"columns": ["d", "e", "f"], "unit": "mg", "axes": ["x", "z", "y"]}));
    assert_eq!(mapping["outer"], json!({"column": "A", "unit": "deg", "zero": 90.0, "reversed": true}));
    assert_eq!(mapping["inner"], json!({"column": "B", "unit": "counts", "counts_per_turn": 16_777_216.0}));
    assert_eq!(seen["nearest_scheme"]["name"], "fast-90");
    let edited = scratch("edited.toml");
    let text = fs::read_to_string(&unit).unwrap();
    fs::write(&edited, text.replacen("[site]\n", "[site]\nlatitude_deg = 30.93041\nheight_m = 20.0\n", 1)).unwrap();
    let [_, stderr] = run(0, &["inspect", &log, "--config", &edited, "--write-config", &scratch("again.toml")]);
    assert!(!stderr.contains("no site"), "{stderr}");
    // The calibration with the mapping and the edited description is right, within 4.5 sigma.
    let truth = scratch("truth.json");
    let parameters = host_tests::files::truth::Truth::new(&run_of.unit.errors);
    fs::write(&truth, serde_json::to_string(&parameters).unwrap()).unwrap();
    run(0, &["replay", &log, "--mapping", &map, "--config", &unit, "--json", &result]);
    let worst = worst_error(&read(&result), &read(&truth));
    assert!(worst < 4.5, "{worst}");
}

#[test]
fn noise_scheme_and_observability_of_a_standard_log_are_seen() {
    let scheme = Scheme::bai(4.0, 1);
    let unit =
        VirtualUnit { noise: Noise { accel_vrw_ug_sqrt_hz: 35.0, ..Noise::navigation() }, ..VirtualUnit::default() };
    let (log, seen, scheme_file) = (scratch("standard.parquet"), scratch("standard.json"), scratch("seen.toml"));
    let mut writer = host_tests::log::LogWriter::create(Path::new(&log), false).unwrap();
    VirtualRun { unit, scheme, seed: 5 }.drive().for_each(|reading| writer.write(&reading).unwrap());
    writer.finish().unwrap();
    let (unit_file, predicted) = (scratch("noise.toml"), scratch("predicted.json"));
    let writes = ["--json", &seen, "--write-scheme", &scheme_file, "--write-config", &unit_file];
    let [stdout, _] = run(0, &[&["inspect", &log][..], &writes].concat());
    assert!(stdout.contains("columns: the standard ones\n"), "{stdout}");
    let seen = read(&seen);
    assert_eq!(seen["mapping"], Value::Null);
    assert_eq!(seen["segments"].as_array().unwrap().len(), 37);
    let near = &seen["nearest_scheme"];
    assert_eq!((&near["name"], &near["periods"]), (&json!("bai"), &json!(1)));
    assert!(near["apart_deg"].as_f64().unwrap() < 0.001);
    // 19 stops of 3.6 s have 1.5 * 680 degrees of freedom in each of three channels at averaging times from 0.1 s on,
    // so that sigma is 1.3 %. Four sigma are allowed.
    let noise = |name: &str| seen["noise"][name].as_f64().unwrap();
    assert!((noise("accel_vrw_ug_sqrt_hz") / 35.0 - 1.0).abs() < 0.055, "{}", seen["noise"]);
    assert!((noise("gyro_arw_deg_sqrt_h") / 0.001 - 1.0).abs() < 0.055, "{}", seen["noise"]);
    let observed = &seen["observed"];
    assert_eq!((&observed["rank"], &observed["unobserved"]), (&json!(28), &json!([])));
    // The prediction from the written scheme agrees with that from the log: the geometry is the same, and the stops
    // agree to 0.1 s of 4 s.
    run(0, &["observability", "--scheme", &scheme_file, "--config", &unit_file, "--json", &predicted]);
    let [log_sigma, scheme_sigma] = [observed, &read(&predicted)].map(|from| from["worst_arcsec"].as_f64().unwrap());
    assert!((log_sigma / scheme_sigma - 1.0).abs() < 0.03, "{log_sigma} {scheme_sigma}");
}

#[test]
fn a_log_at_rest_is_told_by_names_and_one_that_breaks_off_says_where() {
    let scheme = Scheme::bai(60.0, 1);
    let readings: Vec<Reading> = virtual_run(scheme).drive().take(8000).collect();
    let mut text = String::from("t [ms],wx [deg/s],wy [deg/s],wz [deg/s],fx,fy,fz,roll [deg],yaw [deg]\n");
    for reading in &readings {
        let time_ms = reading.time_us as f64 * 1e-3;
        let [gx, gy, gz] = reading.omega_g.map(|omega| omega / DEG);
        let [ax, ay, az] = reading.force_a.map(|force| force / G);
        writeln!(
            text,
            "{time_ms},{gx},{gy},{gz},{ax},{ay},{az},{},{}",
            reading.outer_rad / DEG,
            reading.inner_rad / DEG
        )
        .unwrap();
    }
    let (log, seen) = (scratch("rest.csv"), scratch("rest.json"));
    fs::write(&log, &text).unwrap();
    run(0, &["inspect", &log, "--json", &seen]);
    let found = read(&seen);
    assert_eq!((&found["mapping"]["gyro"]["unit"], &found["mapping"]["accel"]["unit"]), (&json!("deg/s"), &json!("g")));
    assert_eq!((&found["observed"], &found["encoders"]), (&Value::Null, &Value::Null));
    // 40 s have 600 degrees of freedom in each of three channels at 0.1 s, so that sigma is 1.7 %. Four sigma are
    // allowed.
    assert!((found["noise"]["gyro_arw_deg_sqrt_h"].as_f64().unwrap() / 0.001 - 1.0).abs() < 0.07, "{}", found["noise"]);
    assert!(found["remarks"][0].as_str().unwrap().starts_with("no axis turns as in a calibration"));
    // The rows before a wrong row are described, and the wrong row is the error.
    let lines: Vec<_> = text.lines().collect();
    let back = format!("{}\n{}\n", lines[..6001].join("\n"), lines[4000]);
    fs::write(&log, back).unwrap();
    let [stdout, stderr] = run(1, &["inspect", &log]);
    assert!(stdout.contains("rest.csv: 6000 rows, "), "{stdout}");
    assert!(stderr.contains("rest.csv:6002: column t [ms]: time goes back from "), "{stderr}");
    fs::write(&log, lines[..3].join("\n")).unwrap();
    assert!(run(1, &["inspect", &log])[1].contains("rest.csv: the log has only 2 rows, fewer than 16"));
    // The columns have no names.
    let nameless: String = text.lines().skip(1).map(|line| format!("{line}\n")).collect();
    fs::write(&log, nameless).unwrap();
    let [_, stderr] = run(1, &["inspect", &log]);
    assert!(
        stderr.contains("rest.csv: the motion does not show what the columns are, and no column is named as gyro x"),
        "{stderr}"
    );
    fs::write(&log, "a,b\n1,2\n").unwrap();
    let [_, stderr] = run(1, &["inspect", &log]);
    assert!(stderr.contains("rest.csv: none of the first 200 lines has 8 or more numbers"), "{stderr}");
}

#[test]
fn raw_matrices_are_told_without_names() {
    let run_of = virtual_run(Scheme::named("fast-60").unwrap());
    let mut bytes = Vec::new();
    for reading in at_the_ends(&run_of) {
        let increments = reading.omega_g.iter().chain(&reading.force_a).map(|rate| rate * INTERVAL_S);
        let rest = [reading.time_us as f64 * 1e-6, 20.0, reading.outer_rad, reading.inner_rad];
        increments.chain(rest).for_each(|value| bytes.extend(value.to_le_bytes()));
    }
    let (log, seen) = (scratch("ten.f64"), scratch("ten.json"));
    fs::write(&log, bytes).unwrap();
    run(0, &["inspect", &log, "--json", &seen]);
    let mapping = &read(&seen)["mapping"];
    assert_eq!(mapping["matrix"]["columns"], 10);
    assert_eq!(mapping["time"], json!({"column": 7, "unit": "s", "stamp": "end"}));
    assert_eq!(mapping["gyro"], json!({"columns": [1, 2, 3], "unit": "rad"}));
    assert_eq!(mapping["accel"], json!({"columns": [4, 5, 6], "unit": "m/s"}));
    assert_eq!([&mapping["outer"]["column"], &mapping["inner"]["column"]], [9, 10]);
}
