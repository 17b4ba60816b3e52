//! Where a server keeps maps, models and tokens.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::storage::{MediaAddress, parse_postgres_address};

/// What keeps the tables.
#[derive(Clone, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(try_from = "String", into = "String")]
pub enum StorageAddress {
    /// A file of SQLite in the data directory.
    #[default]
    Sqlite,
    /// A database of PostgreSQL, by its URL. What it does not say comes from libpq's variables and password file.
    Postgres(String),
}

/// No [`StorageAddress`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct NoStorage(String);

impl FromStr for StorageAddress {
    type Err = NoStorage;

    fn from_str(text: &str) -> Result<Self, NoStorage> {
        if text == "sqlite" {
            return Ok(Self::Sqlite);
        }
        if !["postgres://", "postgresql://"].iter().any(|scheme| text.starts_with(scheme)) {
            return Err(NoStorage("it is neither sqlite nor the URL of a database of PostgreSQL".to_owned()));
        }
        match parse_postgres_address(text) {
            Ok(()) => Ok(Self::Postgres(text.to_owned())),
            Err(reason) => Err(NoStorage(format!("it is no URL of a database: {reason}"))),
        }
    }
}

impl TryFrom<String> for StorageAddress {
    type Error = NoStorage;

    fn try_from(text: String) -> Result<Self, NoStorage> {
        text.parse()
    }
}

impl From<StorageAddress> for String {
    fn from(address: StorageAddress) -> Self {
        match address {
            StorageAddress::Sqlite => "sqlite".to_owned(),
            StorageAddress::Postgres(url) => url,
        }
    }
}

/// Without a password that it may have.
impl fmt::Display for StorageAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::Postgres(url) = self else { return formatter.write_str("sqlite") };
        let (scheme, rest) = url.split_once("://").unwrap_or(("postgres", url));
        let (user, server) = match rest.rsplit_once('@') {
            Some((user, server)) => (Some(user.split_once(':').map_or(user, |(user, _)| user)), server),
            None => (None, rest),
        };
        let server = server.split_once('?').map_or(server, |(server, _)| server);
        match user {
            Some(user) => write!(formatter, "{scheme}://{user}@{server}"),
            None => write!(formatter, "{scheme}://{server}"),
        }
    }
}

impl fmt::Debug for StorageAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, formatter)
    }
}

/// Where all lies that one server has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DataLocation {
    /// What keeps the tables.
    pub storage: StorageAddress,
    /// SQLite's file is here, and what is being brought in.
    pub data_dir: PathBuf,
    /// Where the media of frames lie.
    pub media: MediaAddress,
}

impl DataLocation {
    /// What it is, in a word or two.
    pub(crate) fn subject(&self) -> &'static str {
        match self.storage {
            StorageAddress::Sqlite => "data directory",
            StorageAddress::Postgres(_) => "database",
        }
    }
}

/// A directory with a file of SQLite, or the URL of a database of PostgreSQL.
impl FromStr for DataLocation {
    type Err = NoStorage;

    fn from_str(text: &str) -> Result<Self, NoStorage> {
        if text.contains("://") {
            return Ok(Self { storage: text.parse()?, data_dir: std::env::temp_dir(), ..Self::default() });
        }
        Ok(PathBuf::from(text).into())
    }
}

/// With a file of SQLite in it.
impl From<PathBuf> for DataLocation {
    fn from(data_dir: PathBuf) -> Self {
        Self { data_dir, ..Self::default() }
    }
}

impl From<&Path> for DataLocation {
    fn from(data_dir: &Path) -> Self {
        data_dir.to_owned().into()
    }
}

/// As messages name it.
impl fmt::Display for DataLocation {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.storage {
            StorageAddress::Sqlite => write!(formatter, "{}", self.data_dir.display()),
            postgres @ StorageAddress::Postgres(_) => write!(formatter, "{postgres}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_password_is_not_shown() {
        let shown = |text: &str| text.parse::<StorageAddress>().unwrap().to_string();
        assert_eq!(shown("sqlite"), "sqlite");
        assert_eq!(shown("postgres://waypost:s3cret@db:5433/maps"), "postgres://waypost@db:5433/maps");
        assert_eq!(shown("postgres://waypost@db/maps?password=s3cret"), "postgres://waypost@db/maps");
        assert_eq!(shown("postgresql:///maps?host=/run/postgresql"), "postgresql:///maps");
        let whole: StorageAddress = "postgres://waypost:s3cret@db/maps".parse().unwrap();
        assert_eq!(String::from(whole), "postgres://waypost:s3cret@db/maps");
    }

    #[test]
    fn what_is_no_address_is_refused() {
        for (text, says) in [
            ("mysql://db/maps", "neither sqlite nor"),
            ("", "neither sqlite nor"),
            ("postgres://db:notaport/maps", "no URL of a database"),
            ("postgres://db/maps?sslmode=perhaps", "no URL of a database"),
        ] {
            let refused = text.parse::<StorageAddress>().unwrap_err().to_string();
            assert!(refused.contains(says), "{text:?}: {refused}");
        }
    }
}
