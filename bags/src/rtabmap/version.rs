//! The schema of a database, by the version of RTAB-Map that made it.

/// A version that is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Version {
    pub(super) text: String,
    pub(super) minor: u32,
}

/// The minor versions of 0 whose schemas are read.
const OLDEST: u32 = 17;
const NEWEST: u32 = 23;

const OLDER: &str = "`rtabmap-reprocess OLD.db NEW.db` of a newer RTAB-Map makes one of its own schema";
const NEWER: &str =
    "`rtabmap-reprocess --Db/TargetVersion 0.22 NEW.db OLD.db` makes an older one, or take a newer Waypost";
const UNKNOWN: &str = "Check that RTAB-Map opens it";

impl Version {
    /// By what the table Admin says; patches change no schema that is read.
    ///
    /// # Errors
    /// What helps, where the version is none that is read.
    pub(super) fn parse(text: &str) -> Result<Self, &'static str> {
        let mut parts = text.split('.').map(|part| part.parse::<u32>().ok());
        match (parts.next().flatten(), parts.next().flatten()) {
            (Some(0), Some(minor)) if minor < OLDEST => Err(OLDER),
            (Some(0), Some(minor)) if minor <= NEWEST => Ok(Self { text: text.to_owned(), minor }),
            (Some(_), Some(_)) => Err(NEWER),
            (_, _) => Err(UNKNOWN),
        }
    }

    /// Whether calibrations are models with a head; before, they were numbers alone.
    pub(super) fn has_camera_models(&self) -> bool {
        self.minor >= 18
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_older_or_newer_is_told_apart() {
        let minor = |text| Version::parse(text).map(|version| version.minor);
        assert_eq!((minor("0.17.0"), minor("0.23.9"), minor("0.21")), (Ok(17), Ok(23), Ok(21)));
        assert_eq!([minor("0.16.3"), minor("0.24.0"), minor("1.0.0")], [Err(OLDER), Err(NEWER), Err(NEWER)]);
        assert_eq!([minor(""), minor("0"), minor("x.y")], [Err(UNKNOWN); 3]);
    }
}
