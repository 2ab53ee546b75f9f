//! The files of a command, looked at before it runs: none is lost to another one, and all that are asked for can be
//! written.

use anyhow::{Context, bail};
use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

/// An option, or the name of an argument, and its file where there is one.
pub type NamedFile<'a> = (&'static str, Option<&'a Path>);

/// Checks that no output is an input or another output, and that all outputs can be written. Leaves no trace.
///
/// # Errors
/// One line that names options and file.
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

/// The file's path without links; of a file that is not there yet, its folder's.
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
        // A device or a pipe: looking at it may already be too much.
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
    fn files_that_collide_or_cannot_be_written_are_refused_without_a_trace() {
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
