//! The guide and the README: `rins guide` prints every chapter, and all commands, files and links in them exist.

use rins_selfcal::guide::CHAPTERS;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
const README: &str = include_str!("../../README.md");

fn rins(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rins")).args(arguments).output().expect("the program starts")
}

fn stdout(arguments: &[&str]) -> String {
    // As wide as the text may be, whatever the terminal of the tests is.
    stdout_in_columns("300", arguments)
}

/// README and chapters by name.
fn texts() -> impl Iterator<Item = (&'static str, &'static str)> {
    CHAPTERS.iter().map(|chapter| (chapter.name, chapter.text)).chain([("README", README)])
}

/// Every command line in code blocks and in backticks.
fn commands(text: &'static str) -> impl Iterator<Item = &'static str> {
    let in_lines = text.lines().map(|line| line.split(" #").next().unwrap_or_default().trim());
    in_lines.filter(|line| !line.starts_with('|')).chain(text.split('`').skip(1).step_by(2))
}

/// Arguments of `rins` in a command line.
fn arguments_of_rins(command: &str) -> Option<Vec<&str>> {
    let of_cargo = command.strip_prefix("cargo run --release -- ");
    let of_dist = command.strip_prefix("cargo run --profile dist -- ");
    let rest = command.strip_prefix("rins ").or(of_cargo).or(of_dist)?;
    Some(rest.split_whitespace().collect())
}

#[test]
fn every_chapter_is_listed_and_printed() {
    // Titles may be wrapped.
    let contents = stdout(&["guide"]).split_whitespace().collect::<Vec<_>>().join(" ");
    for chapter in CHAPTERS {
        assert!(contents.contains(chapter.title), "{contents}");
        let text = stdout(&["guide", chapter.name]);
        let heading = chapter.text.lines().next().expect("a heading");
        assert!(text.starts_with(heading), "{text}");
        assert_rendered(&text, 80);
    }
}

/// All lines but headings and code lines are at most this wide and have no marks of Markdown.
fn assert_rendered(text: &str, width: usize) {
    for line in text.lines().filter(|line| !line.starts_with("    ") && !line.starts_with('#')) {
        let is_rendered = line.chars().count() <= width
            && !line.starts_with('|')
            && ["](", "<!--", "---|", "**"].iter().all(|mark| !line.contains(mark));
        assert!(is_rendered, "{line}\n{text}");
    }
}

fn stdout_in_columns(columns: &str, arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rins"));
    let output = command.args(arguments).env("COLUMNS", columns).output().expect("the program starts");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("UTF-8")
}

#[test]
fn guide_and_explanations_are_wrapped_to_the_width_of_the_terminal() {
    for chapter in CHAPTERS {
        assert_rendered(&stdout_in_columns("48", &["guide", chapter.name]), 48);
        assert_rendered(&stdout_in_columns("300", &["guide", chapter.name]), 80);
    }
    for code in ["noise-level", "changed", "locked"] {
        assert_rendered(&stdout_in_columns("48", &["explain", code]), 48);
        assert_rendered(&stdout_in_columns("300", &["explain", code]), 100);
    }
    for list in ["guide", "explain"] {
        assert!(stdout_in_columns("60", &[list]).lines().skip(2).all(|line| line.chars().count() <= 60));
    }
}

#[test]
fn a_code_is_explained_however_it_is_typed_and_an_unknown_one_says_what_to_type() {
    let page = stdout(&["explain", "noise-level"]);
    for typed in ["[noise-level]", " NOISE-level ", "[Noise-Level] "] {
        assert_eq!(stdout(&["explain", typed]), page);
    }
    let refused = |code: &str| {
        let output = rins(&["explain", code]);
        assert_eq!(output.status.code(), Some(1), "{code}");
        String::from_utf8(output.stderr).expect("UTF-8")
    };
    for empty in ["", " ", "[]"] {
        let message = refused(empty);
        assert!(message.contains("type a code as it is printed in brackets"), "{message}");
    }
    let message = refused("noise-levl");
    assert!(message.contains("there is no code `noise-levl`; similar codes: noise-level"), "{message}");
    let message = refused("banana");
    assert!(message.contains("there is no code `banana`. `rins explain` lists all codes"), "{message}");
}

#[test]
fn an_unknown_chapter_is_refused_with_the_names_of_all() {
    let output = rins(&["guide", "troubles"]);
    let message = String::from_utf8(output.stderr).expect("UTF-8");
    assert_eq!((output.status.code(), message.lines().count()), (Some(1), 1), "{message}");
    assert!(CHAPTERS.iter().all(|chapter| message.contains(chapter.name)), "{message}");
}

#[test]
fn every_command_of_rins_and_its_options_exist() {
    let mut checked = BTreeSet::new();
    for (name, text) in texts() {
        for arguments in commands(text).filter_map(arguments_of_rins) {
            let subcommand =
                arguments.first().filter(|argument| argument.bytes().all(|byte| byte.is_ascii_lowercase()));
            let help = stdout(&[subcommand.unwrap_or(&"calibrate"), "--help"]);
            for option in arguments.iter().filter(|argument| argument.starts_with("--")) {
                let option = option.split(['=', ',']).next().unwrap_or_default();
                assert!(help.contains(option), "{name}: {arguments:?}: {option}");
            }
            checked.extend(subcommand.copied());
        }
    }
    let help = stdout(&["--help"]);
    let listed = help.lines().skip_while(|line| !line.starts_with("Commands:")).skip(1);
    for command in listed.take_while(|line| !line.is_empty()).filter_map(|line| line.split_whitespace().next()) {
        assert!(command == "help" || checked.contains(command), "{command} is not in the guide");
    }
}

#[test]
fn every_program_test_file_and_chapter_that_is_named_exists() {
    let host = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (name, text) in texts() {
        for command in commands(text) {
            let words: Vec<_> = command.split_whitespace().collect();
            for pair in words.windows(2) {
                let source = match pair {
                    ["--bin", program] => host.join("src/bin").join(program).with_extension("rs"),
                    ["--test", test] => host.join("tests").join(test).with_extension("rs"),
                    _ => continue,
                };
                assert!(source.exists(), "{name}: {command}");
            }
        }
        let prose = text.split("```").step_by(2);
        let links = prose.flat_map(|prose| prose.split("](").skip(1));
        let targets = links.filter_map(|rest| rest.split(')').next());
        for target in targets.filter(|target| !target.starts_with("http") && !target.starts_with("crate::")) {
            assert!(name == "README" && Path::new(ROOT).join(target).exists(), "{name}: {target}");
        }
    }
}
