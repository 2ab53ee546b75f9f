//! The pages in a browser.

use host_tests::base::apt::ensure_installed;
use host_tests::base::bai;
use host_tests::base::quantity::{fixed, significant};
use rins_selfcal::model::error_model::{INSTALLATION_STATES, PARAMETER_INFO};
use rins_selfcal::verdict::CHANNEL_NAMES;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

const BROWSER: &str = "chromium";
const SAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/data/sample");
/// Segments of the sample log.
const SEGMENTS: usize = 37;

fn rins(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_rins")).args(arguments).output().expect("rins runs");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// A page with everything on it: truth, and a calibration to compare with.
fn page(directory: &Path) -> String {
    let file = |name: &str| directory.join(name).display().to_string();
    let (json, report) = (file("previous.json"), file("report.html"));
    let replay = |more: &[&str]| {
        rins(&[&["replay", &format!("{SAMPLE}.csv.gz"), "--config", &format!("{SAMPLE}.toml")], more].concat());
    };
    replay(&["--json", &json]);
    replay(&["--truth", &format!("{SAMPLE}.truth.json"), "--previous", &json, "--report", &report]);
    report
}

/// Runs the browser on a page; its standard output and its log.
fn browse(directory: &Path, arguments: &[&str], page: &str) -> (String, String) {
    let profile = tempfile::tempdir_in(directory).expect("a profile");
    let mut command = Command::new(BROWSER);
    command
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"])
        .args(["--disable-component-update", "--disable-sync", "--enable-logging=stderr"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .args(arguments)
        .arg(format!("file://{page}"));
    let Output { status, stdout, stderr } = command.output().expect("the browser runs");
    let [stdout, stderr] = [stdout, stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(status.success(), "{stderr}");
    (stdout, stderr)
}

/// The page as the browser has it, which has nothing to complain of and has taken nothing from elsewhere.
fn dom(directory: &Path, page: &str) -> String {
    ensure_installed(BROWSER, BROWSER).unwrap_or_else(|error| panic!("{error}"));
    let (dom, log) = browse(directory, &["--dump-dom"], page);
    assert!(!log.contains("CONSOLE"), "{log}");
    assert!(!dom.contains("<script") && !dom.contains("href=\"http") && !dom.contains("src="));
    dom
}

/// What lies between two texts.
fn between<'a>(text: &'a str, start: &str, end: &str) -> &'a str {
    let rest = text.split_once(start).unwrap_or_else(|| panic!("no {start}")).1;
    rest.split_once(end).unwrap_or_else(|| panic!("no {end} after {start}")).0
}

fn figure<'a>(dom: &'a str, name: &str) -> &'a str {
    between(dom, &format!("<figure id=\"{name}\">"), "</figure>")
}

/// Points of each line that is more than a stroke, and of each filled outline.
fn points(figure: &str, element: &str) -> Vec<usize> {
    let start = format!("<{element} ");
    let elements = figure.split(&start).skip(1);
    let counts = elements.map(|element| between(element, "points=\"", "\"").split_whitespace().count());
    counts.filter(|count| *count > 2).collect()
}

/// The figure has so many curves, each of so many points at least.
fn has_curves(dom: &str, name: &str, count: usize, least: usize) {
    let found = points(figure(dom, name), "polyline");
    assert!(found.len() == count && found.iter().all(|points| *points >= least), "{name}: curves of {found:?} points");
}

/// The figure shows an estimate of so many segments and the final one, its band, and the truth as a dashed line. The line
/// of the estimate is broken where it leaves the frame.
fn has_estimate(dom: &str, name: &str, segments: usize) {
    let figure = figure(dom, name);
    let pieces = figure.split("<polyline ").filter(|line| line.contains("stroke=\"#007CBE\""));
    let shown: usize = pieces.map(|line| between(line, "points=\"", "\"").split_whitespace().count()).sum();
    assert!((2..=segments + 1).contains(&shown), "{name}: {shown} points");
    assert_eq!(points(figure, "polygon"), [2 * (segments + 1)], "{name}: band");
    let dashes = figure.split("<polyline ").filter(|line| line.contains("stroke=\"#D55E00\"")).count();
    assert!(dashes > 10, "{name}: {dashes} dashes");
}

