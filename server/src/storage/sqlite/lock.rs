//! A data directory is one server's, and no other user's.

use std::fs::{DirBuilder, File, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt, chown};
use std::path::Path;

use crate::storage::StorageError;

const LOCK_NAME: &str = "waypost.lock";

/// What others on the machine may do to what is made here: nothing.
const OF_THE_OWNER: u32 = 0o700;
const FILE_OF_THE_OWNER: u32 = 0o600;

/// Held while a server, or who stands in for one, works on a data directory.
#[derive(Debug)]
pub(super) struct DirectoryLock {
    /// The directory itself: a file in it can be deleted, and made again, while it is locked. Not every file system locks
    /// directories.
    directory: Option<File>,
    file: File,
}

impl DirectoryLock {
    /// Makes the directory if it is missing.
    pub(super) fn take(directory: &Path) -> Result<Self, StorageError> {
        let failed = |source| StorageError::of_directory(directory, source);
        let locked = |error| match error {
            TryLockError::WouldBlock => StorageError::Locked { directory: directory.to_owned() },
            TryLockError::Error(source) => failed(source),
        };
        make_directory(directory).map_err(failed)?;
        let itself = File::open(directory).map_err(failed)?;
        let itself = match itself.try_lock() {
            Ok(()) => Some(itself),
            Err(TryLockError::WouldBlock) => return Err(locked(TryLockError::WouldBlock)),
            Err(TryLockError::Error(_not_possible_here)) => None,
        };
        let path = directory.join(LOCK_NAME);
        let options =
            OpenOptions::new().write(true).create(true).truncate(false).mode(FILE_OF_THE_OWNER).open(path);
        let file = options.map_err(failed)?;
        give_to_owner_of_directory(&directory.join(LOCK_NAME)).map_err(failed)?;
        file.try_lock().map_err(locked)?;
        Ok(Self { directory: itself, file })
    }

    /// Before all that shares this is dropped: a connection that is still being closed may hold a copy for a moment more.
    pub(super) fn release(&self) {
        for held in self.directory.iter().chain([&self.file]) {
            if let Err(error) = held.unlock() {
                tracing::warn!(%error, "the data directory stays locked until this program ends");
            }
        }
    }
}

impl Drop for DirectoryLock {
    /// To close the files would not do: a program that this one is just starting has them open for a moment, too.
    fn drop(&mut self) {
        self.release();
    }
}

/// Makes a directory for its owner alone, and those above it that are missing. Their names are on the disk then: what is
/// stored in a directory is lost with its name.
pub(in crate::storage) fn make_directory(directory: &Path) -> io::Result<()> {
    if directory.is_dir() {
        return Ok(());
    }
    let above = match directory.parent() {
        Some(above) if above.as_os_str().is_empty() => Path::new("."),
        Some(above) => above,
        None => return DirBuilder::new().create(directory),
    };
    make_directory(above)?;
    match DirBuilder::new().mode(OF_THE_OWNER).create(directory) {
        // By somebody else, just now.
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists && directory.is_dir() => {}
        made => made?,
    }
    match File::open(above) {
        Ok(above) => above.sync_all(),
        // One that may be written to and not read cannot be synced.
        Err(_) => Ok(()),
    }
}

/// What the superuser makes in another user's directory is that user's: a service is to open it, which is not the superuser's.
fn give_to_owner_of_directory(path: &Path) -> io::Result<()> {
    let Some(directory) = path.parent() else { return Ok(()) };
    let (file, directory) = (path.metadata()?, directory.metadata()?);
    if file.uid() != 0 || directory.uid() == 0 {
        return Ok(());
    }
    chown(path, Some(directory.uid()), Some(directory.gid()))
}

/// Sees to it that a file, if it is made now, is for its owner alone; SQLite makes its other files like this one.
pub(super) fn make_private(path: &Path) {
    let opened =
        OpenOptions::new().write(true).create(true).truncate(false).mode(FILE_OF_THE_OWNER).open(path);
    // Opening the database says what is wrong with it.
    let Ok(metadata) = opened.and_then(|file| file.metadata()) else { return };
    if let Err(error) = give_to_owner_of_directory(path) {
        tracing::warn!(%error, file = %path.display(), "the file stays that of the superuser");
    }
    if metadata.permissions().mode() & !FILE_OF_THE_OWNER & 0o777 != 0 {
        tracing::warn!(
            file = %path.display(),
            "other users of this machine may read the database; `chmod 600` it, and `chmod 700` its directory"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As the data directory of a service, in which its administrator makes the first token or restores a backup.
    #[test]
    fn what_the_superuser_makes_in_anothers_directory_is_that_ones() {
        let directory = tempfile::tempdir().unwrap();
        let user = 7600;
        if chown(directory.path(), Some(user), Some(user)).is_err() {
            eprintln!("skipped: only the superuser gives directories to others");
            return;
        }
        let file = directory.path().join("waypost.sqlite");
        make_private(&file);
        let lock = DirectoryLock::take(directory.path()).unwrap();
        for made in [file, directory.path().join(LOCK_NAME)] {
            assert_eq!(made.metadata().unwrap().uid(), user, "{}", made.display());
        }
        drop(lock);
    }
}
