//! Journals on virtual memories: marks of motion and configurations of the unit. Each exhaustive test prints its number
//! of cases.

use super::{Internal, Pages, Serial, Virtual, framed_as};
use host_tests::bench::memory::{MemoryFault, Torn, VirtualEeprom, VirtualFlash};
use rayon::prelude::*;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::site::Site;
use rins_selfcal::estimator::HeadingSource;
use rins_selfcal::instrument::{Archive, FoundConfiguration, FoundRecord, UnitMemory};
use rins_selfcal::keep::configuration::{CONFIGURATION_BYTES, Configurations};
use rins_selfcal::keep::frame::Damage;
use rins_selfcal::keep::journal::{Journal, Latest};
use rins_selfcal::keep::mark::{MARK_BYTES, MARKS_AHEAD, Mark, Marks};
use rins_selfcal::keep::medium::{Eeprom, Flash};
use rins_selfcal::keep::partition::Layout;
use rins_selfcal::keep::slots::{Kind, StoreError};
use rins_selfcal::keep::store::CalibrationStore;
use rins_selfcal::link::Refusal;
use rins_selfcal::run::assignment::Assignment;
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::unit::{UnitConfiguration, UnitName};
use rins_selfcal::scheme::{Leg, MAX_LEGS, Scheme};
use std::cell::RefCell;
use std::fmt::Debug;
use std::ops::Range;

/// A kind of record with examples.
trait Example: Kind<Record: PartialEq + Debug + Sync> + Sync {
    /// The record of this number. Even numbers differ from odd ones, so that records of both kinds follow each other.
    fn record(number: u32) -> Self::Record;

    /// What a power-up takes a lost record for.
    fn lost() -> Option<Self::Record> {
        None
    }

    /// What a power-up takes for the newest record.
    fn newest<M: Virtual>(journal: &mut Journal<M, Self>) -> Option<Self::Record>
    where
        Self: Sized,
    {
        journal.load().expect("a memory that works").record
    }
}

impl Example for Marks {
    fn lost() -> Option<Mark> {
        Some(Mark::Moving)
    }

    fn newest<M: Virtual>(journal: &mut Journal<M, Self>) -> Option<Mark> {
        journal.last_mark()
    }

    fn record(number: u32) -> Mark {
        if number.is_multiple_of(2) { Mark::Moving } else { Mark::AtRest { angles_rad: [f64::from(number), -0.25] } }
    }
}

impl Example for Configurations {
    fn record(number: u32) -> UnitConfiguration {
        let Assignment::SelfCalibrate(run) = Assignment::default() else { panic!("no default configuration") };
        let name = "unit".repeat(1 + number as usize % 2).parse().unwrap();
        UnitConfiguration { unit: UnitName { name, serial: number.to_string().parse().unwrap() }, run }
    }
}

/// An EEPROM of this many bytes.
fn eeprom(length: usize) -> Pages {
    Eeprom(VirtualEeprom::blank(length))
}

/// A journal after `count` records.
fn written<M: Virtual, K: Example>(blank: &M, count: u32) -> Journal<M, K> {
    let mut journal = Journal::new(blank.clone());
    (0..count).for_each(|number| assert_eq!(journal.write(&K::record(number)), Ok(0)));
    journal
}

/// The same memory after power-up.
fn rebooted<M: Virtual, K: Kind>(journal: Journal<M, K>) -> Journal<M, K> {
    let mut memory = journal.release();
    memory.power().on();
    Journal::new(memory)
}

fn newest<M: Virtual, K: Example>(count: u32) -> Result<Latest<K::Record>, StoreError<M::Error>> {
    Ok(Latest { record: count.checked_sub(1).map(K::record), damage: None })
}

#[test]
fn the_newest_record_of_a_journal_is_found() {
    fn check<M: Virtual, K: Example>(blank: &M, counts: impl IntoIterator<Item = u32>) {
        for count in counts {
            let mut journal = rebooted(written::<M, K>(blank, count));
            assert_eq!(journal.load(), newest::<M, K>(count));
            assert_eq!(journal.prepare(1), Ok(()));
            assert_eq!(rebooted(journal).load(), newest::<M, K>(count));
        }
    }
    check::<_, Marks>(&eeprom(2048), 0..70);
    check::<_, Marks>(&Internal::blank(), [0, 1, 2, 2047, 2048, 2049, 4096, 4097, 6144, 9000]);
    check::<_, Marks>(&Serial::blank(), 0..400);
    check::<_, Configurations>(&eeprom(6144), 0..10);
    check::<_, Configurations>(&Internal::blank(), 0..140);
    check::<_, Configurations>(&Serial::blank(), 0..15);
}

