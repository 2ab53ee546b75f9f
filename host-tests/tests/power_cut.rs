//! The power is cut while the firmware stores a calibration, by killing the emulator. The next power-up finds the
//! earlier calibration or the new one, intact, and reports the damage if the cut has left any.

use anyhow::Result;
use host_tests::bench::Bench;
use host_tests::bench::emulator::image::{Board, Image, build};
use host_tests::bench::emulator::{MachineSetup, run};
use host_tests::monitor::history::{History, MemoryKind};
use host_tests::virtual_unit::drive::move_durations_s;
use host_tests::virtual_unit::driven::DrivenRins;
use host_tests::virtual_unit::plant::{Output, Plant, Tick};
use host_tests::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::method::Method;
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::result::StoredCalibration;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;
use std::cell::Cell;
use std::path::Path;

/// A unit whose power is cut after a number of control periods.
struct Counted<'a> {
    rins: DrivenRins,
    left: &'a Cell<Option<u32>>,
    cut: &'a Cell<bool>,
    off: &'a Cell<bool>,
}

impl Plant for Counted<'_> {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        if let Some(left) = self.left.get() {
            self.left.set(Some(left.saturating_sub(1)));
            self.cut.set(left == 0);
        }
        if self.off.get() { None } else { self.rins.advance(outputs) }
    }
}

/// Powers the unit up and returns its messages. With `periods`, the power is cut so many control periods after the unit
/// has begun to store. Otherwise the unit is switched off when it corrects samples.
fn boot(image: &Image, eeprom: &Path, policy: PowerUpPolicy, seed: u64, periods: Option<u32>) -> Result<Vec<Message>> {
    let unit = VirtualUnit::default();
    let scheme = Scheme::named("fast-60").expect("in the library");
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    let mut rins = DrivenRins::new(&unit, seed);
    rins.expect_moves(&move_durations_s(&scheme, unit.rate_hz));
    let usual = SelfCalibrationConfig::new(calibrator, scheme);
    let assignment = Assignment::SelfCalibrate(SelfCalibrationConfig { policy, ..usual });
    let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
    let configuration = postcard::to_slice(&assignment, &mut buffer)?;
    let (left, cut, off) = (Cell::new(None), Cell::new(false), Cell::new(false));
    let mut bench = Bench::new(Counted { rins, left: &left, cut: &cut, off: &off });
    let setup = MachineSetup { eeprom: Some(eeprom), configuration, cut: Some(&cut), ..MachineSetup::new(image) };
    let mut messages = Vec::new();
    let on_message = |message: &Message| {
        match message {
            Message::State { state: State::Store, .. } => left.set(periods),
            Message::State { state: State::Correcting, .. } => off.set(true),
            _ => {}
        }
        messages.push(message.clone());
    };
    let ended = run(&setup, &mut bench, |_| (), on_message);
    match periods {
        Some(_) => assert!(cut.get(), "{ended:?}"),
        None => assert!(ended?.success),
    }
    Ok(messages)
}

/// The bytes of a stored record. They are compared in place of the record, because NaN differs from NaN.
fn bytes(record: &StoredCalibration) -> Vec<u8> {
    postcard::to_stdvec(record).expect("it serializes")
}

#[test]
fn a_cut_while_storing_leaves_the_old_or_the_new_calibration_and_is_told() {
    let image = build(Board::Mps2An500).unwrap_or_else(|error| panic!("{error:#}"));
    let directory = tempfile::tempdir().expect("a directory");
    let eeprom = directory.path().join("eeprom");
    let history = || History::read(&eeprom, Some(MemoryKind::Eeprom)).expect("the memory");
    boot(&image, &eeprom, PowerUpPolicy::Always, 1, None).expect("a run");
    let old = bytes(&history().entries[0]);
    let stored = std::fs::read(&eeprom).expect("the memory");
    boot(&image, &eeprom, PowerUpPolicy::Always, 2, None).expect("a run");
    let new = bytes(&history().entries[0]);
    assert_ne!(old, new);
    // A record is written within 130 ms and read back within 148 ms.
    let (mut found_old, mut found_new, mut damaged) = (0, 0, 0);
    for periods in [0, 10, 30, 50, 70, 90, 139] {
        std::fs::write(&eeprom, &stored).expect("the memory");
        let cut = boot(&image, &eeprom, PowerUpPolicy::Always, 2, Some(periods)).expect("a run");
        assert!(!cut.contains(&Message::Saved(true)), "after {periods} periods");
        let after = history();
        let told = boot(&image, &eeprom, PowerUpPolicy::WhenDue { age_s: None, temperature_k: None }, 2, None)
            .expect("a power-up");
        assert!(after.damaged <= 1, "after {periods} periods");
        let expected = Message::Store { found: true, damaged: after.damaged > 0, fault: false, other_version: None };
        assert_eq!(told[0], expected, "after {periods} periods");
        let found = bytes(&after.entries[0]);
        assert!(found == old || found == new, "after {periods} periods: neither");
        assert!(told.iter().any(|message| matches!(message, Message::State { state: State::Correcting, .. })));
        found_old += u32::from(found == old);
        found_new += u32::from(found == new);
        damaged += u32::from(after.damaged > 0);
    }
    // The cuts fall into all parts of the write. The last one is after the write and before the firmware has reported
    // it.
    let counts = (found_old, found_new, damaged);
    assert!(found_old >= 3 && found_new >= 1 && damaged >= 2, "old, new, damaged: {counts:?}");
}
