//! The slots of the calibration store in the last sectors of the flash's second bank, a sector each: a slot is erased as a
//! whole, and the other one is not touched. The program runs on from the first bank meanwhile.

use embassy_stm32::flash::{Blocking, Error, Flash, WRITE_SIZE};
use embedded_storage::{ReadStorage, Storage};
use rins_selfcal::store::{SLOT_BYTES, SLOTS};

/// A sector, bytes.
const SECTOR_BYTES: u32 = 128 * 1024;
/// Where the slots begin, from the beginning of the flash.
const BEGIN: u32 = 2 * 1024 * 1024 - SLOTS as u32 * SECTOR_BYTES;

/// The memory of the store.
pub struct FlashSlots(pub Flash<'static, Blocking>);

/// Sector and place in it, from the beginning of the flash.
fn place(offset: u32) -> [u32; 2] {
    let sector = BEGIN + offset / SLOT_BYTES as u32 * SECTOR_BYTES;
    [sector, sector + offset % SLOT_BYTES as u32]
}

impl ReadStorage for FlashSlots {
    type Error = Error;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        self.0.blocking_read(place(offset)[1], bytes)
    }

    fn capacity(&self) -> usize {
        SLOTS * SLOT_BYTES
    }
}

impl Storage for FlashSlots {
    /// The store writes a slot at once, from its beginning.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        let [sector, mut at] = place(offset);
        if at != sector || bytes.len() > SLOT_BYTES {
            return Err(Error::Unaligned);
        }
        self.0.blocking_erase(sector, sector + SECTOR_BYTES)?;
        for part in bytes.chunks(WRITE_SIZE) {
            let mut word = [0xff; WRITE_SIZE];
            word.get_mut(..part.len()).ok_or(Error::Size)?.copy_from_slice(part);
            self.0.blocking_write(at, &word)?;
            at += WRITE_SIZE as u32;
        }
        Ok(())
    }
}
