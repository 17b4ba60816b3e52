//! Files that a command writes.

use std::path::{Path, PathBuf};

use crate::failure::Failure;

/// Whether a file that exists may be replaced.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Replacing {
    Allowed,
    Refused,
}

impl Replacing {
    pub(crate) fn of(force: bool) -> Self {
        if force { Self::Allowed } else { Self::Refused }
    }

    /// # Errors
    /// [`Failure`] if the file exists and may not be replaced.
    pub(crate) fn check(self, path: &Path) -> Result<(), Failure> {
        if self == Self::Refused && path.exists() {
            return Err(Failure::Unfit(format!(
                "{} is there already; choose another file, or replace it with --force",
                path.display()
            )));
        }
        Ok(())
    }

    /// Writes a file that appears under its name only when it is complete.
    ///
    /// # Errors
    /// [`Failure`] if it may not be replaced, or cannot be written.
    pub(crate) fn write(self, path: &Path, content: &[u8]) -> Result<(), Failure> {
        self.check(path)?;
        let mut partial = path.as_os_str().to_owned();
        partial.push(".partial");
        let partial = PathBuf::from(partial);
        std::fs::write(&partial, content).map_err(Failure::file("write", &partial))?;
        std::fs::rename(&partial, path).map_err(Failure::file("write", path))
    }
}
