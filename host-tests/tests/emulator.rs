//! The firmware image in the emulator.

use anyhow::Result;
use host_tests::bench::{AtRest, Bench, Chip};
use host_tests::emulator::{Run, Scalar, Setup, build, run};
use rins_selfcal::queue::Losses;
use rins_selfcal::telemetry::Message;
use std::path::{Path, PathBuf};
use std::time::Duration;

struct Outcome {
    run: Run,
    log: Vec<String>,
    messages: Vec<Message>,
}

impl Outcome {
    fn last_progress(&self) -> (u32, u64, Losses) {
        match self.messages.last() {
            Some(Message::Progress { samples, time_us, losses }) => (*samples, *time_us, *losses),
            other => panic!("{other:?}, {:?}", self.log),
        }
    }
}

fn image(scalar: Scalar) -> PathBuf {
    build(scalar).unwrap_or_else(|error| panic!("{error:#}"))
}

fn try_run(setup: &Setup<'_>, bench: &mut Bench<AtRest>) -> Result<Outcome> {
    let (mut log, mut messages) = (Vec::new(), Vec::new());
    let on_message = |bytes: &[u8]| messages.push(postcard::from_bytes(bytes).expect("a message"));
    let run = run(setup, bench, |line| log.push(line.to_owned()), on_message)?;
    Ok(Outcome { run, log, messages })
}

fn outcome(setup: &Setup<'_>, bench: &mut Bench<AtRest>) -> Outcome {
    let outcome = try_run(setup, bench).unwrap_or_else(|error| panic!("{error:#}"));
    println!("{:#?}\n{:?}\n{}", outcome.run, outcome.messages.last(), outcome.log.join("\n"));
    outcome
}

fn store(outcome: &Outcome) -> (bool, bool, u32) {
    match outcome.messages.first() {
        Some(Message::Store { found, damaged, degrees_of_freedom }) => (*found, *damaged, *degrees_of_freedom),
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_sample_is_delivered() {
    for scalar in [Scalar::F64, Scalar::F32] {
        let image = image(scalar);
        let mut bench = Bench::new(AtRest::new(2000));
        let outcome = outcome(&Setup { configuration: &[7; 300], ..Setup::new(&image) }, &mut bench);
        assert!(outcome.run.success);
        assert_eq!(outcome.last_progress(), (2000, 1999 * 5000, Losses::default()));
        assert_eq!(outcome.run.late_edges, 0);
        assert!(outcome.log.iter().any(|line| line.contains("configuration of 300 bytes")), "{:?}", outcome.log);
        assert_eq!(bench.samples(), 2000);
        assert_eq!(bench.plant().rates_rad_s, [0.0, 0.0]);
    }
}

#[test]
fn edges_come_at_200_hz() {
    let image = image(Scalar::F64);
    let run = |samples| outcome(&Setup::new(&image), &mut Bench::new(AtRest::new(samples))).run.elapsed_s;
    assert!((run(3000) - run(1000) - 10.0).abs() < 1e-4);
}

#[test]
fn a_run_repeats_to_the_tick() {
    let image = image(Scalar::F64);
    let run = || outcome(&Setup::new(&image), &mut Bench::new(AtRest::new(1000))).run;
    let (first, second) = (run(), run());
    assert_eq!((first.elapsed_s, first.instructions), (second.elapsed_s, second.instructions));
}

#[test]
fn damaged_frames_are_counted() {
    let image = image(Scalar::F64);
    let mut bench = Bench::new(AtRest::new(1000));
    let mut transfers = 0;
    bench.damage(move |chip, frame| {
        transfers += u32::from(chip == Chip::OuterEncoder);
        if chip == Chip::OuterEncoder && transfers % 100 == 0 {
            frame[3] ^= 4;
        }
    });
    let outcome = outcome(&Setup::new(&image), &mut bench);
    assert_eq!(outcome.last_progress(), (990, 998 * 5000, Losses { crc: 10, ..Losses::default() }));
}

#[test]
fn records_survive_a_boot_and_damage_is_found() {
    let image = image(Scalar::F64);
    let directory = tempfile::tempdir().expect("a directory");
    let eeprom = directory.path().join("eeprom.bin");
    let boot = |samples| {
        let setup = Setup { eeprom: Some(&eeprom), ..Setup::new(&image) };
        store(&outcome(&setup, &mut Bench::new(AtRest::new(samples))))
    };
    assert_eq!(boot(10), (false, false, 0));
    assert_eq!(boot(20), (true, false, 10));
    // The newest record is in the second slot now.
    flip(&eeprom, 1024 + 100);
    assert_eq!(boot(30), (true, true, 10));
    // The damaged slot was written again.
    assert_eq!(boot(40), (true, false, 30));
}

fn flip(path: &Path, offset: usize) {
    let mut bytes = std::fs::read(path).expect("the EEPROM");
    bytes[offset] ^= 0x20;
    std::fs::write(path, bytes).expect("the EEPROM");
}

#[test]
fn a_hang_is_an_error() {
    let image = image(Scalar::F64);
    let setup = Setup { patience: Duration::ZERO, ..Setup::new(&image) };
    let error = try_run(&setup, &mut Bench::new(AtRest::new(1000))).err().expect("an error");
    assert!(error.to_string().contains("hangs"), "{error:#}");
}

#[test]
fn an_image_that_is_none_is_an_error() {
    let setup = Setup::new(Path::new("/dev/null"));
    assert!(try_run(&setup, &mut Bench::new(AtRest::new(10))).is_err());
}