// ------------------------------------------------------------------------------------------------------- power is cut

/// Everything that changes the memory.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Act {
    Write,
    Prepare,
}

fn act<M: Virtual, K: Example>(journal: &mut Journal<M, K>, act: Act, number: u32) {
    // The result does not count: power is cut during the act or just after it.
    match act {
        Act::Write => drop(journal.write(&K::record(number))),
        Act::Prepare => drop(journal.prepare(MARKS_AHEAD)),
    }
}

fn steps<M: Virtual, K: Example>(before: &M, what: Act, number: u32) -> usize {
    let mut journal = Journal::<M, K>::new(before.clone());
    journal.memory().power().on();
    act(&mut journal, what, number);
    journal.memory().power().steps()
}

/// Cuts the power in a step, and passes what the next power-up finds to `judge`.
fn cut<M: Virtual, K: Example>(
    before: &M,
    (what, number, step, torn): (Act, u32, usize, Torn),
    judge: impl Fn(&mut Journal<M, K>, &str),
) -> M {
    let mut journal = Journal::<M, K>::new(before.clone());
    journal.memory().power().cut_after(step, torn);
    act(&mut journal, what, number);
    let mut journal = rebooted(journal);
    let context = format!("{number}: {what:?} {step} {torn:?}");
    judge(&mut journal, &context);
    let at_boot = journal.memory().clone();
    journal.prepare(MARKS_AHEAD).expect("a place");
    for next in [number + 1, number + 2] {
        assert_eq!(journal.write(&K::record(next)), Ok(0), "{context}");
        journal = rebooted(journal);
        assert_eq!(K::newest(&mut journal), Some(K::record(next)), "{context}");
    }
    at_boot
}

/// Every step of every act at these numbers of records, left in every way. Returns the number of cases.
fn cut_everywhere<M: Virtual, K: Example>(
    blank: &M,
    counts: impl IntoParallelIterator<Item = u32>,
    judge: impl Fn(&mut Journal<M, K>, Act, u32, &str) + Sync,
) -> usize {
    let each = |number: u32| {
        let before = written::<M, K>(blank, number).release();
        let mut cases = 0;
        for what in [Act::Prepare, Act::Write] {
            for step in 0..steps::<M, K>(&before, what, number) {
                for torn in Torn::ALL {
                    let judge = |journal: &mut _, context: &str| judge(journal, what, number, context);
                    cut::<M, K>(&before, (what, number, step, torn), judge);
                    cases += 1;
                }
            }
        }
        cases
    };
    counts.into_par_iter().map(each).sum()
}

/// Numbers of records around the beginning of each of two sectors of 128 KiB.
fn around_sectors(per_sector: u32) -> Vec<u32> {
    [0, per_sector, 2 * per_sector, 3 * per_sector]
        .into_iter()
        .flat_map(|at: u32| at.saturating_sub(2)..at + 3)
        .collect()
}

/// The mark before, or the new one once it is whole. An older mark of rest never comes back, and after a torn mark of
/// motion the mark of rest before it does not either.
fn judge_mark<M: Virtual>(journal: &mut Journal<M, Marks>, what: Act, number: u32, context: &str) {
    let (before, new) = (number.checked_sub(1).map(Marks::record), Marks::record(number));
    let found = journal.last_mark();
    let is_torn = journal.load().expect("a memory that works").damage.is_some();
    assert_eq!(is_torn, journal.load().unwrap().damage.is_some());
    if is_torn {
        assert_eq!(found, Some(Mark::Moving), "{context}");
    } else {
        assert!(found == before || found == Some(new) && what == Act::Write, "{context}: {found:?}");
    }
}

