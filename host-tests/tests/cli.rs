//! The program `rins` from outside: accepted and refused arguments, error messages, and correctness of its numbers.
//!
//! Bounds of errors are 4.5 standard deviations: one of 28 parameters is beyond by chance in 2 of 10 000 runs. Seeds
//! are fixed.

use host_tests::base::quantity::values;
use host_tests::log::{LogReader, LogWriter};
use host_tests::study::statistics::chi_square_mean_bounds;
use host_tests::virtual_unit::plant::Reading;
use rins_selfcal::guide::CHAPTERS;
use rins_selfcal::model::effects::{EFFECT_INFO, EFFECT_STATES};
use rins_selfcal::model::error_model::PARAMETER_INFO;
use rins_selfcal::scheme::Scheme;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const PARAMETERS: usize = 28;

#[path = "../../examples/host.rs"]
#[expect(dead_code, reason = "its main is for the command line")]
mod host;

fn data(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name).to_str().expect("UTF-8").into()
}

fn scratch(name: &str) -> String {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cli");
    fs::create_dir_all(&folder).unwrap();
    folder.join(name).to_str().expect("UTF-8").into()
}

fn rins(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rins")).args(arguments).output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

/// Runs the program and expects an exit status; the standard output.
fn run(status: i32, arguments: &[&str]) -> String {
    let output = rins(arguments);
    assert_eq!(output.status.code(), Some(status), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// Runs the program and expects an error of one line; the line without the scratch folder.
fn refused(arguments: &[&str]) -> String {
    let output = rins(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}");
    let line = text(&output.stderr);
    assert_eq!(line.lines().count(), 1, "{line}");
    let folder = PathBuf::from(scratch("")).display().to_string();
    let line = line.trim_end().strip_prefix("error: ").expect("says that it is an error").replace(&folder, "");
    let parts: Vec<_> = line.split(": ").collect();
    assert!((1..parts.len()).all(|part| !parts[..part].contains(&parts[part])), "says it once: {line}");
    line
}

fn json(path: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// Largest error over sigma of the parameters in a result against a file of true values.
fn worst_error(result: &Value, truth: &Value) -> f64 {
    let parameters = result["parameters"].as_object().expect("parameters");
    let normalized = parameters.iter().map(|(name, found)| {
        let number = |key: &str| found[key].as_f64().expect("a number");
        let error = number("value") - truth["parameters"][name].as_f64().expect("a true value");
        let error = if name == "heading" { error - (error / 360.0).round() * 360.0 } else { error };
        error.abs() / number("sigma")
    });
    normalized.fold(0.0, f64::max)
}

#[test]
fn replay_of_the_sample_log_gives_the_truth_within_its_sigmas() {
    for precision in ["f64", "f32"] {
        let out = scratch(&format!("sample-{precision}.json"));
        let arguments = ["replay", &data("sample.csv.gz"), "--config", &data("sample.toml"), "--precision", precision];
        let stdout = run(0, &[&arguments[..], &["--json", &out, "--truth", &data("sample.truth.json")]].concat());
        assert!(stdout.contains("58520 samples at 200 Hz") && stdout.contains("19 stops and 18 moves"), "{stdout}");
        assert!(stdout.contains("verdict: accepted"), "{stdout}");
        let (result, truth) = (json(&out), json(&data("sample.truth.json")));
        assert_eq!(result["parameters"].as_object().map(|map| map.len()), Some(PARAMETERS));
        assert!(worst_error(&result, &truth) < 4.5, "{precision}: {}", worst_error(&result, &truth));
        for (name, reachable) in truth["reachable_sigma"].as_object().unwrap() {
            let ratio = result["parameters"][name]["sigma"].as_f64().unwrap() / reachable.as_f64().unwrap();
            // Both are rounded to four digits in the file; base_roll and base_pitch there to one.
            let tolerance = if name.starts_with("base_") { 0.5 } else { 0.02 };
            assert!((ratio - 1.0).abs() < tolerance, "{precision} {name}: {ratio}");
        }
    }
}

#[test]
fn json_says_what_it_is_and_how_to_apply_it() {
    let out = scratch("keys.json");
    run(0, &["replay", &data("sample.csv.gz"), "--config", &data("sample.toml"), "--json", &out]);
    let result = json(&out);
    assert_eq!((&result["verdict"], &result["method"]), (&"accepted".into(), &"joint".into()));
    assert_eq!((&result["segments"], result["reasons"].as_array().map(Vec::len)), (&37.into(), Some(0)));
    assert_eq!(result["reason_codes"].as_array().map(Vec::len), Some(0));
    for key in ["duration_s", "chi_square", "degrees_of_freedom"] {
        assert!(result[key].is_number(), "{key}");
    }
    let names: Vec<_> = result["parameters"].as_object().unwrap().values().map(|value| value["unit"].clone()).collect();
    assert_eq!(names.iter().filter(|unit| *unit == "arcsec").count(), 13);
    assert!((0.0..360.0).contains(&result["parameters"]["heading"]["value"].as_f64().unwrap()));
    assert!(result["convention"].as_str().unwrap().contains("f_s = force_matrix_sa (f_a - accel_bias_a)"));
    assert_eq!(result["correlation"]["matrix"].as_array().map(Vec::len), Some(PARAMETERS));
    assert!((result["correlation"]["matrix"][3][3].as_f64().unwrap() - 1.0).abs() < 1e-12);
    assert_eq!((&result["site"]["latitude_deg"], &result["temperature_c"]), (&47.3769.into(), &Value::Null));
    assert_eq!(
        (&result["site"]["latitude_sigma_deg"], &result["site"]["gravity_sigma_mgal"]),
        (&0.0.into(), &0.0.into())
    );
    assert_eq!((&result["hardware"]["profile"], &result["noise"]["gyro_floor_deg_h"]), (&"ideal".into(), &0.0.into()));
    assert!(result["software"]["version"].is_string());
    let matrix = |row: usize, column: usize| result["correction"]["force_matrix_sa"][row][column].as_f64().unwrap();
    let parameter = |name: &str| result["parameters"][name]["value"].as_f64().unwrap();
    assert_eq!(matrix(0, 2), 0.0);
    // rot_sa (I + diag ka)^-1
    assert!((matrix(2, 2) * (1.0 + parameter("accel_scale_z") * 1e-6) - 1.0).abs() < 1e-12);
    let arcsec = std::f64::consts::PI / 648_000.0;
    let sazx = matrix(2, 1) * (1.0 + parameter("accel_scale_y") * 1e-6);
    assert!((sazx - parameter("Sazx") * arcsec).abs() < 1e-12);
}

/// A result names the hardware, the noise and the site that it was made with, and `--adapt` says what it has changed.
#[test]
fn a_result_says_what_it_was_made_with_and_what_adapt_has_changed() {
    let (log, out) = (scratch("adapted.csv.gz"), scratch("adapted.json"));
    let errors = "effects.hardware.backlash_arcsec = [4.0, 0.0], parameters.Sgxy = 100.0, parameters.base_roll = 1.0";
    run(0, &["simulate", "--scheme", "fast-180", "--errors", errors, "--out", &log]);
    let unit =
        self::log("adapted.toml", "[site]\nlatitude_deg = 30.93041\nheight_m = 20.0\n[noise]\naccel_floor_ug = 3.0\n");
    let replay = ["replay", &log, "--config", &unit, "--adapt", "--json", &out];
    let quiet = run(0, &[&replay[..], &["--quiet"]].concat());
    let enlarged = "accepted; --adapt: backlash_arcsec was enlarged from 0.600 to ";
    assert!(quiet.starts_with(enlarged) && quiet.lines().count() == 1, "{quiet}");
    run(0, &replay);
    let result = json(&out);
    assert_eq!(
        (&result["enlarged"]["key"], &result["enlarged"]["unit"]),
        (&"backlash_arcsec".into(), &"arcsec".into())
    );
    let hardware = &result["hardware"];
    assert_eq!((&hardware["profile"], &hardware["accel_quadratic_ug_g2"]), (&"navigation".into(), &6.0.into()));
    // Single precision has seven digits.
    let found = result["enlarged"]["found"].as_f64().unwrap();
    assert!((hardware["backlash_arcsec"].as_f64().unwrap() / found - 1.0).abs() < 1e-6, "{hardware}");
    let noise = &result["noise"];
    assert_eq!((&noise["accel_floor_ug"], &noise["gyro_floor_deg_h"]), (&3.0.into(), &0.002.into()));
    assert_eq!((&hardware["accel_floor_ug"], &noise["accel_walk_ug_sqrt_h"]), (&3.0.into(), &0.0.into()));
    let formats = CHAPTERS.iter().find(|chapter| chapter.name == "formats").expect("a chapter").text;
    let (_, documented) = formats.split_once("\n## Result\n").expect("a section");
    let documented = documented.split("\n## ").next().expect("its text");
    for key in result.as_object().unwrap().keys() {
        assert!(documented.contains(&format!("`{key}`")), "{key} is not documented");
    }
}

/// The estimated latitude has one meaning, whether a latitude was configured or not.
#[test]
fn the_latitude_of_a_result_is_that_of_the_site() {
    let out = scratch("latitude.json");
    let known = "[site]\nlatitude_deg = 47.38\nlatitude_sigma_deg = 0.1\nheight_m = 408.0\n";
    for (site, sigma_deg, configured) in [
        ("[site]\nheight_m = 408.0\n", None, "deg (not configured)\n"),
        (known, Some(0.1), "deg (configured 47.380 +- 0.100)\n"),
    ] {
        let unit = log("latitude.toml", site);
        let stdout = run(0, &["replay", &data("sample.csv.gz"), "--config", &unit, "--json", &out]);
        let result = json(&out);
        let number = |key: &str| result["effects"]["site_latitude"][key].as_f64().unwrap();
        let (value, sigma) = (number("value"), number("sigma"));
        assert!((value - 47.3769).abs() < 4.5 * sigma && sigma < 0.03, "{value} +- {sigma}");
        let of_site = result["site"]["latitude_sigma_deg"].as_f64().unwrap();
        assert!((of_site / sigma_deg.unwrap_or(sigma) - 1.0).abs() < 1e-6, "{of_site}");
        assert!(stdout.contains("\n  site_latitude 47.") && stdout.contains(configured), "{stdout}");
    }
}

#[test]
fn simulated_log_is_replayed_to_its_truth() {
    let (log, truth, unit) = (scratch("round.csv.gz"), scratch("round.truth.json"), scratch("round-unit.toml"));
    let (estimates, out) = (scratch("round.estimates.csv"), scratch("round.json"));
    let files = ["simulate", "--out", &log, "--truth", &truth, "--write-config", &unit];
    run(
        0,
        &[&files[..], &["--scheme", "bai", "--stop", "5", "--noise", "tactical", "--rate", "100", "--seed", "7"]]
            .concat(),
    );
    let files = ["replay", &log, "--config", &unit, "--truth", &truth];
    let stdout = run(0, &[&files[..], &["--json", &out, "--csv-estimates", &estimates]].concat());
    assert!(stdout.contains("at 100 Hz") && stdout.contains("error/sigma"), "{stdout}");
    assert!(worst_error(&json(&out), &json(&truth)) < 4.5);
    let rows = fs::read_to_string(&estimates).unwrap();
    assert_eq!(rows.lines().count(), 38);
    assert!(rows.starts_with("time_s,segment,kind,Sgxy_arcsec,"), "{rows:.100}");
    assert!(rows.lines().all(|row| row.split(',').count() == 3 + 2 * PARAMETERS));
}

#[test]
fn the_example_for_a_host_says_what_replay_says() {
    let (log, cal) = (scratch("example.csv"), scratch("example.json"));
    run(0, &["simulate", "--scheme", "fast-60", "--out", &log]);
    run(0, &["replay", &log, "--json", &cal]);
    let (estimate, accepted) = host::calibrate(&log).unwrap();
    assert!(accepted);
    for (info, value) in PARAMETER_INFO.iter().zip(values(&estimate.errors)) {
        assert_eq!(json(&cal)["parameters"][info.name]["value"].as_f64(), Some(value), "{}", info.name);
    }
}

#[test]
fn the_papers_method_is_not_accepted_on_a_unit_with_biases() {
    let out = scratch("bai.json");
    let sample = ["replay", &data("sample.csv.gz"), "--config", &data("sample.toml")];
    let stdout = run(2, &[&sample[..], &["--method", "bai", "--json", &out]].concat());
    assert!(stdout.contains("verdict: rejected") && stdout.contains("taken as zero"), "{stdout}");
    let result = json(&out);
    assert_eq!((&result["verdict"], &result["method"]), (&"rejected".into(), &"bai".into()));
    let (reasons, codes) = (result["reasons"].as_array().unwrap(), result["reason_codes"].as_array().unwrap());
    assert!(!reasons.is_empty());
    for (reason, code) in reasons.iter().zip(codes) {
        assert!(reason.as_str().unwrap().starts_with(&format!("[{}] ", code.as_str().unwrap())), "{reason} {code}");
    }
    assert_eq!(result["parameters"].as_object().unwrap().len(), 12);
    // The older name is that of the same method.
    let again = scratch("two-stage.json");
    run(2, &[&sample[..], &["--method", "two-stage", "--json", &again]].concat());
    assert_eq!(json(&again), result);
}

const HEADER: &str =
    "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,outer_rad,inner_rad";

fn log(name: &str, rows: &str) -> String {
    let path = scratch(name);
    fs::write(&path, rows).unwrap();
    path
}

/// A log at rest whose row on line 5 is replaced.
fn log_with_row(name: &str, row: &str) -> String {
    let rest = |line: u32| format!("{:.3},0,0,0,0,0,9.8,0,0", f64::from(line) * 0.005);
    let rows: Vec<_> = (2..2000).map(|line| if line == 5 { row.into() } else { rest(line) }).collect();
    log(name, &format!("{HEADER}\n{}\n", rows.join("\n")))
}

fn replay_refused(path: &str) -> String {
    refused(&["replay", path])
}

#[test]
fn wrong_logs_are_refused_by_file_line_and_column() {
    let without = HEADER.replace(",accel_y_m_s2", "");
    let missing = log("missing.csv", &format!("{without}\n0,0,0,0,0,9.8,0,0\n"));
    assert_eq!(replay_refused(&missing), "missing.csv:1: column accel_y_m_s2 is missing");
    let row = "0.025,0,0,abc,0,0,9.8,0,0";
    let message = replay_refused(&log_with_row("text.csv", row));
    assert_eq!(message, "text.csv:5: column gyro_z_rad_s: \"abc\" is not a number");
    let message = replay_refused(&log_with_row("short.csv", "0.025,0,0,0,0,0"));
    assert_eq!(
        message,
        "short.csv:5: the row has 6 fields, the header has 9; the first missing column is accel_z_m_s2"
    );
    let message = replay_refused(&log_with_row("nan.csv", "0.025,0,0,0,0,NaN,9.8,0,0"));
    assert_eq!(message, "nan.csv:5: column accel_y_m_s2: NaN is not finite");
    let message = replay_refused(&log_with_row("back.csv", "0.001,0,0,0,0,0,9.8,0,0"));
    assert_eq!(message, "back.csv:5: column time_s: time goes back from 20000 to 1000 us");
    assert_eq!(replay_refused(&log("empty.csv", "")), "empty.csv:1: the file is empty; a header row is required");
    let message = replay_refused(&log("header.csv", &format!("{HEADER}\n")));
    assert_eq!(message, "header.csv:2: no samples after the header row");
    let message = replay_refused(&log("single.csv", &format!("{HEADER}\n0,0,0,0,0,0,9.8,0,0\n")));
    assert_eq!(message, "single.csv:2: column time_s: only one time, so the sample rate is unknown");
}

#[test]
fn logs_without_stops_or_moves_and_what_is_no_log_are_refused() {
    let still = log_with_row("still.csv", "0.025,0,0,0,0,0,9.8,0,0");
    let columns = "columns outer_rad and inner_rad";
    let message = replay_refused(&still);
    assert_eq!(message, format!("still.csv:1999: {columns}: no move between two stops up to the last line"));
    let turning =
        (0..2000).map(|k| format!("{:.3},0.1,0,0,0,0,9.8,{:.6},0\n", f64::from(k) * 0.005, f64::from(k) * 5e-4));
    let message = replay_refused(&log("turning.csv", &format!("{HEADER}\n{}", turning.collect::<String>())));
    assert_eq!(
        message,
        format!("turning.csv:2001: {columns}: no stop, in which both keep within 20 arcsec, up to the last line")
    );
    assert!(replay_refused(&scratch("")).ends_with("is a directory"));
    assert!(replay_refused(&scratch("nowhere.csv")).starts_with("nowhere.csv: No such file"));
}

#[test]
fn wrong_arguments_and_configurations_are_refused_in_one_line() {
    assert!(refused(&["replay"]).contains("<LOG>"));
    assert!(refused(&["bogus"]).contains("unrecognized subcommand 'bogus'"));
    assert!(refused(&["calibrate", "--stop", "-3"]).contains("--stop"));
    let names = "table1, table3, real, typical, typical:0.5, random, random:1deg, random:tactical, or a file";
    let message = refused(&["calibrate", "--errors", "table9"]);
    assert_eq!(message, format!("--errors: unknown 'table9'; known: {names}"));
    let message = refused(&["montecarlo", "--noise", "quiet"]);
    assert_eq!(message, "--noise: unknown 'quiet'; known: bai, navigation, tactical, or a file");
    let message = refused(&["montecarlo", "--hardware", "nowhere.toml"]);
    let profiles = "ideal, navigation, tactical, mems";
    assert_eq!(message, format!("--hardware: there is no file 'nowhere.toml'; names in place of a file: {profiles}"));
    for command in [&["simulate", "--out", &scratch("never.csv")][..], &["montecarlo"], &["calibrate"]] {
        let message =
            refused(&[command, &["--errors", "parameters.Sgxy = 1, effects.hardware.accel_floor_ug = nan"]].concat());
        assert_eq!(message, "--errors: hardware.accel_floor_ug: must be from 0 to 1000 ug");
    }
    let message = refused(&["simulate", "--out", &scratch("never.csv"), "--scheme", "bay"]);
    let names = rins_selfcal::scheme::library::NAMES;
    assert_eq!(message, format!("--scheme: unknown 'bay'; known: {names}, or a file"));
    assert!(
        refused(&["replay", &data("sample.csv.gz"), "--config", "nowhere.toml"]).starts_with("nowhere.toml: No su")
    );
    assert!(refused(&["replay", &data("sample.csv.gz"), "--truth", "nowhere.json"]).starts_with("nowhere.json: No su"));
    let truth = log("unknown.json", "{\"parameters\": {\n\"Sgxx\": 1}}");
    let message = refused(&["replay", &data("sample.csv.gz"), "--truth", &truth]);
    assert_eq!(message, "unknown.json:2: unknown parameter `Sgxx`");
    assert!(refused(&["montecarlo", "--runs", "0"]).contains("--runs"));
    let unit = log("unknown.toml", "[site]\nlatitude_deg = 30.0\naltitude_m = 3.0\n");
    let message = refused(&["replay", &data("sample.csv.gz"), "--config", &unit]);
    assert!(message.starts_with("unknown.toml:3: ") && message.contains("altitude_m"), "{message}");
    let nowhere = scratch("no-such-folder/out.json");
    let message = refused(&["observability", "--json", &nowhere]);
    assert!(message.starts_with("no-such-folder/out.json: No such file"), "{message}");
}

#[test]
fn files_that_would_be_lost_or_cannot_be_written_are_refused_before_the_run() {
    let out = scratch("same.csv");
    let message = refused(&["simulate", "--out", &out, "--truth", &out]);
    assert_eq!(message, "--out and --truth are the same file: same.csv");
    let page = scratch("same.html");
    let message = refused(&["calibrate", "--json", &page, "--report", &page]);
    assert_eq!(message, "--json and --report are the same file: same.html");
    let copy = scratch("copy.csv.gz");
    fs::copy(data("sample.csv.gz"), &copy).unwrap();
    let message = refused(&["replay", &copy, "--csv-estimates", &copy]);
    assert_eq!(message, "--csv-estimates would overwrite LOG: copy.csv.gz");
    assert_eq!(fs::read(&copy).unwrap(), fs::read(data("sample.csv.gz")).unwrap());
    let nowhere = scratch("no-such-folder/out.html");
    for command in [&["calibrate"][..], &["replay", &copy]] {
        // A run takes half a second or more.
        let message = refused(&[command, &["--report", &nowhere]].concat());
        assert!(message.starts_with("no-such-folder/out.html: No such file"), "{message}");
    }
    let message = refused(&["montecarlo", "--runs", "1000000", "--json", &nowhere]);
    assert!(message.starts_with("no-such-folder/out.html: No such file"), "{message}");
}

#[test]
fn replay_says_what_it_takes_for_granted() {
    let unit = data("sample.toml");
    let stdout = run(0, &["replay", &data("sample.csv.gz"), "--config", &unit]);
    let lines: Vec<_> = stdout.lines().take(2).collect();
    let site = "site: latitude 47.3769 deg, height 408 m, gravity 9.807092 m/s^2 measured, known to 0 ppm";
    assert_eq!(lines[0], format!("{site} ({unit})"), "{stdout}");
    assert!(lines[1].starts_with("noise: accelerometers 10.0 ug/sqrt(Hz), gyros 0.00100 deg/sqrt(h)"), "{stdout}");
}

#[test]
fn parameters_whose_truth_is_not_known_are_not_compared() {
    let truth = log("partial.json", "{\"parameters\": {\"Sgzx\": 210.0}}");
    let stdout = run(0, &["replay", &data("sample.csv.gz"), "--config", &data("sample.toml"), "--truth", &truth]);
    let row = |name: &str| -> Vec<String> {
        let row = stdout.lines().find(|line| line.split_whitespace().next() == Some(name)).expect("a row");
        row.split_whitespace().map(String::from).collect()
    };
    assert_eq!(row("alpha")[3..], ["-", "-", "-", "arcsec"]);
    assert!(row("Sgzx")[3].starts_with("210") && row("Sgzx")[5].parse::<f64>().unwrap().abs() < 4.5);
}

/// Reasons that a replay of the sample log gives, all of whose readings are changed.
fn reasons_with(name: &str, config: &str, change: impl Fn(&mut Reading)) -> Vec<String> {
    let (path, out) = (with_change(name, change), scratch(&format!("{name}.reasons.json")));
    run(2, &["replay", &path, "--config", config, "--json", &out]);
    let reasons = json(&out)["reasons"].as_array().unwrap().clone();
    reasons.iter().map(|reason| reason.as_str().unwrap().into()).collect()
}

/// The sample log with all readings changed.
fn with_change(name: &str, change: impl Fn(&mut Reading)) -> String {
    let path = scratch(&format!("{name}.csv.gz"));
    let mut writer = LogWriter::create(Path::new(&path), false).unwrap();
    for row in LogReader::open(Path::new(&data("sample.csv.gz"))).unwrap() {
        let mut reading = row.unwrap().reading;
        change(&mut reading);
        writer.write(&reading).unwrap();
    }
    writer.finish().unwrap();
    path
}

#[test]
fn a_configured_rate_that_is_not_that_of_the_stamps_is_noted() {
    let text_of = fs::read_to_string(data("sample.toml")).unwrap();
    let with_rate = |rate_hz: f64| {
        let mut unit: toml::Table = text_of.parse().unwrap();
        unit.insert("sampling".into(), toml::toml! { rate_hz = 0.0 }.into());
        unit["sampling"]["rate_hz"] = rate_hz.into();
        let unit = log("rate.toml", &unit.to_string());
        text(&rins(&["replay", &data("sample.csv.gz"), "--config", &unit]).stderr)
    };
    assert_eq!(with_rate(198.0), "");
    let note = with_rate(250.0);
    assert!(
        note.contains("rate_hz = 250, but the time stamps of ")
            && note.contains(" give 200 Hz; ")
            && note.lines().count() == 1,
        "{note}"
    );
}

#[test]
fn logs_in_other_units_are_rejected_for_that_alone() {
    let unit = data("sample.toml");
    let in_g = reasons_with("in-g", &unit, |reading| reading.force_a = reading.force_a.map(|force| force / 9.806_65));
    assert_eq!(
        in_g,
        [
            "[wrong-scale] the accelerometers measure 0.102 times gravity at the stops; probable cause: g in place of m/s^2"
        ]
    );
    let gyros = reasons_with("in-deg-s", &unit, |reading| reading.omega_g = reading.omega_g.map(f64::to_degrees));
    assert_eq!(
        gyros,
        [
            "[wrong-scale] the gyros turn 57.3 times as far as the encoders; probable cause: gyros in deg/s in place of rad/s"
        ]
    );
    let in_degrees = |reading: &mut Reading| {
        (reading.outer_rad, reading.inner_rad) = (reading.outer_rad.to_degrees(), reading.inner_rad.to_degrees());
    };
    let path = with_change("in-deg", in_degrees);
    let message = refused(&["replay", &path, "--config", &unit]);
    let said = "in-deg.csv.gz: outer_rad and inner_rad turn 57 times as fast as the gyros; are they in degrees in place of radians?";
    assert_eq!(message, said);
    let path = with_change("in-ms", |reading| reading.time_us *= 1000);
    let message = refused(&["replay", &path, "--config", &unit]);
    assert_eq!(message, "in-ms.csv.gz: time_s: the time stamps give 0.200 Hz; are they in ms or us in place of s?");
    let all = reasons_with("all-in-deg", &unit, |reading| {
        in_degrees(reading);
        reading.omega_g = reading.omega_g.map(f64::to_degrees);
    });
    assert_eq!(all.len(), 1);
    assert!(all[0].ends_with(" rad/s; probable cause: gyros and encoders in deg in place of rad"), "{all:?}");
}

#[test]
fn a_wrong_site_or_encoder_is_the_first_reason() {
    let text = fs::read_to_string(data("sample.toml")).unwrap();
    let at = |name: &str, latitude: &str| {
        let unit = log(&format!("{name}.toml"), &text.replace("latitude_deg = 47.3769", latitude));
        reasons_with(name, &unit, |_| ()).swap_remove(0)
    };
    for (name, latitude_deg, hemisphere) in
        [("lat", 46.9, ""), ("south", -47.3769, "; is the site in the other hemisphere?")]
    {
        let reason = at(name, &format!("latitude_deg = {latitude_deg}"));
        let felt =
            reason.strip_prefix("[wrong-latitude] the gyros measure the Earth rate of latitude ").expect(&reason);
        let (felt_deg, rest) = felt.split_once(" +- ").expect(&reason);
        // Its sigma is 0.015 deg. A site that is far off leaves other errors, too, about which all is linear: 0.1 deg.
        assert!((felt_deg.parse::<f64>().unwrap() - 47.3769).abs() < 0.17, "{reason}");
        assert!(rest.ends_with(&format!("but {latitude_deg:.3} deg is configured{hemisphere}")), "{reason}");
    }
    let unit = data("sample.toml");
    let outer = reasons_with("outer-reversed", &unit, |reading| reading.outer_rad = -reading.outer_rad);
    assert_eq!(outer, ["[wiring] the sign of the outer encoder is wrong"]);
    let inner = reasons_with("inner-reversed", &unit, |reading| reading.inner_rad = -reading.inner_rad);
    assert_eq!(inner, ["[wiring] the sign of the inner encoder is wrong"]);
    let swapped = reasons_with("encoders-swapped", &unit, |reading| {
        (reading.outer_rad, reading.inner_rad) = (reading.inner_rad, reading.outer_rad);
    });
    assert_eq!(swapped, ["[wiring] the two encoders are swapped, or an axis is wired wrongly"]);
}

#[test]
fn noise_far_from_the_configured_one_is_one_reason_per_triad() {
    let text = fs::read_to_string(data("sample.toml")).unwrap();
    let unit = log("quiet.toml", &text.replace("accel_vrw_ug_sqrt_hz = 10.0", "accel_vrw_ug_sqrt_hz = 2.0"));
    let reasons = reasons_with("quiet", &unit, |_| ());
    // 19 stops of 99 degrees of freedom and 3 channels: known to 1 %.
    let ratio = reasons[0].strip_prefix("[noise-level] the noise of the accelerometers is ");
    let ratio = ratio.and_then(|text| text.split(' ').next());
    assert!((4.9..5.1).contains(&ratio.expect("the noise first").parse::<f64>().unwrap()), "{reasons:?}");
    let of_stops = |reason: &&String| reason.starts_with("[unrest]") || reason.starts_with("[noise-rise]");
    assert_eq!(reasons.iter().filter(of_stops).count(), 0, "{reasons:?}");
}

#[test]
fn a_description_beside_the_log_is_hinted_at_but_not_used() {
    let output = rins(&["replay", &data("sample.csv.gz")]);
    assert!(text(&output.stderr).starts_with("note: ") && text(&output.stderr).contains("sample.toml is not used"));
    assert_eq!(output.status.code(), Some(0), "the gyros find the latitude");
}

#[test]
fn an_effect_is_found_where_it_is_asked_for() {
    let errors = log("tilting.toml", "[effects]\nbase_tilt_drift_arcsec_h = [200.0, 0.0]\n");
    let out = scratch("tilting.json");
    let report = scratch("tilting.html");
    let hardware = "profile = \"ideal\", base_drift_arcsec_h = 300.0";
    let arguments = ["--errors", &errors, "--hardware", hardware, "--json", &out, "--report", &report];
    let stdout = run(0, &[&["calibrate", "--scheme", "bai", "--stop", "10"], &arguments[..]].concat());
    assert!(stdout.contains("effects of the hardware") && stdout.contains("base_roll_drift"), "{stdout}");
    let states = &json(&out)["effects"];
    // The drifts, and what the site is known by.
    assert_eq!(states.as_object().map(|map| map.len()), Some(4));
    let number = |name: &str, key: &str| states[name][key].as_f64().unwrap();
    for (name, truth) in [("base_roll_drift", 200.0), ("base_pitch_drift", 0.0)] {
        let error = number(name, "value") - truth;
        assert!(error.abs() < 4.5 * number(name, "sigma"), "{name}: {error}");
    }
    assert!(number("base_roll_drift", "sigma") < 40.0);
}

#[test]
fn without_a_command_the_virtual_rins_calibrates_itself() {
    let out = scratch("calibrate.json");
    let report = scratch("calibrate.html");
    let stdout = run(0, &["--seed", "5", "--json", &out, "--report", &report]);
    assert!(stdout.contains("closed loop") && stdout.contains("verdict: accepted"), "{stdout}");
    assert!(stdout.contains("power-up: calibrating: nothing is stored"), "{stdout}");
    let head: Vec<_> = stdout.lines().skip(1).take(3).collect();
    assert!(head[0].starts_with("site: latitude 30.93041 deg, height 20 m, ") && head[0].ends_with(" (default)"));
    assert!(head[1].starts_with("noise: ") && head[1].ends_with(" (default)") && head[2] == "hardware: navigation");
    assert_eq!(json(&out)["scheme"], "fast-180");
    let same = run(0, &["calibrate", "--seed", "5", "--report", &report]);
    let result =
        |text: &str| text.split("result:").next().and_then(|text| text.split("report:").next()).map(String::from);
    assert_eq!(result(&stdout), result(&same), "the same seed gives the same result");
    let page = std::fs::read_to_string(&report).unwrap();
    assert!(page.contains("<h1>Self-calibration accepted</h1>"));
}

#[test]
fn an_imu_of_another_make_finds_the_same_errors() {
    let report = scratch("imu.html");
    let [first, second] = ["adis16495", "kvh1750"].map(|imu| {
        let out = scratch(&format!("{imu}.json"));
        run(0, &["calibrate", "--scheme", "fast-60", "--imu", imu, "--json", &out, "--report", &report]);
        json(&out)
    });
    assert_eq!(first["segments"], second["segments"]);
    assert_eq!([&first, &second].map(|saved| saved["temperature_c"].as_f64()), [Some(25.0); 2]);
    let errors = first["parameters"].as_object().unwrap().iter();
    let off = errors.map(|(name, parameter)| {
        let [first, second] = [parameter, &second["parameters"][name]].map(|p| p["value"].as_f64().unwrap());
        (first - second).abs() / parameter["sigma"].as_f64().unwrap()
    });
    // The message of the KVH 1750 comes one control period after the end of its interval, with a later status of the
    // gimbal. So a stop may begin or end one sample earlier. The mean of 1000 samples then moves with a standard
    // deviation of 0.045 of its sigma. The bound is 4.5 times that.
    let most = off.fold(0.0, f64::max);
    assert!(most > 0.0 && most < 0.2, "{most}");
}

#[test]
fn observability_predicts_the_sigmas_of_the_sample_log() {
    let out = scratch("observability.json");
    let unit = data("sample.toml");
    let stdout = run(0, &["observability", "--scheme", "bai", "--stop", "10", "--config", &unit, "--json", &out]);
    assert!(stdout.contains("all states: rank 28 of 28"), "{stdout}");
    let predicted = json(&out);
    assert_eq!(predicted["rank"], 28);
    // 289 s of stops and moves, and settling.
    assert!((289.0..296.0).contains(&predicted["duration_s"].as_f64().unwrap()));
    assert!(predicted["condition_number"].as_f64().unwrap() > 1.0);
    for (name, reachable) in json(&data("sample.truth.json"))["reachable_sigma"].as_object().unwrap() {
        let parameter = &predicted["parameters"][name];
        let ratio = parameter["sigma"].as_f64().unwrap() / reachable.as_f64().unwrap();
        // Heading and gyro biases depend on attitude; base_roll and base_pitch have one digit in the file.
        let tolerance = if name.starts_with("base_") { 0.5 } else { 0.15 };
        assert!((ratio - 1.0).abs() < tolerance && parameter["unit"].is_string(), "{name}: {ratio}");
    }
    let ranks: Vec<_> = predicted["installation_rank"].as_array().unwrap().iter().map(|at| &at["rank"]).collect();
    assert!(ranks.contains(&&9.into()) && ranks.last() == Some(&&12.into()), "{ranks:?}");
}

#[test]
fn monte_carlo_finds_the_joint_method_consistent() {
    for precision in ["f64", "f32"] {
        let out = scratch(&format!("monte-carlo-{precision}.json"));
        run(0, &["montecarlo", "--hardware", "ideal", "--runs", "60", "--precision", precision, "--json", &out]);
        // Chance puts one of 56 means outside with a probability of 6e-3.
        let [low, high] = chi_square_mean_bounds(60, 1.0, 0.9999);
        let joint = &json(&out)["methods"]["joint"];
        assert_eq!((&joint["runs"], &joint["diverged"], &joint["accepted_wrong"]), (&60.into(), &0.into(), &0.into()));
        let parameters = joint["parameters"].as_object().unwrap();
        assert_eq!(parameters.len(), PARAMETERS);
        for (name, found) in parameters {
            let squared = found["mean_normalized_squared"].as_f64().unwrap();
            assert!((low..high).contains(&squared), "{precision} {name}: {squared}");
        }
    }
}

#[test]
fn monte_carlo_puts_all_methods_side_by_side() {
    let arguments = ["montecarlo", "--method", "all", "--runs", "7", "--stop", "5", "--errors", "real"];
    let stdout = run(0, &arguments);
    assert!(
        stdout.contains("all methods on the same data") && stdout.contains("bai method: 0 accepted (0 of them wrong)"),
        "{stdout}"
    );
    assert!(stdout.contains("\n  - and 2 more\n"), "five of seven rejected runs are listed: {stdout}");
    let arguments = ["montecarlo", "--method", "bai", "--runs", "4", "--stop", "5", "--errors", "table1"];
    let stdout = run(0, &[&arguments[..], &["--noise", "bai"]].concat());
    assert!(stdout.contains("\nBai Table 1: errors of Bai's own simulation as published"), "{stdout}");
    let head: Vec<_> = stdout.lines().take(7).collect();
    assert!(head[0].starts_with("4 runs of ") && head[0].ends_with(" s at 200 Hz, open loop, seed 1"), "{stdout}");
    assert_eq!(head[1..4], ["scheme: bai, 2 periods, 37 stops of 5 s", "method: bai", "errors: table1"]);
    assert!(head[4].starts_with("site: latitude 30.93041 deg, height 20 m, ") && head[4].ends_with(" (default)"));
    assert!(head[5].starts_with("noise: accelerometers 2.12 ug/sqrt(Hz), gyros 0.000236 deg/sqrt(h)"), "{stdout}");
    assert!(head[5].ends_with("(--noise bai)") && head[6] == "hardware: navigation", "{stdout}");
    assert!(!stdout.contains("wall time"), "{stdout}");
}

/// States whose RMS error over 60 runs does not agree with their bounds. Chance gives one of 44 with a probability of
/// 4e-3.
fn beyond_chance(method: &Value, block: &str) -> Vec<(String, f64)> {
    let [low, high] = chi_square_mean_bounds(60, 1.0, 0.9999).map(f64::sqrt);
    let states = method[block].as_object().unwrap().iter();
    let ratios = states.map(|(name, found)| {
        // The bounds of the units differ, so that the mean square scatters more.
        let wider = found["scatter"].as_f64().unwrap() * 120.0_f64.sqrt();
        (name.clone(), 1.0 + (found["ratio"].as_f64().unwrap() - 1.0) / wider)
    });
    ratios.filter(|(_, ratio)| !(low..high).contains(ratio)).collect()
}

#[test]
fn closed_loop_runs_are_as_good_as_predicted() {
    let out = scratch("closed-loop.json");
    let arguments = ["montecarlo", "--hardware", "ideal", "--runs", "60", "--closed-loop", "--scheme", "fast-60"];
    let stdout = run(0, &[&arguments[..], &["--json", &out]].concat());
    assert!(stdout.contains(" of 28 (!), "), "{stdout}");
    let joint = &json(&out)["methods"]["joint"];
    assert_eq!((&joint["runs"], &joint["accepted_wrong"]), (&60.into(), &0.into()));
    assert_eq!(joint["parameters"].as_object().unwrap().len(), PARAMETERS);
    assert_eq!(beyond_chance(joint, "parameters"), []);
}

#[test]
fn effects_are_predicted_with_the_parameters() {
    let (out, plot) = (scratch("effects.json"), scratch("effects.svg"));
    let stdout = run(0, &["observability", "--scheme", "fast-180", "--json", &out, "--plot", &plot]);
    assert!(stdout.contains("rank 28 of 28"), "{stdout}");
    let predicted = json(&out);
    // A unit of navigation grade has all effects but a drift of the base.
    for info in EFFECT_INFO[..EFFECT_STATES].iter().filter(|info| !info.name.starts_with("base_")) {
        let sigma = predicted["effects"][info.name]["sigma"].as_f64().unwrap();
        assert!(sigma > 0.0 && stdout.contains(&format!("  {}", info.name)), "{}: {sigma}", info.name);
        assert!(predicted["segments"][3]["sigmas"][info.name].is_f64());
    }
}

#[test]
fn a_run_on_command_stands_by_and_one_without_enough_time_says_what_is_missing() {
    let report = scratch("terms.html");
    let stdout = run(2, &["calibrate", "--policy", "on-command", "--report", &report]);
    assert!(
        stdout.contains("power-up: standing by without a calibration: the policy permits no other decision"),
        "{stdout}"
    );
    let terms = ["--required-sigma", "0.5", "--early-finish", "--longest-run", "150"];
    let stdout = run(2, &[&["calibrate", "--report", &report], &terms[..]].concat());
    assert!(stdout.contains("arcsec, but 0.500 arcsec or less is required"), "{stdout}");
    let legs = Scheme::named("fast-180").expect("in the library").legs.len();
    let cut_short = format!(" of {legs}, because its longest permitted time was over");
    assert!(stdout.contains("[cut-short] the run ended after leg ") && stdout.contains(&cut_short), "{stdout}");
}

#[test]
fn a_scheme_is_refused_by_name_leg_and_reason() {
    let (log, report) = (scratch("refused.csv"), scratch("refused.html"));
    let commands: [&[&str]; 5] = [
        &["calibrate", "--report", &report],
        &["simulate", "--out", &log],
        &["observability"],
        &["montecarlo", "--runs", "2"],
        &["montecarlo", "--runs", "2", "--closed-loop"],
    ];
    let cases: [(&[&str], &str); 5] = [
        (
            &["--limits=-180..180,-360..360"],
            "[scheme-travel] leg 3 leaves the travel of the outer axis: -270.0 deg, travel -180.0 to 180.0 deg",
        ),
        (
            &["--limits=-360..0,-90..360"],
            "[scheme-travel] leg 13 leaves the travel of the inner axis: -180.0 deg, travel -90.0 to 360.0 deg",
        ),
        (
            &["--axis-rate", "15"],
            "[scheme-fast] the scheme turns or accelerates faster than the limits of the outer axis permit: 20.0 deg/s and 20.0 deg/s^2, at most 15.0 and 60.0",
        ),
        (
            &["--acceleration", "15"],
            "[scheme-fast] the scheme turns or accelerates faster than the limits of the outer axis permit: 20.0 deg/s and 20.0 deg/s^2, at most 60.0 and 15.0",
        ),
        (&["--stop", "0.4"], "[scheme-short-stop] the first stop is shorter than the 0.5 s that a measurement needs"),
    ];
    for (limits, reason) in cases {
        for command in commands {
            let message = refused(&[command, &["--scheme", "bai"], limits].concat());
            assert_eq!(message, format!("the configuration with scheme bai is refused: {reason}"), "{command:?}");
        }
    }
    // A scheme within the limits is run.
    run(
        0,
        &["observability", "--scheme", "bai", "--limits=-360..0,-270..0", "--axis-rate", "20", "--acceleration", "20"],
    );
    for command in [commands[0], commands[3], commands[4]] {
        let message = refused(&[command, &["--scheme", "8-position"]].concat());
        assert!(
            message.contains("scheme 8-position is refused: [scheme-unobserved] the scheme leaves Sgxz unobserved"),
            "{message}"
        );
    }
    // On demand, a scheme that leaves parameters unobserved is run too, but its result is not accepted.
    let stdout = run(2, &[commands[0], &["--scheme", "8-position", "--run-unobserved"]].concat());
    let ending = &stdout[stdout.find("verdict: rejected").expect("rejected")..];
    for hidden in ["accel_scale_x", "accel_scale_y"] {
        assert!(ending.contains(&format!("{hidden} is not observed")), "{stdout}");
    }
    let stdout = run(0, &[commands[4], &["--scheme", "16-position", "--run-unobserved"]].concat());
    assert!(stdout.contains("0 accepted (0 of them wrong), 2 rejected"), "{stdout}");
}

#[test]
fn a_planned_scheme_can_be_run_and_one_that_hides_parameters_is_not_written() {
    let (scheme, report) = (scratch("planned.toml"), scratch("planned.html"));
    let request = ["plan", "--weights", "gyro_scale_z,gamma=3", "--criterion", "a", "--angles", "45", "--out"];
    run(0, &[&request[..], &[&scheme, "--time", "60", "--evaluations", "30000"]].concat());
    let stdout = run(0, &["calibrate", "--scheme", &scheme, "--report", &report]);
    assert!(stdout.contains("verdict: accepted"), "{stdout}");
    let hidden = scratch("hidden.toml");
    // If the inner axis does not turn, its mounting is not observed.
    let still = ["--time", "60", "--evaluations", "2000", "--limits=-360..0,0..0"];
    let message = refused(&[&request[..], &[&hidden], &still[..]].concat());
    assert!(message.contains("unobserved") && message.contains("--time"), "{message}");
    assert!(!Path::new(&hidden).exists());
}

#[test]
fn a_full_output_is_an_error_and_a_closed_one_loses_no_file() {
    let (report, out) = (scratch("full.html"), scratch("full.json"));
    let command = |stdout: std::process::Stdio| {
        let arguments = ["replay", &data("sample.csv.gz"), "--config", &data("sample.toml"), "--json", &out];
        Command::new(env!("CARGO_BIN_EXE_rins")).args(arguments).args(["--report", &report]).stdout(stdout).output()
    };
    let output = command(fs::File::create("/dev/full").unwrap().into()).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).starts_with("error: standard output: No space left"), "{}", text(&output.stderr));
    assert!(Path::new(&report).exists() && json(&out)["verdict"] == "accepted");
    fs::remove_file(&out).unwrap();
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    command(writer.into()).unwrap();
    assert_eq!(json(&out)["verdict"], "accepted");
}

#[test]
fn errors_name_what_was_meant() {
    assert!(refused(&["calibrate", "--scheme", "."]).starts_with("--scheme: .: "));
    let unit = log("kept.toml", "[site]\nlatitude_deg = 48.0\n");
    let overwritten = refused(&["observability", "--config", &unit, "--json", &unit]);
    assert!(overwritten.starts_with("--json would overwrite --config: "), "{overwritten}");
    let rate = rins(&["calibrate", "--firmware", "--rate", "100"]);
    assert_eq!(rate.status.code(), Some(1));
    assert!(text(&rate.stderr).ends_with("the firmware samples at 200 Hz, not at 100\n"));
    let errors = log("unknown-error.toml", "[parameters]\nSgxy = 1.0\nSgxx = 2.0\n");
    assert_eq!(refused(&["calibrate", "--errors", &errors]), "unknown-error.toml:3: unknown parameter `Sgxx`");
    let semicolons = log("semicolons.csv", &HEADER.replace(',', ";"));
    assert_eq!(replay_refused(&semicolons), "semicolons.csv:1: the columns are separated by ';', not ','");
    for option in [["--scheme", "bai"], ["--method", "bai"]] {
        assert!(refused(&[&["observability", "--all"][..], &option].concat()).contains(option[0]));
    }
}

#[test]
fn a_corrected_log_has_no_errors_left() {
    let (cal, out) = (scratch("apply-cal.json"), scratch("apply-out.csv"));
    let site = ["--config", &data("sample.toml")];
    run(0, &[&["replay", &data("sample.csv.gz"), "--json", &cal][..], &site].concat());
    run(0, &["apply", &data("sample.csv.gz"), "--calibration", &cal, "--frame", "rotation", "--out", &out]);
    let again = scratch("apply-again.json");
    run(0, &[&["replay", &out, "--json", &again][..], &site].concat());
    let (before, after) = (json(&cal), json(&again));
    for (name, found) in after["parameters"].as_object().unwrap() {
        let number = |key: &str| found[key].as_f64().unwrap();
        // Non-perpendicularity and attitude are no errors of the IMU.
        let kept = name.starts_with("base_") || name == "heading" || name == "axis_nonperpendicularity";
        let expected = if kept { before["parameters"][name]["value"].as_f64().unwrap() } else { 0.0 };
        // The noise is the same, so what is left is of second order.
        assert!((number("value") - expected).abs() < 0.05 * number("sigma"), "{name}: {found}");
    }
    let differ = run(2, &["compare", &cal, &again]);
    assert!(differ.contains("differ beyond 4.11 sigma: ") && differ.contains("Sgzx by "), "{differ}");
    let wrong = scratch("apply-wrong.csv");
    fs::write(&wrong, fs::read_to_string(&out).unwrap() + "no,row\n").unwrap();
    let cut = scratch("apply-cut.csv");
    let message = refused(&["apply", &wrong, "--calibration", &cal, "--out", &cut]);
    assert!(message.starts_with("apply-wrong.csv:58522: the row has 2 fields, the header has 9"), "{message}");
    assert!(!Path::new(&cut).exists(), "half a log is none");
}

#[test]
fn results_are_compared_in_sigmas_of_their_difference() {
    let cal = scratch("compare-a.json");
    run(0, &["replay", &data("sample.csv.gz"), "--config", &data("sample.toml"), "--json", &cal]);
    let same = run(0, &["compare", &cal, &cal]);
    assert!(same.contains("agree: no change beyond 4.11 sigma") && !same.contains("note:"), "{same}");
    let other = scratch("compare-b.json");
    let changed = |name: &str, sigmas: f64| {
        let mut result = json(&cal);
        let sigma = result["parameters"][name]["sigma"].as_f64().unwrap();
        let value = result["parameters"][name]["value"].as_f64().unwrap();
        // Both have the same sigma.
        result["parameters"][name]["value"] = (value + sigmas * sigma * 2.0_f64.sqrt()).into();
        result["temperature_c"] = 40.0.into();
        result["site"]["latitude_deg"] = 48.0.into();
        result["method"] = "bai".into();
        fs::write(&other, result.to_string()).unwrap();
    };
    changed("Sgyz", 4.0);
    let agree = run(0, &["compare", &cal, &other]);
    assert!(agree.contains("note: the methods differ: joint and bai"), "{agree}");
    assert!(agree.contains("note: the sites differ: 47.3769 deg, "), "{agree}");
    let row: Vec<_> = agree.lines().find(|line| line.contains("Sgyz")).unwrap().split_whitespace().collect();
    assert_eq!(row[5], "4.00", "{agree}");
    changed("Sgyz", -4.5);
    assert!(run(2, &["compare", &cal, &other]).contains("differ beyond 4.11 sigma: Sgyz by -4.5 sigma"));
    let page = scratch("compare.html");
    let replay = ["replay", &data("sample.csv.gz"), "--config", &data("sample.toml")];
    run(0, &[&replay[..], &["--previous", &other, "--report", &page]].concat());
    let page = fs::read_to_string(&page).unwrap();
    assert!(page.contains("compare-b.json: they differ beyond 4.11 sigma: Sgyz by 4.5 sigma."));
    assert!(page.contains("<li>the methods differ: bai and joint"));
    changed("heading", 50.0);
    run(0, &["compare", &cal, &other]);
    fs::write(&other, "{\"verdict\": \"accepted\",\n\"parameters\": {\"Sgxx\": {\"value\": 1, \"sigma\": 1}}}")
        .unwrap();
    assert_eq!(refused(&["compare", &cal, &other]), "compare-b.json:2: parameters: unknown parameter `Sgxx`");
}

#[test]
fn completions_and_manual_name_every_command() {
    let help = run(0, &["--help"]);
    let commands = help.lines().skip_while(|line| !line.starts_with("Commands:")).skip(1);
    let commands: Vec<_> =
        commands.take_while(|line| !line.is_empty()).filter_map(|line| line.split_whitespace().next()).collect();
    assert!(commands.contains(&"replay") && commands.contains(&"man"), "{help}");
    let page = run(0, &["man"]);
    assert!(page.contains(".TH rins 1") && page.contains("\\-\\-write\\-config"), "{page}");
    for shell in ["bash", "zsh", "fish"] {
        let text = run(0, &["completions", shell]);
        for command in commands.iter().filter(|command| **command != "help") {
            assert!(text.contains(command), "{shell}: {command}");
            assert!(page.contains(&format!("rins {command}")), "{command}");
        }
    }
}

#[test]
fn quiet_commands_say_how_they_end_and_nothing_else() {
    let (log, config) = (data("sample.csv.gz"), data("sample.toml"));
    let said = |arguments: &[&str]| {
        let output = rins(arguments);
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    let nothing = |text: &str| (Some(0), text.to_string(), String::new());
    assert_eq!(said(&["replay", &log, "--config", &config, "--quiet"]), nothing("accepted\n"));
    assert_eq!(said(&["replay", "--quiet", &log, "--config", &config]), nothing("accepted\n"));
    let unchanged = "accepted; --adapt: no size of the hardware was enlarged, because the verdict names no effect of the hardware\n";
    assert_eq!(said(&["replay", "--quiet", &log, "--config", &config, "--adapt"]), nothing(unchanged));
    assert_eq!(said(&["observability", "--scheme", "fast-60", "-q"]), nothing(""));
    assert_eq!(said(&["simulate", "--quiet", "--scheme", "fast-60", "--out", &scratch("quiet.csv")]), nothing(""));
    let (status, stdout, stderr) = said(&["replay", &scratch("nowhere.csv"), "--quiet"]);
    assert_eq!((status, stdout.as_str(), stderr.lines().count()), (Some(1), "", 1), "{stderr}");
}
