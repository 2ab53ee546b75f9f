//! The stored calibrations in an image of an instrument's memory, as a table and as JSON.

use crate::base::quantity::{self, fixed, rounded, significant};
use crate::bench::memory::{VirtualEeprom, VirtualFlash};
use crate::result::report::StoredReport;
use crate::result::table::{by_parameter, folded, of_numbers};
use anyhow::{Context, Result, anyhow};
use rins_selfcal::keep::medium::{Eeprom, Flash, Medium};
use rins_selfcal::keep::store::CalibrationStore;
use rins_selfcal::model::error_model::{PARAMETERS, block};
use rins_selfcal::run::result::StoredCalibration;
use serde::Serialize;
use std::fmt;
use std::path::Path;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Size of a sector and of a word of the STM32H743's flash, bytes.
const SECTOR: usize = 128 * 1024;
const WORD: usize = 32;

/// Kind of memory that an image was taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemoryKind {
    /// An EEPROM from address 0 on.
    Eeprom,
    /// Whole flash sectors of 128 KiB.
    Flash,
}

/// Calibrations, newest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct History {
    /// The entries.
    pub entries: Vec<StoredCalibration>,
    /// Number of damaged slots; 0 if the number is not known.
    pub damaged: usize,
    /// Number of intact records in another version of the store's format; 0 if the number is not known.
    pub other_versions: usize,
}

impl History {
    /// Reads an image. Without `kind`, an image of 256 KiB or more is a flash, and a smaller one an EEPROM.
    ///
    /// # Errors
    /// The file cannot be read, or is too small for a store; the message names it.
    pub fn read(path: &Path, kind: Option<MemoryKind>) -> Result<Self> {
        let name = || path.display().to_string();
        let bytes = std::fs::read(path).with_context(name)?;
        let usual = if bytes.len() < 2 * SECTOR { MemoryKind::Eeprom } else { MemoryKind::Flash };
        match kind.unwrap_or(usual) {
            MemoryKind::Eeprom => Self::of(Eeprom(VirtualEeprom::new(bytes))),
            MemoryKind::Flash => {
                let mut flash = VirtualFlash::<WORD, SECTOR>::blank(bytes.len() / SECTOR);
                let end = flash.bytes.len();
                flash.bytes.copy_from_slice(&bytes[..end]);
                Self::of(Flash::new(flash, 0..u32::try_from(end)?))
            }
        }
        .with_context(name)
    }

    fn of<M: Medium<Error: fmt::Debug>>(memory: M) -> Result<Self> {
        let mut store = CalibrationStore::new(memory);
        let no_store = |error| anyhow!("no calibration store: {error:?}");
        let count = store.entries().map_err(no_store)?;
        let mut history = Self::default();
        for back in 0..count {
            history.entries.extend(store.entry(back).map_err(no_store)?.map(|(_, record)| record));
        }
        (history.damaged, history.other_versions) = (store.damaged(), store.other_versions());
        Ok(history)
    }

    /// The entries as JSON.
    pub fn report(&self) -> impl Serialize + use<> {
        self.entries.iter().map(StoredReport::from).collect::<Vec<_>>()
    }
}

impl fmt::Display for History {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.entries.is_empty() {
            f.write_str("no calibrations\n")?;
        } else {
            let rows = self.entries.iter().enumerate().map(|(number, entry)| row(number + 1, entry));
            let columns = ["entry", "power-up, UTC", "deg C", "scheme", "worst of 12", "chi-square", "", "verdict"];
            writeln!(f, "{}", of_numbers(&columns, rows))?;
            f.write_str(&self.values())?;
        }
        for (number, entry) in self.entries.iter().enumerate() {
            // An accepted calibration keeps its changes, which are no reasons of a rejection.
            let kind = if entry.verdict.accepted() { "changed: " } else { "" };
            let reasons = folded(entry.reasons());
            reasons.iter().try_for_each(|reason| writeln!(f, "entry {}: {kind}{reason}", number + 1))?;
        }
        if self.other_versions > 0 {
            let records = self.other_versions;
            writeln!(f, "not shown: {records} calibrations in another version of the store's format")?;
        }
        match self.damaged {
            0 => Ok(()),
            damaged => writeln!(f, "damaged: {damaged} slots"),
        }
    }
}

impl History {
    /// Table of values and sigmas with a column for each entry.
    fn values(&self) -> String {
        let titles: Vec<_> = (1..=self.entries.len()).map(|number| format!("entry {number}")).collect();
        let columns: Vec<_> = titles.iter().map(String::as_str).collect();
        by_parameter(&columns, |index| {
            let cell = |entry: &StoredCalibration| {
                let (values, sigmas) = (quantity::values(&entry.errors), quantity::sigmas(&entry.sigmas));
                format!("{} +-{}", rounded(values[index], sigmas[index]), significant(sigmas[index]))
            };
            (index < PARAMETERS).then(|| self.entries.iter().map(cell).collect())
        })
    }
}

fn row(number: usize, entry: &StoredCalibration) -> Vec<String> {
    let sigmas = quantity::sigmas(&entry.sigmas);
    let worst = sigmas[..block::ACCEL_BIAS].iter().copied().fold(0.0, f64::max);
    vec![
        number.to_string(),
        entry.utc_s.and_then(utc).unwrap_or_else(|| "-".into()),
        if entry.temperature_c.is_finite() { fixed(entry.temperature_c.into(), 1) } else { "-".into() },
        entry.scheme.as_str().into(),
        significant(worst),
        fixed(entry.chi_square, 1),
        format!("of {}", entry.degrees_of_freedom),
        if entry.verdict.accepted() {
            "accepted".into()
        } else {
            format!("rejected, {} reasons", entry.verdict.doubts)
        },
    ]
}

fn utc(seconds: u64) -> Option<String> {
    OffsetDateTime::from_unix_timestamp(i64::try_from(seconds).ok()?).ok()?.format(&Rfc3339).ok()
}
