//! Files that are there whole or not at all.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use fabmap::model::Model;
use waypost_vision::features::{Extractor, FeatureSettings};

use crate::error::EvalError;

/// Reads an image, a model or anything else whole.
///
/// # Errors
/// [`EvalError::Read`].
pub fn read(path: &Path) -> Result<Vec<u8>, EvalError> {
    fs::read(path).map_err(|reason| EvalError::Read { path: path.to_owned(), reason })
}

/// Reads a model file and makes the extractor that its words come from.
///
/// # Errors
/// [`EvalError::Read`], [`EvalError::Model`] or [`EvalError::UnknownExtractor`].
pub fn read_model(path: &Path) -> Result<(Model, Extractor), EvalError> {
    let model = Model::from_bytes(&read(path)?)
        .map_err(|reason| EvalError::Model { path: path.to_owned(), reason })?;
    let settings: FeatureSettings = model
        .extractor()
        .parse()
        .map_err(|reason| EvalError::UnknownExtractor { path: path.to_owned(), reason })?;
    Ok((model, Extractor::new(settings)))
}

/// Makes a folder for results, with those above it; one that exists is used as it is.
///
/// # Errors
/// [`EvalError::Write`].
pub fn create_folder(path: &Path) -> Result<(), EvalError> {
    fs::create_dir_all(path).map_err(|reason| EvalError::Write { path: path.to_owned(), reason })
}

/// Writes a file whole or not at all: beside its place first, then moved there.
///
/// # Errors
/// [`EvalError::Write`]; what was there before is still there then.
pub fn write(path: &Path, content: &[u8]) -> Result<(), EvalError> {
    write_beside_and_move(path, content).map_err(|reason| EvalError::Write { path: path.to_owned(), reason })
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
#[cfg(unix)]
fn new_file_in(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    use std::os::unix::fs::PermissionsExt;
    tempfile::Builder::new().permissions(fs::Permissions::from_mode(0o666)).tempfile_in(folder)
}

#[cfg(not(unix))]
fn new_file_in(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    tempfile::NamedTempFile::new_in(folder)
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
        assert!(matches!(write(&path, b""), Err(EvalError::Write { path: named, .. }) if named == path));
    }

    #[test]
    fn what_is_no_model_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model");
        write(&path, b"not a model").unwrap();
        assert!(matches!(read_model(&path), Err(EvalError::Model { .. })));
        assert!(matches!(read_model(folder.path()), Err(EvalError::Read { .. })));
    }
}
