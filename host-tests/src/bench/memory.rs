//! Virtual EEPROM and NOR flash. They enforce the rules of the hardware. They can lose power at any byte, word or
//! erase, and can have cells that do not change and words that cannot be read.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use embedded_storage::{ReadStorage, Storage};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rins_selfcal::instrument::{Archive, UnitMemory};
use rins_selfcal::keep::mark::Mark;
use rins_selfcal::keep::medium::Eeprom;
use rins_selfcal::keep::partition::Layout;
use std::cell::RefCell;
use std::ops::Range;

/// State of the bytes that were being written or erased when the power was cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Torn {
    /// The old content.
    Untouched,
    /// The new content.
    Done,
    /// The first half is new: of the bytes, or of the bits of a single byte.
    Half,
    /// The last half is new.
    LastHalf,
    /// Random bits.
    Random,
    /// In an EEPROM the whole page that is programmed at once is random. In a flash the words cannot be read, because
    /// their error correction fails.
    Lost,
    /// Each piece of a kilobyte of a flash is by itself old, new or unreadable, at random. A single byte has random
    /// bits.
    Patchy,
}

impl Torn {
    /// All states.
    pub const ALL: [Self; 7] =
        [Self::Untouched, Self::Done, Self::Half, Self::LastHalf, Self::Random, Self::Lost, Self::Patchy];
}

/// Fault of a virtual memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemoryFault {
    /// The power is off.
    PowerOff,
    /// A word cannot be read.
    Unreadable,
    /// An access outside the memory or not aligned.
    Misuse(NorFlashErrorKind),
}

impl NorFlashError for MemoryFault {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::PowerOff | Self::Unreadable => NorFlashErrorKind::Other,
            Self::Misuse(kind) => *kind,
        }
    }
}

/// Power supply that can be cut in a step. A step writes a byte or word, or erases a sector.
#[derive(Clone, Debug)]
pub struct Power {
    steps: usize,
    cut: Option<(usize, Torn)>,
    off: bool,
    random: Xoshiro256PlusPlus,
}

impl Power {
    /// Power that is on.
    fn new() -> Self {
        Self { steps: 0, cut: None, off: false, random: Xoshiro256PlusPlus::seed_from_u64(1) }
    }

    /// Steps since power-up.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Powers up, and cuts the power in the step after this number of steps.
    pub fn cut_after(&mut self, steps: usize, torn: Torn) {
        self.on();
        self.cut = Some((steps, torn));
        self.random = Xoshiro256PlusPlus::seed_from_u64(steps as u64);
    }

    /// As [`Self::cut_after`], with other random numbers for each `seed`.
    pub fn cut_at_random(&mut self, steps: usize, torn: Torn, seed: u64) {
        self.cut_after(steps, torn);
        self.random = Xoshiro256PlusPlus::seed_from_u64(seed);
    }

    /// Powers up without a later cut.
    pub fn on(&mut self) {
        (self.steps, self.cut, self.off) = (0, None, false);
    }

    fn check(&self) -> Result<(), MemoryFault> {
        if self.off { Err(MemoryFault::PowerOff) } else { Ok(()) }
    }

    /// Counts a step. Returns the state in which the step is left if the power is cut in it.
    fn step(&mut self) -> Result<Option<Torn>, MemoryFault> {
        self.check()?;
        let torn = self.cut.filter(|(at, _)| *at == self.steps).map(|(_, torn)| torn);
        self.steps += 1;
        self.off = torn.is_some();
        Ok(torn)
    }
}

/// Addresses and values of the bytes that do not change.
pub type Stuck = Vec<(usize, u8)>;

/// An EEPROM with pages of 32 bytes that is written byte by byte. The power can be cut at a byte.
#[derive(Clone, Debug)]
pub struct VirtualEeprom {
    /// Its content.
    pub bytes: Vec<u8>,
    /// Its power.
    pub power: Power,
    /// Bytes that do not change.
    pub stuck: Stuck,
}

/// The content of the EEPROM of an emulated board that has nothing in store, and whose axes stand at (0, 0).
///
/// # Panics
/// The memory does not work.
pub fn eeprom_at_rest() -> Vec<u8> {
    let memory = RefCell::new(Eeprom(VirtualEeprom::blank(16 * 1024)));
    let marked = UnitMemory::new(&memory, Layout::EEPROM_16_KIB).mark(Mark::AtRest { angles_rad: [0.0; 2] });
    assert!(marked, "a virtual memory works");
    memory.into_inner().0.bytes
}

