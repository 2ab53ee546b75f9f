//! Inputs in files: a folder for each target, a file for each outcome.

use crate::judge::{judge, made};
use crate::moment;
use crate::target::{Claim, Target};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

const CORPUS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/corpus");
/// Number of random inputs searched for an outcome, as a multiple of the inputs of `cargo test`.
const MOMENTS: u64 = 5;

/// Judges all files. The result has one line for each file that breaks a promise or has another outcome than its name
/// says, for each target without a file, and for each folder without a target.
pub fn judged(targets: &[Box<dyn Target>]) -> Vec<String> {
    let kept = || targets.iter().filter(|target| target.has_corpus());
    let files = kept().flat_map(|target| of_target(target.as_ref()));
    let stray =
        entries(Path::new(CORPUS)).into_iter().filter(|path| !kept().any(|target| path.ends_with(target.name())));
    files.chain(stray.map(|path| format!("{}: no target has this name", path.display()))).collect()
}

fn of_target(target: &dyn Target) -> Vec<String> {
    let folder = folder(target);
    let files = entries(&folder);
    if files.is_empty() {
        return vec![format!("{}: no files", folder.display())];
    }
    let broken = files.iter().filter_map(|file| outcome_is_name(target, file).err());
    broken.collect()
}

/// Replaces each file that no longer has the outcome of its name by the shortest of many random inputs with that
/// outcome, and adds the outcomes without a file.
pub fn renew(target: &dyn Target) {
    if !target.has_corpus() {
        return;
    }
    let folder = folder(target);
    fs::create_dir_all(&folder).expect("a folder");
    for (name, input) in shortest(target) {
        let file = folder.join(name);
        if outcome_is_name(target, &file).is_err() {
            fs::write(&file, input).expect("a file");
        }
    }
}

/// The shortest random input of every outcome.
fn shortest(target: &dyn Target) -> BTreeMap<&'static str, Vec<u8>> {
    let mut shortest = BTreeMap::<_, Vec<u8>>::new();
    let random = (0..MOMENTS * target.moment()).map(moment::bytes);
    let inputs = random.flat_map(|bytes| [made(target, &bytes), (bytes, Claim::Nothing)]);
    for (input, claim) in inputs {
        let outcome = judge(target, &input, claim).expect("no promise is broken");
        let best = shortest.entry(outcome.name).or_insert_with(|| input.clone());
        if (input.len(), &input) < (best.len(), best) {
            *best = input;
        }
    }
    shortest
}

fn outcome_is_name(target: &dyn Target, file: &Path) -> Result<(), String> {
    let input = fs::read(file).map_err(|error| format!("{}: {error}", file.display()))?;
    let outcome = judge(target, &input, Claim::Nothing).map_err(|broken| format!("{}: {broken}", file.display()))?;
    if file.ends_with(outcome.name) {
        Ok(())
    } else {
        Err(format!("{}: the outcome is {}", file.display(), outcome.name))
    }
}

fn folder(target: &dyn Target) -> PathBuf {
    Path::new(CORPUS).join(target.name())
}

/// The paths in a folder. Empty if the folder does not exist.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    entries.map(|entry| entry.expect("an entry").path()).collect()
}
