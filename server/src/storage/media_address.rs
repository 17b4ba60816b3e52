//! Where images, thumbnails and features of frames lie.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Where a server puts the media of frames: what a map keeps of them beside their words.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(try_from = "String", into = "String")]
pub enum MediaAddress {
    /// Into the database.
    #[default]
    Database,
    /// Into a bucket of S3, or of what speaks its protocol. Who may, and where that is, comes from the variables that the tools
    /// of AWS read.
    S3 {
        /// Its name.
        bucket: String,
        /// What names of objects begin with; empty for none.
        prefix: String,
    },
    /// Into a folder that all servers of the database reach.
    Folder(PathBuf),
}

/// No [`MediaAddress`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct NoMediaAddress(String);

impl FromStr for MediaAddress {
    type Err = NoMediaAddress;

    fn from_str(text: &str) -> Result<Self, NoMediaAddress> {
        if text == "database" {
            return Ok(Self::Database);
        }
        if let Some(rest) = text.strip_prefix("s3://") {
            let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
            let prefix = prefix.trim_matches('/').to_owned();
            let bucket = bucket.to_owned();
            if bucket.is_empty() || text.contains(['?', '#', '@']) {
                return Err(NoMediaAddress("it is no bucket, and a folder in it if you like".to_owned()));
            }
            return Ok(Self::S3 { bucket, prefix });
        }
        let folder = PathBuf::from(text.strip_prefix("file://").unwrap_or(text));
        if folder.is_absolute() {
            return Ok(Self::Folder(folder));
        }
        Err(NoMediaAddress("it is neither database, nor a bucket, nor a folder from / on".to_owned()))
    }
}

impl TryFrom<String> for MediaAddress {
    type Error = NoMediaAddress;

    fn try_from(text: String) -> Result<Self, NoMediaAddress> {
        text.parse()
    }
}

impl From<MediaAddress> for String {
    fn from(address: MediaAddress) -> Self {
        address.to_string()
    }
}

impl fmt::Display for MediaAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Database => formatter.write_str("database"),
            Self::S3 { bucket, prefix } if prefix.is_empty() => write!(formatter, "s3://{bucket}"),
            Self::S3 { bucket, prefix } => write!(formatter, "s3://{bucket}/{prefix}"),
            Self::Folder(folder) => write!(formatter, "file://{}", folder.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_read_is_written_alike() {
        for text in ["database", "s3://waypost", "s3://waypost/halls/north", "file:///srv/waypost media"] {
            assert_eq!(text.parse::<MediaAddress>().unwrap().to_string(), text);
        }
        assert_eq!("/srv/media".parse(), Ok(MediaAddress::Folder("/srv/media".into())));
        let slashes = MediaAddress::S3 { bucket: "waypost".to_owned(), prefix: "halls".to_owned() };
        assert_eq!("s3://waypost/halls/".parse(), Ok(slashes));
    }

    #[test]
    fn what_is_no_address_is_refused() {
        for text in
            ["", "media", "./media", "s3://", "s3:///halls", "s3://key:secret@waypost", "gs://waypost"]
        {
            assert!(text.parse::<MediaAddress>().is_err(), "{text:?}");
        }
    }
}