#[test]
fn a_browser_shows_every_figure_and_has_nothing_to_complain_of() {
    let directory = tempfile::tempdir().expect("a directory");
    let dom = dom(directory.path(), &page(directory.path()));
    has_curves(&dom, "angles", 2, 1000);
    has_curves(&dom, "gyros", 3, 1000);
    has_curves(&dom, "accelerometers", 3, 1000);
    has_curves(&dom, "singular-values", INSTALLATION_STATES, 100);
    has_curves(&dom, "rank", 1, 100);
    PARAMETER_INFO.iter().for_each(|info| has_estimate(&dom, &format!("estimate-{}", info.name), SEGMENTS));
    let count = |name: &str, element: &str| figure(&dom, name).matches(element).count();
    let parameters = PARAMETER_INFO.len();
    // With the frame; a cell without any tint is not drawn.
    let cells = parameters * SEGMENTS + 1;
    assert!((cells * 9 / 10..=cells).contains(&count("contributions", "<rect ")));
    assert_eq!(count("correlation", "<rect "), parameters * parameters + 1);
    assert_eq!(count("changes", "<rect "), parameters);
    // Three channels of each move and six of each stop, and those of the legend.
    assert_eq!(count("innovations", "<circle "), 3 * 18 + 6 * 19 + CHANNEL_NAMES.len());
    assert!(dom.find("Self-calibration accepted").is_some_and(|at| at < dom.find("Certificate</h2>").unwrap_or(0)));
}

#[test]
fn the_page_is_light_or_dark_as_the_reader_likes() {
    ensure_installed(BROWSER, BROWSER).unwrap_or_else(|error| panic!("{error}"));
    let directory = tempfile::tempdir().expect("a directory");
    let page = page(directory.path());
    // Blink's numbers of the preferred colour schemes.
    let shots = [("light", 1), ("dark", 0)].map(|(name, scheme)| {
        let shot = directory.path().join(format!("{name}.png"));
        let target = format!("--screenshot={}", shot.display());
        let preferred = format!("--blink-settings=preferredColorScheme={scheme}");
        browse(directory.path(), &[&target, &preferred, "--window-size=1000,2000"], &page);
        std::fs::read(shot).expect("a screenshot")
    });
    assert!(shots.iter().all(|shot| shot.len() > 50_000) && shots[0] != shots[1]);
}

/// The paper's scheme with stops of 2 s, twice: its page and its numbers.
fn replication(directory: &Path) -> (String, Value) {
    let file = |name: &str| directory.join(name).display().to_string();
    let (report, json) = (file("replication.html"), file("replication.json"));
    rins(&["replicate", "--runs", "2", "--stop", "2", "--seed", "3", "--report", &report, "--json", &json]);
    (dom(directory, &report), read(&json))
}

fn read(path: &str) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("a file")).expect("JSON")
}

/// The cells of each row of a table, the first one too.
fn cells(dom: &str, table: &str) -> Vec<Vec<String>> {
    let body = between(between(dom, &format!("<table id=\"{table}\">"), "</table>"), "<tbody>", "</tbody>");
    let rows = body.split("<tr").filter(|row| row.contains("<td"));
    let texts = |row: &str| row.split("<td>").skip(1).map(|cell| between(cell, "", "</td>").to_string()).collect();
    rows.map(texts).collect()
}

/// What a Monte Carlo says alone that is run by this line.
fn alone(directory: &Path, command: &str) -> Value {
    let json = directory.join("alone.json");
    let command = command.replacen("rins", env!("CARGO_BIN_EXE_rins"), 1).replace("&gt;", ">");
    let output = Command::new("sh").arg("-c").arg(format!("{command} --json {}", json.display())).output();
    let output = output.expect("a shell");
    assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
    read(&json.display().to_string())
}