#[test]
fn a_mark_that_is_cut_is_the_mark_before_or_the_new_one_or_counts_as_moving() {
    let eeprom = cut_everywhere::<_, Marks>(&eeprom(2048), 0..67, judge_mark);
    let internal = cut_everywhere::<_, Marks>(&Internal::blank(), around_sectors(2048), judge_mark);
    let serial = cut_everywhere::<_, Marks>(&Serial::blank(), 0..260, judge_mark);
    println!("marks cut: {eeprom} in EEPROM, {internal} in internal flash, {serial} in serial flash");
    assert!(eeprom > 20_000 && internal > 150 && serial > 15_000);
}

/// The slot of a mark of motion that is partly written no longer lets the mark of rest before it stand.
#[test]
fn a_torn_mark_of_motion_over_a_mark_of_rest_counts_as_moving() {
    let before = written::<_, Marks>(&eeprom(2048), 34);
    let before = before.release();
    let mut cases = 0;
    for step in 0..steps::<_, Marks>(&before, Act::Write, 34) {
        for torn in Torn::ALL {
            let mut journal = Journal::<_, Marks>::new(before.clone());
            journal.memory().power().cut_after(step, torn);
            assert!(journal.write(&Mark::Moving).is_err());
            let mut journal = rebooted(journal);
            let is_untouched = *journal.memory().bytes() == before.0.bytes;
            let expected = if is_untouched { Marks::record(33) } else { Mark::Moving };
            assert_eq!(journal.last_mark(), Some(expected), "{step} {torn:?}");
            cases += usize::from(!is_untouched);
        }
    }
    println!("torn marks of motion: {cases}");
    assert!(cases > 150);
}

/// The configuration before, or the new one.
fn judge_configuration<M: Virtual>(journal: &mut Journal<M, Configurations>, what: Act, number: u32, context: &str) {
    let (before, new) = (number.checked_sub(1).map(Configurations::record), Configurations::record(number));
    let found = journal.load().expect("a memory that works").record;
    assert!(found == before || found == Some(new) && what == Act::Write, "{context}: {found:?}");
}

#[test]
fn a_configuration_that_is_cut_is_the_one_before_or_the_new_one() {
    let eeprom = cut_everywhere::<_, Configurations>(&eeprom(6144), 0..7, judge_configuration);
    let internal = cut_everywhere::<_, Configurations>(&Internal::blank(), around_sectors(64), judge_configuration);
    let serial = cut_everywhere::<_, Configurations>(&Serial::blank(), 0..14, judge_configuration);
    println!("configurations cut: {eeprom} in EEPROM, {internal} in internal flash, {serial} in serial flash");
    assert!(eeprom > 10_000 && internal > 1_000 && serial > 5_000);
}

/// Power is cut again, in the write after the first cut.
#[test]
fn a_mark_that_is_cut_twice_is_one_that_was_written_or_counts_as_moving() {
    let each = |number: u32| {
        let before = written::<_, Marks>(&Serial::blank(), number).release();
        let mut cases = 0;
        for step in 0..steps::<_, Marks>(&before, Act::Write, number) {
            for torn in Torn::ALL {
                let first = (Act::Write, number, step, torn);
                let between = cut::<_, Marks>(&before, first, |_, _| ());
                let known = Journal::<_, Marks>::new(between.clone()).last_mark();
                for again in 0..steps::<_, Marks>(&between, Act::Write, number + 1) {
                    for torn in [Torn::Half, Torn::Lost] {
                        let second = (Act::Write, number + 1, again, torn);
                        cut::<_, Marks>(&between, second, |journal, context| {
                            let found = journal.last_mark();
                            let allowed = [known, Some(Mark::Moving), Some(Marks::record(number + 1))];
                            assert!(allowed.contains(&found), "{first:?}, then {context}: {found:?}");
                        });
                        cases += 1;
                    }
                }
            }
        }
        cases
    };
    // Writes in the middle of a sector, and writes that begin the next sector.
    let cases: usize = [30, 31, 63, 64].into_par_iter().map(each).sum();
    println!("marks cut twice: {cases}");
    assert!(cases > 5_000);
}

