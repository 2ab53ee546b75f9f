//! Bank 2 of the flash, which holds the records: RM0433, embedded flash memory.

use super::registers::Registers;
use std::collections::BTreeSet;

/// The flash's registers of bank 2.
pub const KEYR: u32 = 0x5200_2104;
pub const CR: u32 = 0x5200_210c;
pub const SR: u32 = 0x5200_2110;
pub const CCR: u32 = 0x5200_2114;

const LOCK: u32 = 1;
const PROGRAM: u32 = 1 << 1;
const SECTOR_ERASE: u32 = 1 << 2;
const START: u32 = 1 << 7;

const BUSY: u32 = 1;
const BUFFER_NOT_EMPTY: u32 = 1 << 1;
const QUEUED: u32 = 1 << 2;
const END: u32 = 1 << 16;
const SEQUENCE_ERROR: u32 = 1 << 18;
const INCONSISTENT: u32 = 1 << 21;
/// RDSERR, the flag that revision V sets without a reason.
const SECURE_READ_ERROR: u32 = 1 << 24;
const DOUBLE_ERROR: u32 = 1 << 26;
const ERRORS: u32 = 0x1fee_0000 & !END;

const WORD: usize = 32;
const SECTOR: usize = 128 * 1024;
/// Address of bank 2, and of the sectors that are kept in a file.
const BANK: u32 = 0x0810_0000;
/// First address of the sectors of records: those of the firmware's `RECORDS`.
pub const RECORDS: u32 = 0x0814_0000;
/// Length of the sectors of records.
pub const LENGTH: usize = 6 * SECTOR;

const CYCLES_PER_US: u64 = 480;
/// Time to program a word: typical, STM32H743 data sheet.
const PROGRAM_US: u64 = 100;
/// Time to erase a sector with a parallelism of 64 bits, and with less: largest, STM32H743 data sheet.
const ERASE_US: [u64; 2] = [1_000_000, 2_000_000];

/// A change of the flash, for a test that cuts the power afterwards in each of them.
#[derive(Clone, Debug, serde::Serialize)]
pub enum Change {
    /// A sector was erased; its first address.
    Erased(u32),
    /// A word was programmed: address and bytes.
    Programmed(u32, Vec<u8>),
}

enum Task {
    Erase(usize),
    Program,
}

/// Bank 2.
pub struct Flash {
    /// Content of the sectors of records.
    pub bytes: Vec<u8>,
    /// Addresses of words that the error correction cannot correct.
    pub broken: BTreeSet<u32>,
    /// All changes since power-on.
    pub changes: Vec<Change>,
    busy_until: u64,
    task: Option<Task>,
    word: Vec<(u32, u8)>,
    keyed: bool,
    /// Sets RDSERR at the end of each erase.
    pub rdserr: bool,
    pub cut_word: Option<u64>,
    pub cut_erase: Option<u64>,
    words: u64,
    erases: u64,
    /// The power fails now.
    pub cut: bool,
}

impl Flash {
    /// A flash with this content. Missing bytes are blank.
    pub fn new(mut bytes: Vec<u8>) -> Self {
        bytes.resize(LENGTH, 0xff);
        Self {
            bytes,
            broken: BTreeSet::new(),
            changes: Vec::new(),
            busy_until: 0,
            task: None,
            word: Vec::new(),
            keyed: false,
            rdserr: false,
            cut_word: None,
            cut_erase: None,
            words: 0,
            erases: 0,
            cut: false,
        }
    }

    /// A reset ends an operation at once.
    pub fn reset(&mut self) {
        (self.task, self.keyed, self.busy_until) = (None, false, 0);
        self.word.clear();
    }

    fn place(address: u32) -> Option<usize> {
        address.checked_sub(RECORDS).map(|place| place as usize).filter(|place| *place < LENGTH)
    }

    /// Time until which the flash is busy.
    pub fn busy_until(&self) -> u64 {
        self.busy_until
    }

    /// Ends an operation whose time has come.
    pub fn settle(&mut self, registers: &mut Registers, now: u64) {
        if now < self.busy_until {
            return;
        }
        match self.task.take() {
            Some(Task::Erase(sector)) => {
                if let Some(place) = Self::place(BANK + (sector * SECTOR) as u32) {
                    self.bytes[place..place + SECTOR].fill(0xff);
                    let address = RECORDS + place as u32;
                    self.broken.retain(|word| !(address..address + SECTOR as u32).contains(word));
                    self.changes.push(Change::Erased(address));
                }
                registers.set_bits(SR, END | if self.rdserr { SECURE_READ_ERROR } else { 0 }, true);
            }
            Some(Task::Program) => registers.set_bits(SR, END, true),
            None => {}
        }
    }

