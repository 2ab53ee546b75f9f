//! Files of the host and the program's end, by semihosting.
#![allow(unsafe_code)]

use core::ffi::CStr;
use cortex_m_semihosting::{debug, nr, syscall};

/// A file of the host.
#[derive(Clone, Copy)]
pub struct File(usize);

impl File {
    /// Mode of [`Self::open`].
    pub const READ: usize = 1;
    /// Mode of [`Self::open`].
    pub const WRITE: usize = 5;

    /// Opens a file or a pipe.
    pub fn open(name: &CStr, mode: usize) -> Option<Self> {
        // Safety: address, mode and length of a string that outlives the call.
        let handle = unsafe { syscall(nr::OPEN, &[name.as_ptr() as usize, mode, name.count_bytes()]) };
        (handle != usize::MAX).then_some(Self(handle))
    }

    /// Whether all bytes were written.
    pub fn write(self, bytes: &[u8]) -> bool {
        // Safety: address and length of bytes that outlive the call; it returns the number left over.
        unsafe { syscall(nr::WRITE, &[self.0, bytes.as_ptr() as usize, bytes.len()]) == 0 }
    }

    /// Number of bytes read; none at the end of the file.
    pub fn read(self, bytes: &mut [u8]) -> usize {
        // Safety: address and length of bytes that outlive the call; it returns the number left over.
        let left = unsafe { syscall(nr::READ, &[self.0, bytes.as_mut_ptr() as usize, bytes.len()]) };
        bytes.len().saturating_sub(left)
    }

    /// Whether all of `bytes` was filled.
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

/// Ends the program. A failure makes the emulator's exit status 1.
pub fn exit(status: Result<(), ()>) -> ! {
    loop {
        debug::exit(status);
    }
}
