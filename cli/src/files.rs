//! Files that a command writes, and what it removes.

use std::ffi::OsStr;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};

use crate::failure::Failure;

/// Whether a file that exists may be replaced.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Replacing {
    Allowed,
    Refused,
}

/// Refuses a name under which nobody finds what is drawn.
pub(crate) fn check_drawn(file: Option<&Path>) -> Result<(), Failure> {
    let extension = file.and_then(Path::extension).and_then(OsStr::to_str).unwrap_or("svg");
    if extension.eq_ignore_ascii_case("svg") {
        return Ok(());
    }
    Err(Failure::Unfit(format!(
        "the picture is SVG, and .{extension} is not; give a name that ends with .svg"
    )))
}

/// Whether people are asked before something is lost for good.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Asking {
    OnATerminal,
    Never,
}

impl Asking {
    pub(crate) fn unless(yes: bool) -> Self {
        if yes { Self::Never } else { Self::OnATerminal }
    }

    /// Asks before something is lost for good. Where nobody can answer, that is a no.
    ///
    /// # Errors
    /// [`Failure`] if somebody says no, or nobody anything.
    pub(crate) fn confirm_loss(self, question: &str) -> Result<(), Failure> {
        self.confirm(question, || format!("{question}\nnothing was done; give --yes if that is meant"))
    }

    /// Asks about something that seems wrong. Where nobody can answer, that is a no.
    ///
    /// # Errors
    /// [`Failure`] if somebody says no, or nobody anything.
    pub(crate) fn confirm_doubt(self, doubt: &str) -> Result<(), Failure> {
        let unanswered = || format!("{doubt}\nnothing was sent; mend that, or give --yes if it is right");
        self.confirm(&format!("{doubt}\nstream it as it is?"), unanswered)
    }

    /// Says what seems wrong with what is being sent, and asks where somebody can answer. Elsewhere it goes on: it is a
    /// finding, and no proof.
    ///
    /// # Errors
    /// [`Failure`] if somebody says no.
    pub(crate) fn confirm_going_on(self, doubt: &str) -> Result<(), Failure> {
        if is_answered() {
            return self.confirm(&format!("{doubt}\ngo on?"), String::new);
        }
        // If stderr is closed, the doubt is lost.
        let _ = writeln!(io::stderr(), "{doubt}");
        Ok(())
    }

    fn confirm(self, question: &str, unanswered: impl FnOnce() -> String) -> Result<(), Failure> {
        match self {
            Self::Never => Ok(()),
            Self::OnATerminal if !is_answered() => Err(Failure::Unfit(unanswered())),
            Self::OnATerminal => {
                // If stderr is closed, nobody sees the question, and silence is no yes.
                let _ = write!(io::stderr(), "{question} [y/N] ");
                let mut answer = String::new();
                let read = io::stdin().read_line(&mut answer);
                read.map_err(Failure::file("read", Path::new("the answer")))?;
                agreed(&answer)
            }
        }
    }
}

/// Whether somebody is there to answer.
fn is_answered() -> bool {
    io::stdin().is_terminal() && io::stderr().is_terminal()
}

fn agreed(answer: &str) -> Result<(), Failure> {
    match answer.trim().to_lowercase().as_str() {
        "y" | "yes" => Ok(()),
        _ => Err(Failure::Unfit("nothing was done; answer y, or give --yes".to_owned())),
    }
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

    /// The same for a file that a command may write at its end. Before a server is asked for anything, so that a command
    /// that is refused has done nothing.
    ///
    /// # Errors
    /// [`Failure`] if it may not or cannot be written, or there is no folder for it.
    pub(crate) fn check_wanted(self, path: Option<&Path>) -> Result<(), Failure> {
        let Some(path) = path else { return Ok(()) };
        self.check(path)?;
        if path.is_dir() {
            return Err(Failure::Unfit(format!("{} is a folder; name a file", path.display())));
        }
        if let Some(folder) =
            path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir())
        {
            return Err(Failure::Unfit(format!(
                "there is no folder {} for {}; create it, or choose another",
                folder.display(),
                path.display()
            )));
        }
        try_to_write(path)
    }

    /// Writes a file that appears under its name only when it is complete.
    ///
    /// # Errors
    /// [`Failure`] if it may not be replaced, or cannot be written.
    pub(crate) fn write(self, path: &Path, content: &[u8]) -> Result<(), Failure> {
        self.check(path)?;
        let partial = partial(path);
        std::fs::write(&partial, content).map_err(Failure::file("write", &partial))?;
        std::fs::rename(&partial, path).map_err(Failure::file("write", path))
    }
}

/// What a file is called while it is not complete.
fn partial(path: &Path) -> PathBuf {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    PathBuf::from(partial)
}

/// Whether a file could be written, by what it will be written as first.
fn try_to_write(path: &Path) -> Result<(), Failure> {
    let partial = partial(path);
    let was_there = partial.exists();
    std::fs::OpenOptions::new().append(true).create(true).open(&partial).map_err(|error| {
        Failure::Unfit(format!("{} cannot be written: {error}; choose another file", path.display()))
    })?;
    if !was_there {
        std::fs::remove_file(&partial).map_err(Failure::file("remove", &partial))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_written_is_refused_before_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let name = "n".repeat(300);
        for (path, says) in [
            (folder.path().join(&name), "cannot be written: "),
            (PathBuf::from("/proc/x.svg"), "cannot be written: "),
        ] {
            let Err(refused) = Replacing::Allowed.check_wanted(Some(&path)) else {
                panic!("{path:?} was taken")
            };
            assert!(refused.to_string().contains(says), "{refused}");
        }
        assert!(Replacing::Allowed.check_wanted(Some(&folder.path().join("a.svg"))).is_ok());
        assert_eq!(folder.path().read_dir().unwrap().count(), 0);
    }

    #[test]
    fn what_is_drawn_has_the_name_of_what_it_is() {
        for taken in [None, Some("closure.svg"), Some("closure.SVG"), Some("closure")] {
            assert!(check_drawn(taken.map(Path::new)).is_ok(), "{taken:?}");
        }
        let refused = check_drawn(Some(Path::new("closure.png"))).unwrap_err().to_string();
        assert!(refused.contains("ends with .svg"), "{refused}");
    }

    #[test]
    fn silence_is_no_yes() {
        for (answer, yes) in
            [("y\n", true), ("YES\n", true), ("", false), ("\n", false), ("n\n", false), ("yell", false)]
        {
            assert_eq!(agreed(answer).is_ok(), yes, "{answer:?}");
        }
    }

    #[test]
    fn what_cannot_be_written_is_found_before_anything_is_done() {
        let folder = tempfile::tempdir().unwrap();
        let there = folder.path().join("there.svg");
        std::fs::write(&there, b"x").unwrap();
        let said = |replacing: Replacing, path: &Path| {
            replacing.check_wanted(Some(path)).map_err(|refused| refused.to_string())
        };
        assert!(said(Replacing::Refused, &there).unwrap_err().contains("--force"));
        assert_eq!(said(Replacing::Allowed, &there), Ok(()));
        assert!(said(Replacing::Allowed, folder.path()).unwrap_err().contains("is a folder"));
        let nowhere = folder.path().join("nowhere/new.svg");
        assert!(said(Replacing::Refused, &nowhere).unwrap_err().contains("there is no folder"));
        assert_eq!(said(Replacing::Refused, &folder.path().join("new.svg")), Ok(()));
        assert_eq!(said(Replacing::Refused, Path::new("new-file-in-this-folder.svg")), Ok(()));
    }
}
