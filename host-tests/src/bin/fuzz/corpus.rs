//! Inputs in files: a folder to each target, a file to each outcome, which it is named after.

use crate::campaign::{Tally, judge};
use crate::target::{Claim, Target};
use std::fs;
use std::path::Path;

/// Writes the shortest input of every outcome.
///
/// # Errors
/// A file cannot be written; the message names it.
pub fn write(folder: &Path, target: &dyn Target, tally: &Tally) -> Result<(), String> {
    let folder = folder.join(target.name());
    let text = |error| format!("{}: {error}", folder.display());
    fs::create_dir_all(&folder).map_err(text)?;
    tally.shortest().try_for_each(|(name, input)| fs::write(folder.join(name), input).map_err(text))
}

/// Judges all inputs of the targets, and returns how many there were.
///
/// # Errors
/// One has another outcome than its file is named after, or breaks a promise.
pub fn replay(folder: &Path, targets: &[&dyn Target]) -> Result<usize, String> {
    let mut count = 0;
    for target in targets {
        let folder = folder.join(target.name());
        // What has no lasting form has no corpus.
        if !folder.exists() {
            continue;
        }
        let text = |error| format!("{}: {error}", folder.display());
        for file in fs::read_dir(&folder).map_err(text)? {
            let file = file.map_err(text)?;
            let input = fs::read(file.path()).map_err(text)?;
            let outcome = judge(*target, &input, Claim::Nothing)?;
            if file.file_name() != outcome.name {
                return Err(format!("{}: {}", file.path().display(), outcome.name));
            }
            count += 1;
        }
    }
    Ok(count)
}