/// Every step of an erase after these numbers of records, left in every way. Returns in how many cases the newest
/// record was found, and in how many there was none.
fn cut_erase_everywhere<M: Virtual, K: Example>(
    blank: &M,
    counts: impl IntoParallelIterator<Item = u32>,
    seeds: u64,
) -> [usize; 2] {
    let each = |count: u32| {
        let before = written::<M, K>(blank, count).release();
        let mut journal = Journal::<M, K>::new(before.clone());
        journal.memory().power().on();
        journal.erase().expect("a memory that works");
        assert_eq!(journal.load(), newest::<M, K>(0));
        let mut found = [0, 0];
        for step in 0..journal.memory().power().steps() {
            for (torn, seed) in Torn::ALL.into_iter().flat_map(|torn| (0..seeds).map(move |seed| (torn, seed))) {
                let context = format!("{count}: {step} {torn:?} {seed}");
                found[usize::from(!cut_erase::<M, K>(&before, (count - 1, step, torn, seed), &context))] += 1;
            }
        }
        found
    };
    counts.into_par_iter().map(each).reduce(|| [0, 0], |sum, found| [sum[0] + found[0], sum[1] + found[1]])
}

/// Cuts the power in an erase. The newest record is found, or none, or what a lost record is taken for. Returns whether
/// the record was found.
fn cut_erase<M: Virtual, K: Example>(
    before: &M,
    (newest, step, torn, seed): (u32, usize, Torn, u64),
    context: &str,
) -> bool {
    let mut journal = Journal::<M, K>::new(before.clone());
    journal.memory().power().cut_at_random(step, torn, seed);
    assert!(journal.erase().is_err(), "{context}");
    let mut journal = rebooted(journal);
    let (found, newest) = (K::newest(&mut journal), Some(K::record(newest)));
    assert!(found == newest || found.is_none() || found == K::lost(), "{context}: {found:?}");
    journal.prepare(2).expect("a place");
    // The remainder after the cut may be reported as damage until the next write.
    assert_eq!(journal.write(&K::record(99)), Ok(0), "{context}");
    let mut journal = rebooted(journal);
    assert_eq!(journal.load().expect("a memory that works").record, Some(K::record(99)), "{context}");
    found == newest
}

#[test]
fn an_erase_of_a_journal_that_is_cut_leaves_the_newest_record_or_none() {
    let counts = |per_sector| around_sectors(per_sector).into_par_iter().filter(|count| *count > 0);
    for (name, [found, none]) in [
        ("a configuration in EEPROM", cut_erase_everywhere::<_, Configurations>(&eeprom(6144), 3..5, 1)),
        (
            "a configuration in internal flash",
            cut_erase_everywhere::<_, Configurations>(&Internal::blank(), counts(64), 5),
        ),
        ("a configuration in serial flash", cut_erase_everywhere::<_, Configurations>(&Serial::blank(), 1..8, 40)),
        ("marks in EEPROM", cut_erase_everywhere::<_, Marks>(&eeprom(1024), 22..24, 1)),
        ("marks in internal flash", cut_erase_everywhere::<_, Marks>(&Internal::blank(), counts(2048), 5)),
        ("marks in serial flash", cut_erase_everywhere::<_, Marks>(&Serial::blank(), counts(64), 40)),
    ] {
        println!("erases of {name} cut: the newest was found in {found} cases, none in {none}");
        assert!(found > 50 && none > 50);
    }
}

// ---------------------------------------------------------------------------------------------------- damage and wear

#[test]
fn a_flipped_bit_never_brings_back_an_older_mark_of_rest() {
    // Record 65 is a mark of rest in slot 1.
    let memory = written::<_, Marks>(&eeprom(2048), 66).release();
    let moving = (0..2048 * 8).into_par_iter().filter(|bit| {
        let mut memory = memory.clone();
        memory.bytes()[bit / 8] ^= 1 << (bit % 8);
        let found = Journal::<_, Marks>::new(memory).last_mark();
        assert!(found == Some(Marks::record(65)) || found == Some(Mark::Moving), "bit {bit}: {found:?}");
        found == Some(Mark::Moving)
    });
    // The bits of the newest mark, and those of the slot after it.
    let (rest, motion) = (12 + 17 + 4, 12 + 1 + 4);
    assert_eq!(moving.count(), 8 * (rest + motion));
}

