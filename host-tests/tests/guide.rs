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
    let output = rins(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("UTF-8")
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
    let contents = stdout(&["guide"]);
    for chapter in CHAPTERS {
        assert!(contents.contains(chapter.title), "{contents}");
        let text = stdout(&["guide", chapter.name]);
        let heading = chapter.text.lines().next().expect("a heading");
        assert!(text.starts_with(heading), "{text}");
        let is_prose = |line: &&str| !line.starts_with("    ") && !line.starts_with('|') && !line.starts_with('#');
        for line in text.lines().filter(is_prose) {
            let is_rendered = line.chars().count() <= 80 && !line.contains("](") && !line.contains("<!--");
            assert!(is_rendered, "{}: {line}", chapter.name);
        }
    }
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