impl VirtualEeprom {
    /// Size of a page, bytes.
    pub const PAGE_BYTES: usize = 32;

    /// An EEPROM with this content.
    pub fn new(bytes: Vec<u8>) -> Self {
        Self { bytes, power: Power::new(), stuck: Vec::new() }
    }

    /// A blank memory, as delivered.
    pub fn blank(length: usize) -> Self {
        Self::new(vec![0xff; length])
    }

    fn tear(&mut self, address: usize, byte: u8, torn: Torn) {
        match torn {
            Torn::Untouched => {}
            Torn::Done => self.bytes[address] = byte,
            Torn::Half => self.bytes[address] = self.bytes[address] & 0x0f | byte & 0xf0,
            Torn::LastHalf => self.bytes[address] = self.bytes[address] & 0xf0 | byte & 0x0f,
            Torn::Random | Torn::Patchy => self.power.random.fill_bytes(&mut self.bytes[address..=address]),
            Torn::Lost => {
                let page = address - address % Self::PAGE_BYTES;
                self.power.random.fill_bytes(&mut self.bytes[page..page + Self::PAGE_BYTES]);
            }
        }
    }
}

fn keep_stuck(bytes: &mut [u8], stuck: &Stuck) {
    stuck.iter().for_each(|(address, value)| bytes[*address] = *value);
}

impl ReadStorage for VirtualEeprom {
    type Error = MemoryFault;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), MemoryFault> {
        self.power.check()?;
        keep_stuck(&mut self.bytes, &self.stuck);
        let range = offset as usize..offset as usize + bytes.len();
        let found = self.bytes.get(range).ok_or(MemoryFault::Misuse(NorFlashErrorKind::OutOfBounds))?;
        bytes.copy_from_slice(found);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl Storage for VirtualEeprom {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), MemoryFault> {
        let start = offset as usize;
        assert!(start + bytes.len() <= self.bytes.len(), "written beyond the end");
        for (address, byte) in (start..).zip(bytes) {
            if let Some(torn) = self.power.step()? {
                self.tear(address, *byte, torn);
                return Err(MemoryFault::PowerOff);
            }
            self.bytes[address] = *byte;
        }
        Ok(())
    }
}

/// Length of the pieces of [`Torn::Patchy`], bytes.
const PATCH_BYTES: usize = 1024;

/// A NOR flash with words of `WORD` bytes in sectors of `SECTOR` bytes. A word may be written once after each erase of
/// its sector. Code that breaks this rule panics and so fails the test.
#[derive(Clone, Debug)]
pub struct VirtualFlash<const WORD: usize, const SECTOR: usize> {
    /// Its content.
    pub bytes: Vec<u8>,
    /// Its power.
    pub power: Power,
    /// Bytes that do not change.
    pub stuck: Stuck,
    /// Number of erases.
    pub erases: usize,
    written: Vec<bool>,
    unreadable: Vec<bool>,
}

impl<const WORD: usize, const SECTOR: usize> VirtualFlash<WORD, SECTOR> {
    /// A blank memory, as delivered.
    pub fn blank(sectors: usize) -> Self {
        let (length, words) = (sectors * SECTOR, sectors * SECTOR / WORD);
        Self {
            bytes: vec![0xff; length],
            power: Power::new(),
            stuck: Vec::new(),
            erases: 0,
            written: vec![false; words],
            unreadable: vec![false; words],
        }
    }

    /// A memory with this content; what is missing of it is blank. The words at some addresses cannot be read.
    pub fn with_content(sectors: usize, bytes: &[u8], unreadable: impl IntoIterator<Item = usize>) -> Self {
        let mut flash = Self::blank(sectors);
        flash.bytes[..bytes.len()].copy_from_slice(bytes);
        flash.renew_written(0..bytes.len() / WORD * WORD);
        unreadable.into_iter().for_each(|address| flash.set_readable(address, false));
        flash
    }

    /// Addresses of the words that cannot be read.
    pub fn unreadable(&self) -> impl Iterator<Item = usize> {
        let all = self.unreadable.iter().enumerate();
        all.filter_map(|(word, unreadable)| unreadable.then_some(word * WORD))
    }

    /// Makes the word at an address unreadable, or readable again.
    pub fn set_readable(&mut self, address: usize, readable: bool) {
        self.unreadable[address / WORD] = !readable;
    }

