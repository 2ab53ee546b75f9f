//! The ELF file of the firmware.

use anyhow::{Context, Result, bail};
use object::read::elf::{FileHeader, ProgramHeader};
use object::{Endianness, Object, ObjectSymbol, SymbolKind, elf};
use std::path::Path;

/// A part of the image: where it is in the flash, and its bytes.
pub struct Piece {
    /// Address in the flash.
    pub address: u32,
    /// Content.
    pub bytes: Vec<u8>,
}

/// The image.
pub struct Image {
    /// Everything that is programmed into the flash.
    pub pieces: Vec<Piece>,
    /// Names and addresses of functions and variables.
    symbols: Vec<(String, u32)>,
}

impl Image {
    /// Reads an ELF file.
    pub fn read(path: &Path) -> Result<Self> {
        let data = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let header = elf::FileHeader32::<Endianness>::parse(&*data)?;
        let endian = header.endian()?;
        let mut pieces = Vec::new();
        for part in header.program_headers(endian, &*data)? {
            let bytes = part.data(endian, &*data).ok().context("a part of the image is missing")?.to_vec();
            if part.p_type(endian) == elf::PT_LOAD && !bytes.is_empty() {
                pieces.push(Piece { address: part.p_paddr(endian), bytes });
            }
        }
        let file = object::File::parse(&*data)?;
        let named = |symbol: object::Symbol<'_, '_>| {
            let wanted = !symbol.is_undefined() && !matches!(symbol.kind(), SymbolKind::File | SymbolKind::Section);
            wanted.then(|| Some((symbol.name().ok()?.to_owned(), symbol.address() as u32)))?
        };
        Ok(Self { pieces, symbols: file.symbols().filter_map(named).collect() })
    }

    /// The address of a function or variable whose name contains `part`, without the bit of Thumb code.
    pub fn symbol(&self, part: &str) -> Result<u32> {
        let exact = self.symbols.iter().find(|(name, _)| name == part);
        let mut like = self.symbols.iter().filter(|(name, _)| name.contains(part)).map(|(_, at)| at & !1);
        if let Some((_, address)) = exact {
            return Ok(address & !1);
        }
        match (like.next(), like.next()) {
            (Some(address), None) => Ok(address),
            (Some(address), Some(other)) if address == other => Ok(address),
            (None, _) => bail!("the image has no {part}"),
            _ => bail!("the image has several {part}"),
        }
    }

    /// Addresses of all half-words of the code with this value.
    pub fn halfwords(&self, value: u16) -> impl Iterator<Item = u32> {
        self.pieces.iter().filter(|piece| piece.address < 0x0820_0000).flat_map(move |piece| {
            let (words, _) = piece.bytes.as_chunks::<2>();
            let found = words.iter().enumerate().filter(move |(_, word)| u16::from_le_bytes(**word) == value);
            found.map(|(place, _)| piece.address + 2 * place as u32)
        })
    }
}
