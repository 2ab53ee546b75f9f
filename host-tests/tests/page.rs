//! The report page as a browser sees it.

use host_tests::apt::ensure_installed;
use rins_selfcal::error_model::PARAMETER_INFO;
use std::path::Path;
use std::process::{Command, Output};

const BROWSER: &str = "chromium";
const SAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/data/sample");

/// A page with everything on it: truth, and a calibration to compare with.
fn page(directory: &Path) -> String {
    let file = |name: &str| directory.join(name).display().to_string();
    let (json, report) = (file("previous.json"), file("report.html"));
    let replay = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rins"));
        command.args(["replay", &format!("{SAMPLE}.csv.gz"), "--config", &format!("{SAMPLE}.toml")]).args(more);
        let Output { status, stderr, .. } = command.output().expect("rins runs");
        assert!(status.success(), "{}", String::from_utf8_lossy(&stderr));
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

#[test]
fn a_browser_shows_every_figure_and_has_nothing_to_complain_of() {
    ensure_installed(BROWSER, BROWSER).unwrap_or_else(|error| panic!("{error}"));
    let directory = tempfile::tempdir().expect("a directory");
    let page = page(directory.path());
    let (dom, log) = browse(directory.path(), &["--dump-dom"], &page);
    assert!(!log.contains("CONSOLE"), "{log}");
    let figures = [
        "angles",
        "gyros",
        "accelerometers",
        "singular-values",
        "rank",
        "contributions",
        "correlation",
        "innovations",
        "changes",
    ];
    let estimates = PARAMETER_INFO.iter().map(|info| format!("estimate-{}", info.name));
    for name in figures.into_iter().map(String::from).chain(estimates) {
        let figure = dom.split(&format!("<figure id=\"{name}\">")).nth(1).unwrap_or_else(|| panic!("no figure {name}"));
        let figure = figure.split("</figure>").next().unwrap_or_default();
        // Axes alone are some thirty elements.
        let drawn =
            figure.matches("<polyline").count() + figure.matches("<rect").count() + figure.matches("<circle").count();
        assert!(figure.starts_with("<svg") && drawn > 5, "{name}: {drawn} elements");
    }
    assert!(dom.find("Self-calibration accepted").is_some_and(|at| at < dom.find("Certificate</h2>").unwrap_or(0)));
    // Nothing from elsewhere.
    assert!(!dom.contains("<script") && !dom.contains("href=\"http") && !dom.contains("src="));
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
