//! Sizes of the firmware's images, and the data file that they are compared with.

use anyhow::{Context, Result};
use object::{Object, ObjectSegment, ObjectSymbol};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Start address of the RAM, see `regions.x` of the boards.
const RAM: u64 = 0x2000_0000;

/// Memory of an image, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sizes {
    /// Flash for code, constants and initial values of variables.
    pub flash: u64,
    /// RAM for variables.
    pub static_ram: u64,
    /// RAM left for the stack.
    pub stack_room: u64,
    /// Largest use of the stack in a calibration. `None` if no emulator supports the board.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stack_used: Option<u64>,
}

/// Sizes by the name of the image.
pub type SizesByImage = BTreeMap<String, Sizes>;

/// Tolerance of each size, up and down, as a fraction. Compilers differ in inlining and in the use of the stack, and
/// hardly in the layout of variables. A smaller size must be written to the data file too, because otherwise the size
/// could grow again unnoticed.
const TOLERANCES: [(&str, f64); 4] =
    [("flash", 0.05), ("static RAM", 0.01), ("room for the stack", 0.0), ("stack used", 0.05)];

impl Sizes {
    /// Sizes of the loaded sections. Initialized variables take both flash and RAM.
    pub fn of(file: &object::File<'_>) -> Self {
        let in_ram = |segment: &object::Segment<'_, '_>| segment.address() >= RAM;
        let symbol =
            |name| file.symbols().find(|symbol| symbol.name() == Ok(name)).map_or(0, |symbol| symbol.address());
        Self {
            flash: file.segments().map(|segment| segment.file_range().1).sum(),
            static_ram: file.segments().filter(in_ram).map(|segment| segment.size()).sum(),
            stack_room: symbol("_stack_start").saturating_sub(symbol("_stack_end")),
            stack_used: None,
        }
    }

    const fn figures(&self) -> [Option<u64>; 4] {
        [Some(self.flash), Some(self.static_ram), Some(self.stack_room), self.stack_used]
    }

    /// A line for each size that differs from the earlier size by more than the tolerance.
    fn differences(&self, name: &str, before: &Self) -> Vec<String> {
        let pairs = before.figures().into_iter().zip(self.figures()).zip(TOLERANCES);
        let differing = pairs.filter(|((before, now), (_, tolerance))| match (before, now) {
            (Some(before), Some(now)) => before.abs_diff(*now) as f64 > *before as f64 * tolerance,
            (before, now) => before != now,
        });
        let figure = |size: Option<u64>| size.map_or_else(|| "-".into(), |size| size.to_string());
        differing
            .map(|((before, now), (what, tolerance))| {
                let (before, now, percent) = (figure(before), figure(now), tolerance * 100.0);
                format!("{name}: {what}: {now} bytes, {before} in the data file: differs by more than {percent} %")
            })
            .collect()
    }
}

/// The data file.
pub fn data_file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/firmware-sizes.toml")
}

/// Reads the data file.
///
/// # Errors
/// The file cannot be read or is not a data file.
pub fn read(path: &Path) -> Result<SizesByImage> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    toml::from_str(&text).with_context(|| path.display().to_string())
}

/// Writes the data file.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, sizes: &SizesByImage) -> Result<()> {
    let head =
        "# What the firmware's images take, bytes. Written and compared by `firmware-report`, see CONTRIBUTING.md.\n\n";
    std::fs::write(path, head.to_owned() + &toml::to_string(sizes)?).with_context(|| path.display().to_string())
}

/// A line for each difference between the data file and the images. An image that only one of them has is a difference.
pub fn differences(before: &SizesByImage, now: &SizesByImage) -> Vec<String> {
    let gone = before.keys().filter(|name| !now.contains_key(*name)).map(|name| format!("{name}: no such image"));
    let compared = now.iter().flat_map(|(name, sizes)| match before.get(name) {
        Some(before) => sizes.differences(name, before),
        None => vec![format!("{name}: not in the data file")],
    });
    compared.chain(gone).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZES: Sizes = Sizes { flash: 200_000, static_ram: 60_000, stack_room: 126_976, stack_used: Some(28_000) };

    fn one(name: &str, sizes: Sizes) -> SizesByImage {
        SizesByImage::from([(name.to_owned(), sizes)])
    }

    #[test]
    fn the_data_file_is_read_as_it_was_written() {
        let path = tempfile::NamedTempFile::new().expect("a file").into_temp_path();
        let sizes = SizesByImage::from([
            ("here,kvh1750".to_owned(), SIZES),
            ("there".to_owned(), Sizes { stack_used: None, ..SIZES }),
        ]);
        write(&path, &sizes).expect("it is written");
        assert_eq!(read(&path).expect("it is read"), sizes);
    }

    #[test]
    fn a_size_beyond_its_tolerance_is_named_whether_it_grew_or_shrank() {
        let within = Sizes { flash: 209_999, static_ram: 59_401, stack_used: Some(26_601), ..SIZES };
        assert_eq!(differences(&one("board", SIZES), &one("board", within)), [""; 0]);
        let beyond = Sizes { flash: 210_001, static_ram: 59_399, stack_room: 126_972, stack_used: Some(29_401) };
        let lines = differences(&one("board", SIZES), &one("board", beyond));
        let named = ["flash", "static RAM", "room for the stack", "stack used"];
        assert_eq!(lines.len(), named.len(), "{lines:?}");
        assert!(lines.iter().zip(named).all(|(line, what)| line.starts_with(&format!("board: {what}: "))), "{lines:?}");
    }

    #[test]
    fn an_image_or_a_figure_that_only_one_has_is_a_difference() {
        let unused = Sizes { stack_used: None, ..SIZES };
        assert_eq!(differences(&one("board", SIZES), &one("board", unused)).len(), 1);
        assert_eq!(
            differences(&one("old", SIZES), &one("new", SIZES)),
            ["new: not in the data file", "old: no such image"]
        );
    }

    #[test]
    fn every_board_is_in_the_data_file() {
        let sizes = read(&data_file()).expect("the data file");
        let names: Vec<_> = sizes.keys().map(String::as_str).collect();
        assert_eq!(names, ["mps2-an386", "mps2-an500", "mps2-an500,kvh1750", "stm32h743", "stm32h743,kvh1750"]);
    }
}
