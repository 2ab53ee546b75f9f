//! Decisions of the board with an STM32H743 that need no registers, only their values.
//!
//! Source: STMicroelectronics, reference manual RM0433; errata sheet ES0392.

/// Whether a chip may run at 480 MHz, by the value of DBGMCU_IDCODE. Revision V may. Revisions Z, Y and X are limited to
/// 400 MHz (data sheet DS12110), so their times would be wrong.
pub const fn allows_480_mhz(idcode: u32) -> bool {
    idcode >> 16 == 0x2003
}

/// Why the flash has not programmed or erased.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FlashError {
    /// The sector is protected against writes.
    Protected,
    /// The registers were used in the wrong order, or a word was not written as a whole.
    Sequence,
    /// The operation has failed.
    Operation,
    /// The flash is still busy after the longest time of the operation.
    Busy,
}

/// Bits of FLASH_SR: RM0433, section of the flash's registers.
mod status {
    pub const BUSY: u32 = 1 << 0;
    pub const BUFFER_NOT_EMPTY: u32 = 1 << 1;
    pub const QUEUED: u32 = 1 << 2;
    pub const PROTECTED: u32 = 1 << 17;
    pub const SEQUENCE: u32 = 1 << 18;
    pub const STROBE: u32 = 1 << 19;
    pub const INCONSISTENT: u32 = 1 << 21;
    pub const OPERATION: u32 = 1 << 22;
}

/// Whether an operation of the flash still goes on.
pub const fn flash_is_busy(status: u32) -> bool {
    status & (status::BUSY | status::QUEUED) != 0
}

/// How an operation of the flash has ended, by the value of FLASH_SR.
///
/// The flags of reads say nothing about it: RDPERR and RDSERR, which revision V sets for bank 2 without a reason while it
/// is erased (github.com/zephyrproject-rtos/zephyr/issues/60449), and those of the error correction. Whoever has written
/// reads the words again.
///
/// # Errors
/// The operation has failed.
pub const fn flash_outcome(status: u32) -> Result<(), FlashError> {
    if status & status::PROTECTED != 0 {
        Err(FlashError::Protected)
    } else if status & (status::SEQUENCE | status::STROBE | status::INCONSISTENT | status::BUFFER_NOT_EMPTY) != 0 {
        Err(FlashError::Sequence)
    } else if status & status::OPERATION != 0 {
        Err(FlashError::Operation)
    } else {
        Ok(())
    }
}

/// A region of the memory protection unit (ARMv7-M) that closes a range of addresses: nothing reads or writes there, and
/// nothing is read ahead from there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ClosedRegion {
    base: u32,
    /// Binary logarithm of the size.
    log_size: u32,
    /// Eighths of the region that are left out, a bit for each.
    left_out: u32,
}

impl ClosedRegion {
    /// The system memory of the flash, 0x1FF0_0000 to 0x1FF1_FFFF, which gives read errors if it is read ahead.
    pub const SYSTEM_MEMORY: Self = Self { base: 0x1ff0_0000, log_size: 17, left_out: 0 };
    /// The external memories and devices, 0x6000_0000 to 0xDFFF_FFFF, which the board does not have. The Cortex-M7 may read
    /// ahead from there, and waits for ever if nothing answers.
    pub const EXTERNAL: Self = Self { base: 0, log_size: 32, left_out: 0b1000_0111 };
    /// Bank 2 of the flash.
    pub const BANK_2: Self = Self { base: 0x0810_0000, log_size: 20, left_out: 0 };

    /// Value of the register RBAR for the region of this number.
    pub const fn base(self, number: u32) -> u32 {
        const VALID: u32 = 1 << 4;
        self.base | VALID | number
    }

    /// Value of the register RASR: strongly ordered, no access, nothing executed.
    pub const fn attributes(self) -> u32 {
        const EXECUTE_NEVER: u32 = 1 << 28;
        const ENABLE: u32 = 1;
        EXECUTE_NEVER | self.left_out << 8 | (self.log_size - 1) << 1 | ENABLE
    }
}

/// The better one of two ways to sample, by the number of good frames that each has given. The first one is kept if both
/// are as good.
pub const fn cleaner(good: [u32; 2]) -> usize {
    if good[1] > good[0] { 1 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_revision_v_runs_at_480_mhz() {
        assert!(allows_480_mhz(0x2003_6450));
        // Z, Y and X.
        assert!([0x1001_6450, 0x1003_6450, 0x2001_6450].into_iter().all(|idcode| !allows_480_mhz(idcode)));
    }

    #[test]
    fn errors_of_reads_are_no_failure_of_an_erase() {
        let (rdperr, rdserr, sneccerr, dbeccerr, eop) = (1 << 23, 1 << 24, 1 << 25, 1 << 26, 1 << 16);
        for status in [0, eop, rdserr, rdperr | eop, sneccerr, dbeccerr, rdperr | rdserr | sneccerr | dbeccerr] {
            assert_eq!(flash_outcome(status), Ok(()), "{status:#x}");
        }
        for (bit, error) in [
            (1, FlashError::Sequence),
            (17, FlashError::Protected),
            (18, FlashError::Sequence),
            (19, FlashError::Sequence),
            (21, FlashError::Sequence),
            (22, FlashError::Operation),
        ] {
            assert_eq!(flash_outcome(1 << bit | rdserr | eop), Err(error), "bit {bit}");
        }
    }

    #[test]
    fn a_queued_operation_goes_on() {
        assert!([1, 4, 5].into_iter().all(flash_is_busy));
        assert!(!flash_is_busy(2 | 1 << 16 | 1 << 24));
    }

    /// The addresses that a region closes, read from its registers as the processor reads them.
    fn closed(region: ClosedRegion, address: u32) -> bool {
        let attributes = region.attributes();
        let size = 1_u64 << ((attributes >> 1 & 0x1f) + 1);
        let base = u64::from(region.base(5) & !0x1f);
        assert_eq!((base % size, region.base(5) & 0x1f, attributes >> 24 & 0x17, attributes & 1), (0, 0x15, 0x10, 1));
        let eighth = u64::from(address).wrapping_sub(base) / (size / 8);
        eighth < 8 && attributes >> (8 + eighth) & 1 == 0
    }

    #[test]
    fn regions_close_what_they_say() {
        let (low, high) = (0x6000_0000, 0xdfff_ffff);
        assert!(closed(ClosedRegion::EXTERNAL, low) && closed(ClosedRegion::EXTERNAL, high));
        assert!(!closed(ClosedRegion::EXTERNAL, low - 1) && !closed(ClosedRegion::EXTERNAL, high + 1));
        assert!(!closed(ClosedRegion::EXTERNAL, 0x2400_0000));
        for (region, first, last) in
            [(ClosedRegion::SYSTEM_MEMORY, 0x1ff0_0000, 0x1ff1_ffff), (ClosedRegion::BANK_2, 0x0810_0000, 0x081f_ffff)]
        {
            assert!(closed(region, first) && closed(region, last));
            assert!(!closed(region, first - 1) && !closed(region, last + 1));
        }
    }

    #[test]
    fn the_cleaner_sampling_is_kept() {
        assert_eq!([[32, 32], [32, 31], [0, 0], [3, 32]].map(cleaner), [0, 0, 0, 1]);
    }
}
