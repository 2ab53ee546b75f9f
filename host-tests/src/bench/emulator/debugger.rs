//! A debugger for the emulator. It stops the firmware and changes its memory, so that tests can provoke faults. The
//! image file is not changed, and a reset restores the memory.

use anyhow::{Context, Result, bail};
use object::{Object, ObjectSymbol, SymbolKind};
use std::fmt::Write as _;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::{Duration, Instant};

/// Longest time that the emulator may take to listen and to answer.
const PATIENCE: Duration = Duration::from_secs(60);

/// The line to the emulator: packets of GDB's remote serial protocol.
#[derive(Debug)]
pub struct Debugger {
    line: UnixStream,
}

impl Debugger {
    /// Waits until the emulator listens at this socket, and stops the processor.
    ///
    /// # Errors
    /// The emulator does not listen in time.
    pub fn attach(socket: &Path) -> Result<Self> {
        let start = Instant::now();
        let line = loop {
            match UnixStream::connect(socket) {
                Ok(line) => break line,
                Err(_) if start.elapsed() < PATIENCE => std::thread::sleep(Duration::from_millis(5)),
                Err(error) => return Err(error).context("the emulator does not accept a debugger"),
            }
        };
        line.set_read_timeout(Some(PATIENCE))?;
        let mut debugger = Self { line };
        // The emulator lets a debugger set registers only after the debugger has asked for their description. If the
        // processor was running, the emulator first reports that the processor has stopped.
        let mut answer = debugger.ask("qXfer:features:read:target.xml:0,ff")?;
        while !answer.starts_with(['l', 'm']) {
            answer = debugger.packet()?;
        }
        Ok(debugger)
    }

    /// Writes into the memory, code included.
    ///
    /// # Errors
    /// The emulator does not answer, or refuses.
    pub fn write(&mut self, address: u32, bytes: &[u8]) -> Result<()> {
        self.done(&format!("M{address:x},{:x}:{}", bytes.len(), hex(bytes)))
    }

    /// Reads r0 to r15 by their numbers.
    ///
    /// # Errors
    /// The emulator does not answer, or refuses.
    pub fn register(&mut self, register: u8) -> Result<u32> {
        let answer = self.ask(&format!("p{register:x}"))?;
        let value = u32::from_str_radix(&answer, 16).with_context(|| format!("register {register}: {answer:?}"))?;
        Ok(value.swap_bytes())
    }

    /// Sets r0 to r15 by their numbers.
    ///
    /// # Errors
    /// The emulator does not answer, or refuses.
    pub fn set(&mut self, register: u8, value: u32) -> Result<()> {
        self.done(&format!("P{register:x}={}", hex(&value.to_le_bytes())))
    }

    /// Lets the processor continue until it is about to run the instruction at this address.
    ///
    /// # Errors
    /// The emulator does not answer, or the processor does not come there in time.
    pub fn run_to(&mut self, address: u32) -> Result<()> {
        self.done(&format!("Z0,{address:x},2"))?;
        let stopped = self.ask("c")?;
        if !stopped.starts_with('T') {
            bail!("the emulator answers {stopped:?} in place of a stop");
        }
        self.done(&format!("z0,{address:x},2"))
    }

    /// Lets the processor continue and disconnects.
    ///
    /// # Errors
    /// The emulator does not answer.
    pub fn detach(mut self) -> Result<()> {
        self.done("D")
    }

    fn done(&mut self, packet: &str) -> Result<()> {
        match self.ask(packet)?.as_str() {
            "OK" => Ok(()),
            answer => bail!("the emulator answers {answer:?} to {packet}"),
        }
    }

    fn ask(&mut self, packet: &str) -> Result<String> {
        let sum = packet.bytes().fold(0_u8, u8::wrapping_add);
        self.line.write_all(format!("${packet}#{sum:02x}").as_bytes())?;
        self.packet()
    }

    fn packet(&mut self) -> Result<String> {
        while self.byte()? != b'$' {}
        let mut answer = String::new();
        loop {
            match self.byte()? {
                b'#' => break,
                byte => answer.push(byte.into()),
            }
        }
        // The checksum is ignored, because a socket does not damage data.
        self.byte()?;
        self.byte()?;
        self.line.write_all(b"+")?;
        Ok(answer)
    }

    fn byte(&mut self) -> Result<u8> {
        let mut byte = [0];
        self.line.read_exact(&mut byte).context("the emulator does not answer the debugger")?;
        Ok(byte[0])
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// Address of the first instruction of the one function of an ELF file whose name has all these parts.
///
/// # Errors
/// No function or more than one function has such a name.
pub fn function(elf: &[u8], parts: &[&str]) -> Result<u32> {
    let file = object::File::parse(elf)?;
    let named = |symbol: &object::Symbol<'_, '_>| {
        let name = symbol.name().map(|name| format!("{:#}", rustc_demangle::demangle(name))).unwrap_or_default();
        symbol.kind() == SymbolKind::Text && symbol.is_definition() && parts.iter().all(|part| name.contains(part))
    };
    let mut addresses: Vec<_> = file.symbols().filter(named).map(|symbol| symbol.address() as u32 & !1).collect();
    addresses.dedup();
    match addresses.as_slice() {
        [address] => Ok(*address),
        _ => bail!("{} functions are named like {parts:?}", addresses.len()),
    }
}