    fn words(bytes: &Range<usize>) -> Range<usize> {
        bytes.start / WORD..bytes.end / WORD
    }

    /// Leaves a range in a state between the old and the new content.
    fn tear(&mut self, range: Range<usize>, wanted: &[u8], torn: Torn) {
        let (half, whole) = (wanted.len() / 2, wanted.len());
        match torn {
            Torn::Untouched => return,
            Torn::Done => self.put(&range, wanted, 0..whole),
            Torn::Half => self.put(&range, wanted, 0..half),
            Torn::LastHalf => self.put(&range, wanted, half..whole),
            Torn::Random => self.power.random.fill_bytes(&mut self.bytes[range.clone()]),
            Torn::Lost => {
                self.put(&range, wanted, 0..half);
                self.unreadable[Self::words(&range)].fill(true);
                return;
            }
            Torn::Patchy => {
                for start in (0..whole).step_by(PATCH_BYTES) {
                    self.tear_patch(&range, wanted, start..whole.min(start + PATCH_BYTES));
                }
                return;
            }
        }
        self.unreadable[Self::words(&range)].fill(false);
    }

    /// Leaves a part of a range old, new or unreadable, at random.
    fn tear_patch(&mut self, range: &Range<usize>, wanted: &[u8], part: Range<usize>) {
        let words = Self::words(&(range.start + part.start..range.start + part.end));
        match self.power.random.next_u32() % 3 {
            0 => {}
            1 => {
                self.put(range, wanted, part);
                self.unreadable[words].fill(false);
            }
            _ => self.unreadable[words].fill(true),
        }
    }

    /// Gives a part of a range its new content.
    fn put(&mut self, range: &Range<usize>, wanted: &[u8], part: Range<usize>) {
        self.bytes[range.clone()][part.clone()].copy_from_slice(&wanted[part]);
    }

    /// Words that read as blank can be written.
    fn renew_written(&mut self, range: Range<usize>) {
        let words = self.written[Self::words(&range)].iter_mut();
        for (written, word) in words.zip(self.bytes[range].chunks(WORD)) {
            *written = word.iter().any(|byte| *byte != 0xff);
        }
    }
}

impl<const WORD: usize, const SECTOR: usize> ErrorType for VirtualFlash<WORD, SECTOR> {
    type Error = MemoryFault;
}

impl<const WORD: usize, const SECTOR: usize> ReadNorFlash for VirtualFlash<WORD, SECTOR> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), MemoryFault> {
        self.power.check()?;
        check_read(self, offset, bytes.len()).map_err(MemoryFault::Misuse)?;
        keep_stuck(&mut self.bytes, &self.stuck);
        let range = offset as usize..offset as usize + bytes.len();
        let words = range.start / WORD..range.end.div_ceil(WORD);
        if self.unreadable[words].contains(&true) {
            return Err(MemoryFault::Unreadable);
        }
        bytes.copy_from_slice(&self.bytes[range]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const WORD: usize, const SECTOR: usize> NorFlash for VirtualFlash<WORD, SECTOR> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), MemoryFault> {
        check_erase(self, from, to).expect("whole sectors");
        for start in (from as usize..to as usize).step_by(SECTOR) {
            let range = start..start + SECTOR;
            if let Some(torn) = self.power.step()? {
                self.tear(range.clone(), &[0xff; SECTOR], torn);
                self.renew_written(range);
                return Err(MemoryFault::PowerOff);
            }
            self.erases += 1;
            let words = Self::words(&range);
            self.bytes[range].fill(0xff);
            self.written[words.clone()].fill(false);
            self.unreadable[words].fill(false);
            keep_stuck(&mut self.bytes, &self.stuck);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), MemoryFault> {
        check_write(self, offset, bytes.len()).expect("whole words");
        for (start, word) in (offset as usize..).step_by(WORD).zip(bytes.chunks(WORD)) {
            let range = start..start + WORD;
            let blank = self.bytes[range.clone()].iter().all(|byte| *byte == 0xff);
            assert!(blank && !self.written[start / WORD], "the word at {start:#x} is written without an erase");
            if let Some(torn) = self.power.step()? {
                self.tear(range.clone(), word, torn);
                self.renew_written(range);
                return Err(MemoryFault::PowerOff);
            }
            self.bytes[range].copy_from_slice(word);
            self.written[start / WORD] = true;
            keep_stuck(&mut self.bytes, &self.stuck);
        }
        Ok(())
    }
}
