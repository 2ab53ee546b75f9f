//! The fuzzer for a moment, and the inputs it found before.

use std::process::Command;

const CORPUS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/data/fuzz");

fn fuzz(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_fuzz")).args(arguments).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("UTF-8")
}

#[test]
fn inputs_at_random_break_no_promise() {
    let text = fuzz(&["--inputs", "200000", "--seed", "2"]);
    assert!(text.ends_with("200000 inputs, no promise broken\n"), "{text}");
}

#[test]
fn every_input_found_before_has_the_outcome_it_is_named_after() {
    let text = fuzz(&["--replay", CORPUS]);
    let count = text.split_whitespace().next().and_then(|count| count.parse::<u32>().ok());
    assert!(count.is_some_and(|count| count >= 40), "{text}");
}

#[test]
fn the_same_seed_gives_the_same_inputs() {
    let outcomes = |seed| {
        let text = fuzz(&["--inputs", "20000", "--only", "kvh1750", "--seed", seed]);
        text.lines().skip(1).map(String::from).collect::<Vec<_>>()
    };
    assert_eq!(outcomes("3"), outcomes("3"));
    assert_ne!(outcomes("3"), outcomes("4"));
}
