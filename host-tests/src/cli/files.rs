//! Checks the files of a command before the command runs: no file overwrites another one, and every output can be
//! written.

use anyhow::{Context, bail};
use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

/// Name of an option or argument, and its file if it was given.
pub type NamedFile<'a> = (&'static str, Option<&'a Path>);

/// Checks that no output is an input or another output, and that every output can be written. Changes no file.
///
/// # Errors
/// One line that names the options and the file.
pub fn check(inputs: &[NamedFile<'_>], outputs: &[NamedFile<'_>]) -> anyhow::Result<()> {
    let given = |files: &[NamedFile<'_>]| -> Vec<(&'static str, PathBuf)> {
        let paths = files.iter().filter_map(|(name, path)| Some((*name, path.as_ref()?.to_path_buf())));
        paths.collect()
    };
    let (inputs, outputs) = (given(inputs), given(outputs));
    for (number, (name, path)) in outputs.iter().enumerate() {
        let same = |(_, other): &&(&'static str, PathBuf)| identity(other) == identity(path);
        if let Some((other, _)) = inputs.iter().find(same) {
            bail!("{name} would overwrite {other}: {}", path.display());
        }
        if let Some((other, _)) = outputs[..number].iter().find(same) {
            bail!("{other} and {name} are the same file: {}", path.display());
        }
        try_to_write(path).with_context(|| path.display().to_string())?;
    }
    Ok(())
}

/// Path of the file with all links resolved. If the file does not exist yet, the links of its folder are resolved.
fn identity(path: &Path) -> PathBuf {
    let of_folder = || {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some(folder.canonicalize().ok()?.join(path.file_name()?))
    };
    path.canonicalize().ok().or_else(of_folder).unwrap_or_else(|| path.into())
}

fn try_to_write(path: &Path) -> io::Result<()> {
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
        Ok(found) if found.is_file() => OpenOptions::new().append(true).open(path).map(drop),
        // Opening a device or a pipe may already have an effect.
        Ok(_) => Ok(()),
        Err(_) => {
            File::create(path)?;
            fs::remove_file(path)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colliding_and_unwritable_files_are_refused_and_no_file_changes() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("log.csv"), "kept").unwrap();
        fs::create_dir(at("folder")).unwrap();
        std::os::unix::fs::symlink(at("log.csv"), at("link.csv")).unwrap();
        let (log, new, link) = (at("log.csv"), at("new.json"), at("link.csv"));
        let same_new = at("folder").join("..").join("new.json");
        let message = |inputs: &[NamedFile<'_>], outputs: &[NamedFile<'_>]| {
            let line = check(inputs, outputs).map_or_else(|error| format!("{error:#}"), |()| "fine".into());
            line.replace(&format!("{}/", folder.path().display()), "")
        };
        assert_eq!(message(&[("LOG.csv", Some(&log))], &[("--json", Some(&new)), ("--report", None)]), "fine");
        assert_eq!(
            message(&[("LOG.csv", Some(&log))], &[("--json", Some(&link))]),
            "--json would overwrite LOG.csv: link.csv"
        );
        let twice = message(&[], &[("--out", Some(&new)), ("--truth", Some(&same_new))]);
        assert_eq!(twice, "--out and --truth are the same file: folder/../new.json");
        assert!(message(&[], &[("--json", Some(&at("nowhere/out")))]).starts_with("nowhere/out: No such file"));
        assert_eq!(message(&[], &[("--json", Some(&at("folder")))]), "folder: is a directory");
        assert_eq!(message(&[], &[("--json", Some(Path::new("/dev/null")))]), "fine");
        assert!(!new.exists());
        assert_eq!(fs::read_to_string(log).unwrap(), "kept");
    }
}