/// The first mark in a sector is lost after the motion that it tells of. Nothing takes away the damage before the next
/// mark is written.
#[test]
fn a_lost_mark_of_motion_counts_as_moving_until_the_next_mark() {
    // Mark 64 is the first in the second of three sectors. The mark of rest before it is intact.
    let mut journal = written::<_, Marks>(&Serial::blank(), 65 + 192);
    journal.memory().flash().set_readable(4096 + 64 * MARK_BYTES, false);
    for _ in 0..3 {
        journal = rebooted(journal);
        assert_eq!(journal.last_mark(), Some(Mark::Moving));
        journal.prepare(MARKS_AHEAD).expect("a place");
    }
    assert_eq!(journal.write(&Marks::record(1)), Ok(0));
    assert_eq!(rebooted(journal).last_mark(), Some(Marks::record(1)));
}

/// Every byte is stuck, at 0 and at 1. Marks are still written, and the last one is found or counts as motion.
#[test]
fn a_stuck_byte_never_brings_back_an_older_mark_of_rest() {
    let memory = written::<_, Marks>(&eeprom(512), 20).release();
    for (address, value) in (0..512).flat_map(|address| [(address, 0), (address, 0xff)]) {
        let mut memory = memory.clone();
        memory.stick(vec![(address, value)]);
        let mut journal = Journal::<_, Marks>::new(memory);
        for number in 20..40 {
            assert!(journal.write(&Marks::record(number)).is_ok_and(|failed| failed <= 1), "{address:#x}");
            journal = rebooted(journal);
            let found = journal.last_mark();
            assert!(found == Some(Marks::record(number)) || found == Some(Mark::Moving), "{address:#x}: {found:?}");
        }
    }
}

#[test]
fn a_memory_that_does_not_answer_counts_as_moving() {
    let mut journal = written::<_, Marks>(&eeprom(2048), 6);
    journal.memory().power().cut_after(0, Torn::Untouched);
    assert_eq!(journal.write(&Mark::Moving), Err(StoreError::Memory(MemoryFault::PowerOff)));
    assert_eq!(Journal::<_, Marks>::new(journal.release()).last_mark(), Some(Mark::Moving));
    let small = Journal::<_, Marks>::new(eeprom(2 * MARK_BYTES - 1)).last_mark();
    assert_eq!(small, Some(Mark::Moving));
    assert_eq!(Journal::<_, Marks>::new(eeprom(2 * MARK_BYTES)).last_mark(), None);
}

/// A record in another version of the format is not passed over for an older one, and the log goes on after it.
#[test]
fn the_newest_record_in_another_version_is_told_and_not_passed_over() {
    for version in [b'0', b'2'] {
        let mut memory = written::<_, Marks>(&eeprom(2048), 4).release();
        let slot = framed_as(*b"RSM", version, 4, &[7; 9]);
        memory.bytes()[4 * MARK_BYTES..][..slot.len()].copy_from_slice(&slot);
        let mut journal = Journal::<_, Marks>::new(memory);
        assert_eq!(journal.load(), Ok(Latest { record: None, damage: Some(Damage::Version(version)) }));
        assert_eq!(journal.last_mark(), Some(Mark::Moving));
        assert_eq!(journal.write(&Marks::record(5)), Ok(0));
        assert_eq!(journal.memory().bytes()[4 * MARK_BYTES..][..slot.len()], slot);
        let mut journal = rebooted(journal);
        assert_eq!(journal.last_mark(), Some(Marks::record(5)));
        // Its sequence number is ahead, so that the newer software takes it for the newest record too.
        assert_eq!(journal.memory().bytes()[5 * MARK_BYTES..][..8], *b"RSM1\x05\0\0\0");
    }
}

/// Ten thousand runs write twenty thousand marks. The head of `mark.rs` has the numbers.
#[test]
fn marks_wear_out_neither_flash_nor_eeprom() {
    let mut journal = Journal::<Internal, Marks>::new(Internal::blank());
    let (mut erases, mut erases_in_runs) = (0, 0);
    for number in 0..20_000 {
        if number % MARKS_AHEAD as u32 == 0 {
            journal = rebooted(journal);
            journal.prepare(MARKS_AHEAD).expect("a place");
            erases = journal.memory().flash().erases;
        }
        assert_eq!(journal.write(&Marks::record(number)), Ok(0));
        erases_in_runs += journal.memory().flash().erases - erases;
    }
    println!("erases of two sectors in 10 000 runs: {erases}, of which {erases_in_runs} in a run");
    assert!((7..=10).contains(&erases) && erases_in_runs == 0);
}

