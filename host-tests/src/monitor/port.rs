//! Connections to an instrument: a serial device or pseudo-terminal, a Unix socket, a TCP port.

use anyhow::{Context, Result};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

/// Longest time that a read waits for bytes.
const WAIT: Duration = Duration::from_millis(20);

/// A connection in both directions.
pub trait Port: Read + Write {}

impl<P: Read + Write> Port for P {}

/// Opens a device, a Unix socket or `tcp:HOST:PORT`. A read without data fails with a time-out after 20 ms.
///
/// # Errors
/// The connection cannot be opened. The message names it.
pub fn open(name: &str, baud: u32) -> Result<Box<dyn Port>> {
    let failed = || format!("cannot open {name}");
    if let Some(address) = name.strip_prefix("tcp:") {
        let stream = TcpStream::connect(address).with_context(failed)?;
        stream.set_read_timeout(Some(WAIT)).with_context(failed)?;
        return Ok(Box::new(stream));
    }
    if Path::new(name).metadata().with_context(failed)?.file_type().is_socket() {
        let stream = UnixStream::connect(name).with_context(failed)?;
        stream.set_read_timeout(Some(WAIT)).with_context(failed)?;
        return Ok(Box::new(stream));
    }
    // The defaults of the library are 8 data bits, no parity, one stop bit, no flow control.
    let device = serialport::new(name, baud).timeout(WAIT).open_native().with_context(failed)?;
    Ok(Box::new(device))
}
