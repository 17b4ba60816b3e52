//! What is kept to be fed: by hand, out of our own fixtures, and of what once was too much.

use std::path::{Path, PathBuf};

use crate::Target;

/// Where the corpora are, a folder for each target.
#[must_use]
pub fn directory() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

/// The files kept for a target, by their names.
///
/// # Panics
/// If there is no folder of them.
#[must_use]
pub fn files(target: &Target) -> Vec<(String, Vec<u8>)> {
    let folder = directory().join(target.name);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let read = |path: PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        (name, std::fs::read(path).unwrap())
    };
    let mut files: Vec<_> = entries.map(|entry| read(entry.unwrap().path())).collect();
    files.sort();
    files
}
