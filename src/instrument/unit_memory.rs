//! All that a unit keeps without power, in one memory.

use super::surroundings::{Archive, FoundConfiguration, FoundRecord};
use crate::keep::configuration::Configurations;
use crate::keep::journal::Journal;
use crate::keep::mark::{MARKS_AHEAD, Mark, Marks};
use crate::keep::medium::Medium;
use crate::keep::partition::{Layout, Partition};
use crate::keep::store::{CalibrationStore, Piece, Wanted};
use crate::link::Refusal;
use crate::run::result::StoredCalibration;
use crate::run::unit::UnitConfiguration;
use core::cell::RefCell;

/// Number of configurations that are prepared at power-up: the next one, and the slot after it, in which the remains of
/// an erase that was cut would be taken for damage.
const CONFIGURATIONS_AHEAD: usize = 2;

/// Calibrations, the configuration of the unit and marks of motion. Each of the three has slots and sectors of its own.
///
/// ```
/// # use embedded_storage::{ReadStorage, Storage};
/// use core::cell::RefCell;
/// use rins_selfcal::instrument::{Archive, UnitMemory};
/// use rins_selfcal::keep::mark::Mark;
/// use rins_selfcal::keep::medium::Eeprom;
/// use rins_selfcal::keep::partition::Layout;
///
/// # struct Memory(Vec<u8>);
/// # impl ReadStorage for Memory {
/// #     type Error = std::convert::Infallible;
/// #     fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
/// #         bytes.copy_from_slice(&self.0[at as usize..][..bytes.len()]);
/// #         Ok(())
/// #     }
/// #     fn capacity(&self) -> usize { self.0.len() }
/// # }
/// # impl Storage for Memory {
/// #     fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), Self::Error> {
/// #         self.0[at as usize..][..bytes.len()].copy_from_slice(bytes);
/// #         Ok(())
/// #     }
/// # }
/// // `Memory` is the driver of an EEPROM.
/// let eeprom = RefCell::new(Eeprom(Memory(vec![0xff; 16 * 1024])));
/// let mut memory = UnitMemory::new(&eeprom, Layout::EEPROM_16_KIB);
/// assert!(memory.power_up().writable);
/// assert_eq!((memory.configuration().configuration, memory.last_mark()), (None, None));
/// assert!(memory.mark(Mark::Moving));
/// assert_eq!(memory.last_mark(), Some(Mark::Moving));
/// ```
#[derive(Debug)]
pub struct UnitMemory<M> {
    /// The calibrations.
    pub calibrations: CalibrationStore<M>,
    /// The configuration of the unit.
    pub configuration: Journal<M, Configurations>,
    /// The marks of motion.
    pub marks: Journal<M, Marks>,
}

impl<'m, M: Medium> UnitMemory<Partition<'m, M>> {
    /// The records in `memory`. The memory is not accessed yet.
    pub fn new(memory: &'m RefCell<M>, layout: Layout) -> Self {
        Self {
            calibrations: CalibrationStore::new(Partition::new(memory, layout.calibrations)),
            configuration: Journal::new(Partition::new(memory, layout.configuration)),
            marks: Journal::new(Partition::new(memory, layout.marks)),
        }
    }
}

impl<M: Medium> Archive for UnitMemory<M> {
    fn power_up(&mut self) -> FoundRecord {
        // Later reads and writes report what does not work here.
        let _ = self.configuration.prepare(CONFIGURATIONS_AHEAD);
        let _ = self.marks.prepare(MARKS_AHEAD);
        self.calibrations.power_up()
    }

    fn save(&mut self, record: &StoredCalibration) -> bool {
        Archive::save(&mut self.calibrations, record)
    }

    fn read_piece(&mut self, wanted: Wanted) -> Result<Piece, Refusal> {
        Archive::read_piece(&mut self.calibrations, wanted)
    }

    fn erase(&mut self) -> Result<(), Refusal> {
        Archive::erase(&mut self.calibrations)
    }

    fn configuration(&mut self) -> FoundConfiguration {
        let Ok(latest) = self.configuration.load() else {
            return FoundConfiguration { fault: true, ..FoundConfiguration::default() };
        };
        let other_version = latest.damage.and_then(|damage| damage.other_version());
        FoundConfiguration {
            configuration: latest.record,
            damaged: latest.damage.is_some() && other_version.is_none(),
            other_version,
            fault: false,
        }
    }

    fn configure(&mut self, configuration: &UnitConfiguration) -> Result<(), Refusal> {
        self.configuration.write(configuration).map(|_| ()).map_err(|_| Refusal::Memory)
    }

    fn erase_configuration(&mut self) -> Result<(), Refusal> {
        self.configuration.erase().map_err(|_| Refusal::Memory)
    }

    fn mark(&mut self, mark: Mark) -> bool {
        self.marks.write(&mark).is_ok()
    }

    fn last_mark(&mut self) -> Option<Mark> {
        self.marks.last_mark()
    }
}