#[test]
fn the_replication_shows_every_table_and_figure_beside_bai() {
    let directory = tempfile::tempdir().expect("a directory");
    let (dom, numbers) = replication(directory.path());
    let panels = ["5a", "5b", "7a", "7b", "7c", "8a", "8b", "8c", "14a", "14b", "14c", "15a", "15b", "15c"];
    panels.iter().for_each(|panel| has_curves(&dom, &format!("figure-{panel}"), 1, 1000));
    has_curves(&dom, "figure-6", INSTALLATION_STATES, 100);
    has_curves(&dom, "figure-6-rank", 1, 100);
    has_curves(&dom, "figure-6-relative", 1, 2 * (SEGMENTS - 1));
    ["1", "2", "3", "4", "12", "13"]
        .iter()
        .for_each(|own| assert!(figure(&dom, &format!("figure-{own}")).contains("<svg")));
    for (index, info) in PARAMETER_INFO[..INSTALLATION_STATES].iter().enumerate() {
        // 36 moves and the stops around them.
        has_estimate(&dom, &format!("simulation-{}", info.name), 73);
        has_estimate(&dom, &format!("laboratory-{}", info.name), 73);
        let estimates = numbers["estimates"]["simulation"].as_array().expect("one after each segment");
        let last = estimates.last().map(|last| last["parameters"][info.name]["value"].as_f64().expect("a number"));
        let error = last.map(|last| fixed(last - bai::TABLE_1[index], 3));
        assert_eq!((estimates.len(), error.as_ref()), (73, Some(&cells(&dom, "table-1-numbers")[index][3])));
    }
    let rms = |study: &str, method: &str, name: &str| {
        let found = &numbers["studies"][study]["methods"][method]["parameters"][name]["rms_error"];
        significant(found.as_f64().unwrap_or_else(|| panic!("{study} {method} {name}")))
    };
    let (first, third) = (cells(&dom, "table-1-numbers"), cells(&dom, "table-3-numbers"));
    assert_eq!([first.len(), third.len()], [INSTALLATION_STATES; 2]);
    for (index, info) in PARAMETER_INFO[..INSTALLATION_STATES].iter().enumerate() {
        let name = info.name;
        let (first, third) = (&first[index], &third[index]);
        assert_eq!([&first[0], &third[0]], [name; 2]);
        assert_eq!(first[1..3], [fixed(bai::TABLE_1[index], 0), fixed(bai::TABLE_1_ERRORS[index], 3)]);
        assert_eq!(third[1..3], [fixed(bai::TABLE_3[index], 3), fixed(bai::TABLE_3_DIFFERENCES[index], 3)]);
        assert_eq!([&first[4], &first[7]], [&rms("table1", "bai", name), &rms("table1", "joint", name)]);
        assert_eq!(third[3], rms("table3", "bai", name));
        assert_eq!(third[4..6], [rms("real", "bai", name), rms("real", "joint", name)]);
    }
    for table in ["table-3-twelve", "table-3-real"] {
        as_in_table_3(&cells(&dom, table));
    }
    // The largest parts of the published numbers, to the bounds of 4 % and 6 %.
    assert!(["3.59 %", "5.98 %"].iter().all(|part| dom.contains(part)));
    assert_eq!(cells(&dom, "table-2").len(), 5);
    let activated = cells(&dom, "activated-numbers");
    let combinations: Vec<_> = activated.iter().map(|row| [row[2].as_str(), row[3].as_str()]).collect();
    assert_eq!(combinations, [["three", "3"], ["four", "4"], ["five", "5"]]);
    assert_eq!(cells(&dom, "ignored-numbers").len(), numbers["studies"].as_object().map_or(0, |all| all.len() - 3));
    // With the rank of 9 that stays until the inner axis has moved.
    let ranks = cells(&dom, "ranks");
    assert!(ranks.iter().any(|row| row[1] == "9") && ranks.last().is_some_and(|row| row[1] == "12"), "{ranks:?}");
}

/// Each difference of Table 3 is the one of its two columns, and its percent those of the reference.
fn as_in_table_3(rows: &[Vec<String>]) {
    assert_eq!(rows.len(), INSTALLATION_STATES);
    for (row, (reference, difference)) in rows.iter().zip(bai::TABLE_3.iter().zip(&bai::TABLE_3_DIFFERENCES)) {
        let number = |place: usize| row[place].trim_end_matches(" %").parse::<f64>().expect("a number");
        assert!((number(3) - (100.0 * difference / reference).abs()).abs() < 0.006, "{row:?}");
        // Rounded to 0.001 arcsec and 0.01 %.
        assert!((number(4) - number(7) - number(8)).abs() < 0.002, "{row:?}");
        assert!((number(6) - (100.0 * number(5) / number(4)).abs()).abs() < 0.006 + 0.1 / number(4).abs(), "{row:?}");
    }
}

#[test]
fn the_commands_of_the_replication_give_its_numbers_alone() {
    let directory = tempfile::tempdir().expect("a directory");
    let (dom, numbers) = replication(directory.path());
    let commands = dom.split("<p class=\"command\"><code>").skip(1).map(|rest| between(rest, "", "</code>"));
    let commands: Vec<_> = commands.filter(|command| command.starts_with("rins montecarlo")).collect();
    // One without quotes, and one with an error and an option of its own.
    for name in ["table1", "second-harmonic"] {
        let study = &numbers["studies"][name];
        let command = study["command"].as_str().expect("a command");
        assert!(commands.contains(&command), "{command} is not on the page");
        assert_eq!(alone(directory.path(), command)["methods"], study["methods"], "{command}");
    }
    let one = numbers["studies"]["table1"]["command"].as_str().expect("a command").replace("--runs 2", "--runs 1");
    let one = &alone(directory.path(), &one)["methods"]["bai"]["parameters"];
    for (row, info) in cells(&dom, "table-1-numbers").iter().zip(&PARAMETER_INFO) {
        assert_eq!(row[3], fixed(one[info.name]["mean_error"].as_f64().expect("a number"), 3), "{}", info.name);
    }
}