    pub fn status(&self, stored: u32, now: u64) -> u32 {
        let busy = if now < self.busy_until { BUSY | QUEUED } else { 0 };
        stored | busy | if self.word.is_empty() { 0 } else { BUFFER_NOT_EMPTY }
    }

    pub fn write_register(&mut self, registers: &mut Registers, address: u32, value: u32, now: u64) {
        match address {
            KEYR => {
                if value == 0xcdef_89ab && self.keyed {
                    registers.set_bits(CR, LOCK, false);
                }
                self.keyed = value == 0x4567_0123;
            }
            CR => self.control(registers, value, now),
            CCR => registers.set_bits(SR, value & 0x1fef_0000, false),
            // Writes to the status have no effect: its flags are cleared by CCR.
            _ => {}
        }
    }

    fn control(&mut self, registers: &mut Registers, value: u32, now: u64) {
        if registers.get(CR) & LOCK != 0 {
            return registers.violate("the flash's control register was written while locked".into());
        }
        if now < self.busy_until {
            registers.violate("the flash's control register was written while the flash was busy".into());
        }
        registers.set(CR, value & !START);
        if value & (START | SECTOR_ERASE) == START | SECTOR_ERASE {
            if registers.get(SR) & ERRORS & !SECURE_READ_ERROR != 0 {
                registers.violate("an erase was started with an error flag set".into());
            }
            let sector = (value >> 8 & 7) as usize;
            if self.cut_erase == Some(self.erases) {
                self.tear_sector(sector);
                self.cut = true;
                return;
            }
            self.erases += 1;
            self.task = Some(Task::Erase(sector));
            self.busy_until = now + CYCLES_PER_US * ERASE_US[usize::from(value >> 4 & 3 != 3)];
        }
    }

    /// An erase that was cut off: each word is old, blank, or cannot be read.
    fn tear_sector(&mut self, sector: usize) {
        let Some(start) = Self::place(BANK + (sector * SECTOR) as u32) else { return };
        for (number, place) in (start..start + SECTOR).step_by(WORD).enumerate() {
            match number % 3 {
                0 => {}
                1 => self.bytes[place..place + WORD].fill(0xff),
                _ => drop(self.broken.insert(RECORDS + place as u32)),
            }
        }
    }

    /// The processor writes into the flash. A word of 32 bytes is programmed as a whole.
    pub fn write(&mut self, registers: &mut Registers, address: u32, bytes: &[u8], now: u64) {
        let control = registers.get(CR);
        if control & LOCK != 0 || control & PROGRAM == 0 {
            registers.violate("the flash was written without unlocking it for programming".into());
            return registers.set_bits(SR, SEQUENCE_ERROR, true);
        }
        if now < self.busy_until {
            registers.violate("the flash was written while busy".into());
        }
        self.word.extend((address..).zip(bytes).map(|(address, byte)| (address, *byte)));
        let base = self.word[0].0 & !(WORD as u32 - 1);
        if self.word.iter().any(|(address, _)| address & !(WORD as u32 - 1) != base) {
            registers.violate("a word of the flash was not written as a whole".into());
            registers.set_bits(SR, INCONSISTENT, true);
            self.word.clear();
        }
        if self.word.len() == WORD {
            self.program(registers, base, now);
        }
    }

    fn program(&mut self, registers: &mut Registers, base: u32, now: u64) {
        let word = std::mem::take(&mut self.word);
        let Some(start) = Self::place(base) else {
            return registers.violate(format!("the flash was programmed at {base:#x}, outside of the records"));
        };
        if self.bytes[start..start + WORD].iter().any(|byte| *byte != 0xff) || self.broken.contains(&base) {
            registers.violate(format!("the flash word at {base:#x} was programmed without an erase"));
            self.broken.insert(base);
        }
        if self.cut_word == Some(self.words) {
            self.broken.insert(base);
            self.cut = true;
            return;
        }
        self.words += 1;
        for (address, byte) in word {
            self.bytes[(address - RECORDS) as usize] &= byte;
        }
        self.changes.push(Change::Programmed(base, self.bytes[start..start + WORD].to_vec()));
        self.task = Some(Task::Program);
        self.busy_until = now + CYCLES_PER_US * PROGRAM_US;
    }

    /// The processor reads from the flash; `None` if the error correction fails.
    pub fn read(&mut self, registers: &mut Registers, address: u32, length: usize) -> (u64, bool) {
        let good = !self.broken.contains(&(address & !(WORD as u32 - 1)));
        if !good {
            registers.set_bits(SR, DOUBLE_ERROR, true);
        }
        let byte = |at: u32| Self::place(at).map_or(0xff, |place| self.bytes[place]);
        ((0..length).fold(0, |value, number| value | u64::from(byte(address + number as u32)) << (8 * number)), good)
    }
}
