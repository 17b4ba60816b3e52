//! Files that are there whole or not at all.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use fabmap::model::Model;
use serde::Serialize;
use waypost_vision::features::{Extractor, FeatureSettings};

/// For `map_err` where a file or folder cannot be read.
pub(crate) fn not_read(path: &Path) -> impl FnOnce(io::Error) -> anyhow::Error {
    move |reason| anyhow!("{} cannot be read ({reason}); check the path and its permissions", path.display())
}

/// For `map_err` where a file or folder cannot be written.
pub(crate) fn not_written(path: &Path) -> impl FnOnce(io::Error) -> anyhow::Error {
    move |reason| {
        let path = path.display();
        anyhow!("{path} cannot be written ({reason}); check that the folder may be written to and has room")
    }
}

/// Reads an image, a model or anything else whole.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(not_read(path))
}

/// Reads a model file and makes the extractor that its words come from.
pub(crate) fn read_model(path: &Path) -> Result<(Model, Extractor)> {
    let model = Model::from_bytes(&read(path)?).with_context(|| path.display().to_string())?;
    let settings: FeatureSettings = model.extractor().parse().map_err(|reason| {
        anyhow!(
            "{}: the model's words are made with an extractor that this program does not know ({reason}); use the \
             version of Waypost that trained it, or train it anew with `waypost-eval train`",
            path.display()
        )
    })?;
    Ok((model, Extractor::new(settings)))
}

/// Makes a folder for results, with those above it; one that exists is used as it is.
pub(crate) fn create_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(not_written(path))
}

/// Writes a file whole or not at all: beside its place first, then moved there. If it fails, what was there before is
/// still there.
pub(crate) fn write(path: &Path, content: &[u8]) -> Result<()> {
    write_beside_and_move(path, content).map_err(not_written(path))
}

/// Writes a report as JSON that people can read.
pub(crate) fn write_json(path: &Path, report: &impl Serialize) -> Result<()> {
    write(path, &serde_json::to_vec_pretty(report)?)
}

fn write_beside_and_move(path: &Path, content: &[u8]) -> io::Result<()> {
    let folder = match path.parent() {
        Some(parent) if parent.as_os_str().is_empty() => PathBuf::from("."),
        Some(parent) => parent.to_owned(),
        None => return Err(io::Error::new(io::ErrorKind::InvalidInput, "not the name of a file")),
    };
    let mut file = new_file_in(&folder)?;
    file.write_all(content)?;
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}

/// Readable as any new file is, not by its owner alone as temporary files are.
fn new_file_in(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    use std::os::unix::fs::PermissionsExt;
    tempfile::Builder::new().permissions(fs::Permissions::from_mode(0o666)).tempfile_in(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writing_replaces_the_file_and_leaves_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model");
        write(&path, b"one").unwrap();
        write(&path, b"two").unwrap();
        assert_eq!(read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_file_that_cannot_be_written_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("no such folder/model");
        let refusal = write(&path, b"").unwrap_err().to_string();
        assert!(refusal.starts_with(&format!("{} cannot be written", path.display())), "{refusal}");
    }

    #[test]
    fn what_is_no_model_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model");
        write(&path, b"not a model").unwrap();
        assert!(format!("{:#}", read_model(&path).unwrap_err()).contains("not a Waypost model"));
        assert!(read_model(folder.path()).unwrap_err().to_string().contains("cannot be read"));
    }
}