// ------------------------------------------------------------------------------------------------- all in one memory

/// The three kinds of records in one memory do not change each other.
#[test]
fn each_kind_of_record_has_its_own_part_of_the_memory() {
    fn check<M: Virtual>(memory: M, layout: &Layout, per_kind: u32) {
        let memory = RefCell::new(memory);
        let bytes = |range: &Range<u32>| {
            (range.start..range.end)
                .step_by(32)
                .map(|at| {
                    let mut piece = [0; 32];
                    memory.borrow_mut().read(at, &mut piece).unwrap();
                    piece
                })
                .collect::<Vec<_>>()
        };
        let mut unit = UnitMemory::new(&memory, layout.clone());
        assert_eq!(unit.power_up(), FoundRecord { writable: true, ..FoundRecord::default() });
        for number in 0..per_kind {
            assert!(unit.save(&super::record(number)) && unit.mark(Marks::record(number)));
            assert_eq!(unit.configure(&Configurations::record(number)), Ok(()));
        }
        let newest = Configurations::record(per_kind - 1);
        let read_again = || {
            let mut unit = UnitMemory::new(&memory, layout.clone());
            (unit.power_up().record, unit.configuration(), unit.last_mark())
        };
        let found = |configuration| FoundConfiguration { configuration, ..FoundConfiguration::default() };
        let (record, mark) = (Some(super::record(per_kind - 1)), Some(Marks::record(per_kind - 1)));
        assert_eq!(read_again(), (record, found(Some(newest.clone())), mark));
        let [calibrations, configuration, marks] =
            [&layout.calibrations, &layout.configuration, &layout.marks].map(&bytes);
        assert_eq!(unit.erase(), Ok(()));
        assert_eq!(read_again(), (None, found(Some(newest)), mark));
        assert!(bytes(&layout.configuration) == configuration && bytes(&layout.marks) == marks);
        assert!(bytes(&layout.calibrations) != calibrations);
        assert!(unit.save(&super::record(1)));
        let calibrations = bytes(&layout.calibrations);
        assert_eq!(unit.erase_configuration(), Ok(()));
        assert_eq!(read_again(), (Some(super::record(1)), found(None), mark));
        assert!(bytes(&layout.calibrations) == calibrations && bytes(&layout.marks) == marks);
    }
    let sectors = |first: u32| first * 131_072..(first + 2) * 131_072;
    let flash = VirtualFlash::<32, 131_072>::blank(6);
    let layout = Layout { calibrations: sectors(4), configuration: sectors(2), marks: sectors(0) };
    check(Flash::new(flash, sectors(0).start..sectors(4).end), &layout, 100);
    check(eeprom(16_384), &Layout::EEPROM_16_KIB, 50);
}

/// The memory of a board that keeps calibrations only.
#[test]
fn a_calibration_store_alone_keeps_neither_configuration_nor_marks() {
    let mut store = CalibrationStore::new(eeprom(8192));
    assert_eq!(store.configuration(), FoundConfiguration::default());
    assert_eq!(store.configure(&Configurations::record(0)), Err(Refusal::Nothing));
    assert_eq!(store.erase_configuration(), Err(Refusal::Nothing));
    assert!(!store.mark(Mark::Moving));
    assert_eq!(store.last_mark(), None);
}

#[test]
fn a_configuration_tells_damage_another_version_and_a_fault_apart() {
    let told = |spoil: &dyn Fn(&mut Pages)| {
        let memory = RefCell::new(eeprom(16_384));
        let mut unit = UnitMemory::new(&memory, Layout::EEPROM_16_KIB);
        (0..2).for_each(|number| assert_eq!(unit.configure(&Configurations::record(number)), Ok(())));
        spoil(&mut memory.borrow_mut());
        let FoundConfiguration { configuration, damaged, other_version, fault } =
            UnitMemory::new(&memory, Layout::EEPROM_16_KIB).configuration();
        (configuration, damaged, other_version, fault)
    };
    let second = 8192 + CONFIGURATION_BYTES;
    let [older, newest] = [0, 1].map(Configurations::record);
    assert_eq!(told(&|_| ()), (Some(newest), false, None, false));
    assert_eq!(told(&|memory| memory.bytes()[second + 40] ^= 1), (Some(older), true, None, false));
    let newer = framed_as(*b"RSU", b'3', 1, &[7; 9]);
    assert_eq!(
        told(&|memory| memory.bytes()[second..second + newer.len()].copy_from_slice(&newer)),
        (None, false, Some(b'3'), false)
    );
    assert_eq!(told(&|memory| memory.bytes().truncate(8192)), (None, false, None, true));
}

