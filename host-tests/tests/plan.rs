//! The library of schemes and the planner from outside: their predictions and their refusals.

use host_tests::calibration::{Precision, Setup};
use host_tests::files::scheme_file::{read_scheme, write_scheme};
use host_tests::files::unit_file::UnitConfig;
use host_tests::plan::prediction::Prediction;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::DEG;
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::scheme::library::{LIBRARY, LibraryScheme};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn scratch(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("plan");
    fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

fn rins(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rins"));
    command.current_dir(scratch("")).args(arguments).output().expect("the program starts")
}

fn run(arguments: &[&str]) -> String {
    let output = rins(arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// Runs the program and expects an error of one line.
fn refused(arguments: &[&str]) -> String {
    let output = rins(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}");
    let line = String::from_utf8(output.stderr).expect("UTF-8");
    assert_eq!(line.lines().count(), 1, "{line}");
    line.trim_end().strip_prefix("error: ").expect("says that it is an error").into()
}

fn predicted_of(unit: &UnitConfig, scheme: &Scheme) -> Prediction {
    let setup = Setup::new(unit, 200.0, Method::Joint, Precision::F64);
    Prediction::new(&setup, scheme)
}

fn predicted(scheme: &Scheme) -> Prediction {
    predicted_of(&UnitConfig::ideal(), scheme)
}

/// Time, s, and the largest sigma of Bai's twelve that the schemes `fast` and `ideal` may leave, arcsec: with hardware
/// of navigation grade, and with ideal hardware.
const MARKS: [(u32, [f64; 2]); 5] =
    [(60, [1.42, 1.00]), (90, [1.02, 0.74]), (120, [0.86, 0.60]), (180, [0.69, 0.46]), (300, [0.53, 0.35])];

#[test]
fn planned_schemes_keep_time_and_travel_and_pass_their_marks() {
    let kinds = [("fast", UnitConfig::default().somewhere()), ("ideal", UnitConfig::ideal())];
    for (time_s, marks_arcsec) in MARKS {
        for ((kind, unit), mark_arcsec) in kinds.iter().zip(marks_arcsec) {
            let name = format!("{kind}-{time_s}");
            let scheme = Scheme::named(&name).expect("in the library");
            let within = |low: f64, angle_rad: f64| (low * DEG - 1e-9..=1e-9).contains(&angle_rad);
            assert!(scheme.legs.iter().all(|leg| within(-360.0, leg.outer_rad) && within(-270.0, leg.inner_rad)));
            assert!(
                (scheme.rate_rad_s / DEG - 20.0).abs() < 1e-9 && (scheme.acceleration_rad_s2 / DEG - 20.0).abs() < 1e-9
            );
            // The memory of the firmware holds all segments.
            assert!(2 * scheme.legs.len() < MAX_SEGMENTS, "{name}");
            let prediction = predicted_of(unit, &scheme);
            assert!(prediction.duration_s <= f64::from(time_s), "{name}: {}", prediction.duration_s);
            assert!(prediction.worst_arcsec <= mark_arcsec, "{name}: {}", prediction.worst_arcsec);
            assert_eq!(prediction.parameters.0.len(), 28);
            assert_eq!(prediction.unobserved, [""; 0], "{name}");
        }
    }
}

/// Runs the command beside a planned scheme of the library; the file that it writes must be the scheme's own.
fn finds_again(entry: &LibraryScheme) {
    let arguments: Vec<&str> = entry.command.expect("it was planned").split(' ').skip(1).collect();
    run(&arguments);
    let (name, shipped) = (entry.name, scratch(&format!("{}-shipped.toml", entry.name)));
    write_scheme(&shipped, &entry.scheme()).unwrap();
    let text = |file: &Path| fs::read_to_string(file).unwrap();
    assert_eq!(text(&scratch(&format!("{name}.toml"))), text(&shipped), "{name}");
}

/// One scheme for the hardware of a real unit and one for ideal hardware, because their forecasts differ.
#[test]
fn the_planner_finds_a_shipped_scheme_again_by_its_command() {
    for name in ["fast-60", "ideal-60"] {
        finds_again(LIBRARY.iter().find(|entry| entry.name == name).expect("in the library"));
    }
}

#[test]
fn the_same_request_gives_the_same_scheme_whatever_the_cores() {
    let request = ["plan", "--time", "50", "--evaluations", "6000", "--angles", "45", "--noise", "tactical"];
    let planned = |file: &str, threads: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rins"));
        let arguments = command.current_dir(scratch("")).args(request).args(["--name", "same", "--out", file]);
        assert!(arguments.env("RAYON_NUM_THREADS", threads).status().unwrap().success());
        fs::read_to_string(scratch(file)).unwrap()
    };
    assert_eq!(planned("one.toml", "1"), planned("three.toml", "3"));
    let scheme = read_scheme(&scratch("one.toml")).unwrap();
    let quarter = |angle_rad: f64| (angle_rad / (45.0 * DEG)).fract().abs() < 1e-9;
    assert!(scheme.legs.iter().all(|leg| quarter(leg.outer_rad) && quarter(leg.inner_rad)));
    assert!(predicted(&scheme).duration_s <= 50.0);
}

#[test]
fn weights_decide_what_becomes_good() {
    let planned = |arguments: &[&str]| {
        let unit = ["--hardware", "ideal", "--evaluations", "24000"];
        let request = [&["plan", "--time", "60", "--out", "weights.toml"][..], &unit].concat();
        run(&[&request[..], arguments].concat());
        predicted(&read_scheme(&scratch("weights.toml")).unwrap())
    };
    let sigma = |prediction: &Prediction, name: &str| {
        prediction.parameters.0.iter().find(|(other, _)| *other == name).expect("a parameter").1.sigma
    };
    let usual = planned(&[]);
    let for_gyros = planned(&["--weights", "gyro_scale_x,gyro_scale_y,gyro_scale_z", "--criterion", "a"]);
    for name in ["gyro_scale_x", "gyro_scale_y", "gyro_scale_z"] {
        assert!(sigma(&for_gyros, name) < sigma(&usual, name), "{name}");
    }
    let d_optimal = planned(&["--criterion", "d"]);
    assert!(d_optimal.worst_arcsec.is_finite() && d_optimal.rank == 28);
}

#[test]
fn the_best_rate_of_the_axes_is_found_and_shown() {
    let of = |rates: &str, evaluations: &str| -> serde_json::Value {
        // The bound of the largest sigma takes much longer than the search.
        let fixed = ["plan", "--time", "30", "--criterion", "a", "--hardware", "ideal", "--angles", "45"];
        let fixed = [&fixed[..], &["--out", "rate.toml", "--json", "rate.json"]].concat();
        let text = run(&[&fixed[..], &["--axis-rate", rates, "--evaluations", evaluations]].concat());
        assert_eq!(text.contains("axis rate deg/s"), rates.contains(".."), "{text}");
        serde_json::from_str(&fs::read_to_string(scratch("rate.json")).unwrap()).unwrap()
    };
    let swept = of("2..40", "9000");
    let rates = swept["rates"].as_array().expect("a list");
    let value = |at: &serde_json::Value| at["value"].as_f64();
    // Within 30 s, a quarter of the way around at 2 deg/s leaves no time for a scheme that is as good.
    let (slow, fast) = (value(&rates[0]), value(rates.last().unwrap()).expect("it fits"));
    assert!(rates.len() == 9 && slow.is_none_or(|slow| slow > fast), "{rates:?}");
    let best = rates.iter().filter_map(value).fold(f64::INFINITY, f64::min);
    let chosen = read_scheme(&scratch("rate.toml")).unwrap().rate_rad_s.to_degrees();
    let at = rates.iter().find(|at| (at["rate_deg_s"].as_f64().unwrap() / chosen - 1.0).abs() < 1e-6);
    assert_eq!(value(at.expect("one of the rates")), Some(best));
    assert!(of("20", "1000")["rates"].is_null());
}

#[test]
fn plans_that_cannot_be_are_refused_in_one_line() {
    let out = ["plan", "--out", "never.toml", "--evaluations", "200"];
    let with = |arguments: &[&str]| refused(&[&out[..], arguments].concat());
    assert!(with(&["--time", "3"]).contains("no scheme was found that fits"));
    assert!(with(&["--time", "60", "--limits=10..90,0..90"]).contains("--limits"));
    assert!(with(&["--time", "60", "--weights", "delta"]).contains("delta: unknown parameter"));
    assert!(with(&["--time", "60", "--name", &"x".repeat(33)]).contains("32 bytes"));
    assert!(with(&["--time", "-60"]).contains("--time"));
    assert!(with(&["--time", "60", "--axis-rate", "30..10"]).contains("the lowest rate must be below the highest"));
    assert!(!scratch("never.toml").exists());
}

#[test]
fn schemes_that_cannot_be_run_are_refused_by_name_and_reason() {
    let legs = |leg: &str| {
        let file = scratch("wrong.toml");
        let first = "{ outer_deg = -90.0, inner_deg = 0.0, stop_s = 2.0 }";
        fs::write(&file, format!("name = \"wrong\"\nfirst_stop_s = 2.0\nlegs = [{first}, {leg}]\n")).unwrap();
        refused(&["calibrate", "--scheme", "wrong.toml", "--limits=-720..720,-720..720"])
    };
    let message = legs("{ outer_deg = -800.0, inner_deg = 0.0, stop_s = 2.0 }");
    assert!(message.contains("leg 2 leaves the travel of the outer axis"), "{message}");
    for stop in ["0.0", "-2.0"] {
        let message = legs(&format!("{{ outer_deg = 0.0, inner_deg = 0.0, stop_s = {stop} }}"));
        assert!(message.contains("wrong.toml:3: legs: [scheme-stop] the stop of leg 2 must be"), "{message}");
    }
    let message = legs("{ outer_deg = -180.0, inner_deg = 0.0, stop_s = 2.0 }");
    assert!(
        message.contains("scheme wrong is refused: [scheme-unobserved] the scheme leaves Sayz unobserved"),
        "{message}"
    );
    let fast =
        fs::read_to_string(scratch("wrong.toml")).unwrap().replace("first_stop_s", "rate_deg_s = 100.0\nfirst_stop_s");
    fs::write(scratch("quick.toml"), fast).unwrap();
    assert!(
        refused(&["calibrate", "--scheme", "quick.toml"]).contains("faster than the limits of the outer axis permit")
    );
    let message = refused(&["calibrate", "--scheme", "8-position"]);
    assert!(message.contains("8-position") && message.contains("unobserved"), "{message}");
}

fn cells<'a>(row: &'a str, between: &str) -> Vec<&'a str> {
    row.split(between).map(str::trim).filter(|cell| !cell.is_empty()).collect()
}

