//! Access to files of the host, and the end of the program, by semihosting.
#![allow(unsafe_code)]

use core::ffi::CStr;
use cortex_m_semihosting::{debug, nr, syscall};

/// A file of the host.
#[derive(Clone, Copy)]
pub struct File(usize);

impl File {
    /// Mode of [`Self::open`]: read, binary.
    pub const READ: usize = 1;
    /// Mode of [`Self::open`]: write, binary.
    pub const WRITE: usize = 5;

    /// Opens a file or a pipe; `None` if the host refuses.
    pub fn open(name: &CStr, mode: usize) -> Option<Self> {
        // Safety: address, mode and length of a string that outlives the call.
        let handle = unsafe { syscall(nr::OPEN, &[name.as_ptr() as usize, mode, name.count_bytes()]) };
        (handle != usize::MAX).then_some(Self(handle))
    }

    /// Writes bytes. Returns whether all bytes were written.
    pub fn write(self, bytes: &[u8]) -> bool {
        // Safety: address and length of bytes that outlive the call; it returns the number left over.
        unsafe { syscall(nr::WRITE, &[self.0, bytes.as_ptr() as usize, bytes.len()]) == 0 }
    }

    /// Reads bytes. Returns their number, which is 0 at the end of the file.
    pub fn read(self, bytes: &mut [u8]) -> usize {
        // Safety: address and length of bytes that outlive the call; it returns the number left over.
        let left = unsafe { syscall(nr::READ, &[self.0, bytes.as_mut_ptr() as usize, bytes.len()]) };
        bytes.len().saturating_sub(left)
    }

    /// Reads until `bytes` is full. Returns whether it was filled.
    pub fn read_exact(self, mut bytes: &mut [u8]) -> bool {
        while !bytes.is_empty() {
            let count = self.read(bytes);
            match bytes.get_mut(count..) {
                Some(rest) if count > 0 => bytes = rest,
                _ => return false,
            }
        }
        true
    }
}

/// Ends the program. After a failure the emulator's exit status is 1.
pub fn exit(status: Result<(), ()>) -> ! {
    loop {
        debug::exit(status);
    }
}