// ------------------------------------------------------------------------------------------------------------ formats

#[test]
fn the_largest_configuration_fits() {
    let Assignment::SelfCalibrate(usual) = Assignment::default() else { panic!("no default configuration") };
    let leg = Leg { outer_rad: 1.0, inner_rad: 1.0, stop_s: 1.0 };
    let scheme = Scheme {
        name: "s".repeat(32).parse().unwrap(),
        legs: std::iter::repeat_n(leg, MAX_LEGS).collect(),
        periods: u8::MAX,
        ..usual.scheme.clone()
    };
    let mut run = SelfCalibrationConfig { scheme, utc_s: Some(u64::MAX), ..usual };
    run.calibrator.estimator.site = Site { measured_gravity_m_s2: Some(9.8), ..Site::default() };
    run.calibrator.estimator.period_moves = Some(u16::MAX);
    run.calibrator.estimator.gate_sigma = Some(5.0);
    run.calibrator.estimator.method = Method::Bai;
    run.calibrator.estimator.heading = HeadingSource::Configured { heading_rad: 1.0, sigma_rad: 0.1 };
    run.policy = PowerUpPolicy::WhenDue { age_s: Some(u64::MAX), temperature_k: Some(5.0) };
    run.limits.required_sigmas = Some([1.0; 28]);
    run.pace.longest_s = Some(60.0);
    let unit = UnitName { name: "n".repeat(32).parse().unwrap(), serial: "s".repeat(16).parse().unwrap() };
    let largest = UnitConfiguration { unit, run };
    let mut journal = Journal::<_, Configurations>::new(eeprom(2 * CONFIGURATION_BYTES));
    assert_eq!(journal.write(&largest), Ok(0));
    assert_eq!(journal.load(), Ok(Latest { record: Some(largest.clone()), damage: None }));
    println!(
        "the largest configuration: {} of {} bytes",
        16 + postcard::to_stdvec(&largest).unwrap().len(),
        CONFIGURATION_BYTES
    );
}

/// What is stored must stay readable: whoever changes these bytes counts up `MARK_VERSION`.
#[test]
fn the_bytes_of_a_mark_are_these() {
    let mut journal = Journal::<_, Marks>::new(eeprom(2048));
    journal.write(&Mark::Moving).unwrap();
    journal.write(&Mark::AtRest { angles_rad: [-0.5, 7.0] }).unwrap();
    let bytes = journal.memory().bytes();
    assert_eq!(bytes[..17], *b"RSM1\0\0\0\0\x01\0\0\0\0\x1a\xd8\xca\x8a");
    assert_eq!(bytes[64..64 + 13], *b"RSM1\x01\0\0\0\x11\0\0\0\x01");
    assert_eq!(bytes[77..93], *b"\0\0\0\0\0\0\xe0\xbf\0\0\0\0\0\0\x1c\x40");
    assert_eq!(bytes[64..97], framed_as(*b"RSM", b'1', 1, &bytes[76..93]));
}

/// What is stored must stay readable: whoever changes these bytes counts up `CONFIGURATION_VERSION`.
#[test]
fn the_bytes_of_a_configuration_are_these() {
    let mut journal = Journal::<_, Configurations>::new(eeprom(6144));
    let run = Configurations::record(0).run;
    let run = SelfCalibrationConfig { scheme: Scheme::bai(10.0, 1), ..run };
    let unit = UnitName { name: "mine".parse().unwrap(), serial: "42".parse().unwrap() };
    journal.write(&UnitConfiguration { unit, run }).unwrap();
    let bytes = journal.memory().bytes();
    assert_eq!(bytes[..20], *b"RSU2\0\0\0\0\xae\x03\0\0\x04mine\x0242");
    let frame = &bytes[..16 + 0x3ae];
    assert_eq!(u32::from_le_bytes(*frame.last_chunk().unwrap()), 4_102_912_359);
}