/// Whether two texts are equal, or are numbers within 2 %: rounding in the filter may change the last digit.
fn is_about(one: &str, other: &str) -> bool {
    let both = one.parse::<f64>().ok().zip(other.parse::<f64>().ok());
    both.map_or(one == other, |(one, other)| (one / other - 1.0).abs() < 0.02)
}

#[test]
fn the_library_is_compared_in_one_table() {
    let text = run(&["observability", "--all"]);
    let guide = rins_selfcal::guide::CHAPTERS.iter().find(|chapter| chapter.name == "schemes").expect("a chapter").text;
    for entry in &LIBRARY {
        let name = entry.name;
        let printed = text.lines().find(|line| line.trim_start().starts_with(&format!("{name} "))).expect(name);
        let documented = guide.lines().find(|line| line.starts_with(&format!("| {name} | "))).expect(name);
        let mut printed = cells(printed, "  ");
        // The column with the distance to the least possible sigma is not in the chapter.
        printed.remove(4);
        for (printed, documented) in printed.iter().zip(cells(documented, "|")) {
            assert!(is_about(printed, documented), "{name}: {documented} in the guide, but {printed}");
        }
    }
}

#[test]
fn what_the_hardware_costs_is_told_effect_by_effect() {
    let scheme = ["observability", "--scheme", "bai", "--stop", "10"];
    let json = |hardware: &str| -> serde_json::Value {
        run(&[&scheme[..], &["--hardware", hardware, "--json", "costs.json"]].concat());
        serde_json::from_str(&fs::read_to_string(scratch("costs.json")).unwrap()).unwrap()
    };
    let worst = |json: &serde_json::Value| json["worst_arcsec"].as_f64().expect("a number");
    let without = |json: &serde_json::Value, key: &str| {
        let each = json["hardware"]["each"].as_array().expect("a list");
        let cost = each.iter().find(|cost| cost["key"] == key).expect("in the list");
        cost["worst_without_arcsec"].as_f64().expect("a number")
    };
    let near = |one: f64, other: f64| (one / other - 1.0).abs() < 1e-6;
    let one = "profile = 'ideal', encoder_harmonic_1_arcsec = 3.0";
    let two = format!("{one}, wobble_1_arcsec = 1.0");
    let [ideal, one, two] = ["ideal", one, &two].map(json);
    assert!(ideal["hardware"].is_null());
    // A unit without its only effect is ideal. A unit with two effects becomes, without one of them, a unit with the
    // other.
    let of_ideal = one["hardware"]["worst_of_ideal_arcsec"].as_f64().expect("a number");
    assert!(near(without(&one, "encoder_harmonic_1_arcsec"), of_ideal) && of_ideal < worst(&one), "{one}");
    assert!(near(without(&two, "wobble_1_arcsec"), worst(&one)) && worst(&one) < worst(&two), "{two}");
}

#[test]
fn what_a_scheme_brings_is_told_segment_by_segment() {
    let plot = scratch("sigmas.svg");
    let text = run(&["observability", "--scheme", "fast-60", "--plot", plot.to_str().unwrap()]);
    let against_time = text.lines().skip_while(|line| cells(line, "  ").first() != Some(&"end s"));
    let rows: Vec<Vec<&str>> = against_time.take_while(|line| !line.is_empty()).map(|row| cells(row, "  ")).collect();
    // The rows are a header, the stops and the moves. The last row has the final sigmas.
    let legs = Scheme::named("fast-60").expect("in the library").legs.len();
    assert_eq!((rows.len(), rows[0].len()), (2 * legs + 2, 13), "{text}");
    for (name, sigma) in rows[0].iter().zip(&rows[2 * legs + 1]).skip(1) {
        let of_parameter = |line: &&str| cells(line, "  ").starts_with(&[name, sigma]);
        assert!(text.lines().any(|line| of_parameter(&line)), "{name} {sigma}: {text}");
    }
    let drawn = fs::read_to_string(plot).unwrap();
    assert!(drawn.starts_with("<svg") && drawn.matches("<polyline").count() >= 12);
}
