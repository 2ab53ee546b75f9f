//! The paper's method against `host-tests/scripts/bai.py`, an implementation in numpy that shares no code with the core.
//!
//! `host-tests/data/bai-estimates.json` has the options of `rins simulate` by which each log is made, and the twelve that
//! the script found in it. Its seeds are fixed, so that the logs here are the same to the last digit. How the data were
//! made: `python3 host-tests/scripts/bai.py --write target/release/rins host-tests/data/bai-estimates.json`.

use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Required agreement, arcsec. The windows of the stops differ by a few samples of 30 ug, each of which is 0.0015 arcsec
/// of the mean of 3900 samples.
const AGREEMENT_ARCSEC: f64 = 0.01;

/// Bound for the estimate in which every sample of (B13) has the same weight, and not every move, arcsec.
///
/// An encoder error that grows by e in the 5.5 s of a quarter turn adds e to the sum over the move, which is divided by
/// the turn of pi / 2. Equal weights of the samples, with ramps of 1 s, give 0.884 of that. With 0.5 arcsec at either end
/// the difference is 0.116 * 0.5 * sqrt(2) / (pi / 2) = 0.052 arcsec of one move. Each error is the mean of three moves
/// or more, and 4.5 standard deviations of it are 0.14 arcsec.
const EQUAL_WEIGHTS_ARCSEC: f64 = 0.14;

fn read(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).expect("a file")).expect("JSON")
}

fn rins(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_rins")).args(arguments).output().expect("the program starts");
    // A rejected calibration has the exit status 2.
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0 | 2)), "{arguments:?}: {error}");
}

#[test]
fn the_core_finds_what_an_independent_program_finds() {
    let data = read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("data/bai-estimates.json"));
    let units = data["units"].as_array().expect("units");
    assert_eq!(units.len(), 3);
    for unit in units {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        let name = |name: &str| path(name).to_str().expect("UTF-8").to_string();
        let [log, truth, config, result] = ["log.csv", "truth.json", "unit.toml", "result.json"].map(name);
        let options = unit["simulate"].as_array().expect("options").iter().map(|word| word.as_str().expect("a word"));
        let simulate: Vec<_> = ["simulate", "--out", &log, "--truth", &truth, "--write-config", &config].into();
        rins(&simulate.into_iter().chain(options).collect::<Vec<_>>());
        rins(&["replay", &log, "--config", &config, "--method", "bai", "--json", &result]);
        let result = read(&path("result.json"));
        assert_eq!(result["method"], "bai");
        let estimates = unit["estimates_arcsec"].as_object().expect("estimates");
        assert_eq!((estimates.len(), result["parameters"].as_object().map(|all| all.len())), (12, Some(12)));
        for (parameter, expected) in estimates {
            let number = |value: &Value| value.as_f64().unwrap_or_else(|| panic!("{parameter}: {value}"));
            let found = number(&result["parameters"][parameter]["value"]);
            let off = found - number(expected);
            assert!(off.abs() < AGREEMENT_ARCSEC, "{}: {parameter} differs by {off}", unit["unit"]);
            let off = found - number(&unit["equal_weights_arcsec"][parameter]);
            assert!(off.abs() < EQUAL_WEIGHTS_ARCSEC, "{}: {parameter} differs by {off}", unit["unit"]);
        }
    }
}
