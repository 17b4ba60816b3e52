//! Data directories that many tests begin with.

use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tokio::sync::OnceCell;

use super::postgres;

/// A data directory that the first test that asks for it makes: each gets a copy of its own.
///
/// On PostgreSQL maps are not in the directory, and each test makes its own.
pub(crate) struct Template(OnceCell<Vec<File>>);

/// Where it lies below the directory, and its bytes.
type File = (PathBuf, Vec<u8>);

impl Template {
    pub(crate) const fn new() -> Self {
        Self(OnceCell::const_new())
    }

    /// A directory as `make` leaves it, which is to stop its server.
    pub(crate) async fn directory(&self, make: impl AsyncFnOnce(&Path)) -> TempDir {
        if postgres::is_asked_for() {
            let directory = tempfile::tempdir().unwrap();
            make(directory.path()).await;
            return directory;
        }
        self.in_sqlite(make).await
    }

    /// The same for a server that keeps its maps in the directory, whatever the others do.
    pub(crate) async fn in_sqlite(&self, make: impl AsyncFnOnce(&Path)) -> TempDir {
        let directory = tempfile::tempdir().unwrap();
        let made = async || {
            let directory = tempfile::tempdir().unwrap();
            make(directory.path()).await;
            let mut files = Vec::new();
            read(directory.path(), Path::new(""), &mut files);
            files
        };
        for (path, bytes) in self.0.get_or_init(made).await {
            let path = directory.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
        directory
    }
}

/// All files of a folder below `root`.
fn read(root: &Path, folder: &Path, files: &mut Vec<File>) {
    for entry in std::fs::read_dir(root.join(folder)).unwrap() {
        let entry = entry.unwrap();
        let path = folder.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            read(root, &path, files);
        } else {
            let bytes = std::fs::read(entry.path()).unwrap();
            files.push((path, bytes));
        }
    }
}
