//! What a server is told when it starts: by flags, environment and one file, in this order of precedence.

use std::ffi::OsString;
use std::net::{Ipv4Addr, SocketAddr};
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::ValueEnum;
use figment::providers::{Format, Serialized, Toml};
use figment::{Figment, Metadata, Source};
use http::uri::Authority;
use serde::{Deserialize, Serialize};
use tracing_subscriber::EnvFilter;

use crate::net::origin::Origin;
use crate::net::standing::Strangers;
use crate::net::tls::TlsFiles;
use crate::quotas::ServerLimits;
pub use crate::storage::{MediaAddress, NoMediaAddress};

mod error;
mod keys;
mod layers;
mod location;

pub use error::ConfigError;
pub use keys::unknown_variables;
use keys::{KEYS, PREFIX, form};
use layers::{CommandLine, Environment};
pub use location::{DataLocation, NoStorage, StorageAddress};

/// All settings. [`Default`] has the defaults.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Directory of the database; made if it is missing.
    pub data_dir: PathBuf,
    /// What keeps maps, models and tokens.
    pub storage: StorageAddress,
    /// Where the media of frames lie.
    pub media: MediaAddress,
    /// Where robots connect (gRPC).
    pub grpc_address: SocketAddr,
    /// Where people look (HTTP).
    pub http_address: SocketAddr,
    /// By which name other servers of a fleet reach this one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advertised_host: Option<String>,
    /// Where the addresses are written once the server listens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ready_file: Option<PathBuf>,
    /// What is logged: a level, or levels by module.
    pub log: String,
    /// How it is logged.
    pub log_format: LogFormat,
    /// Without any token, everyone who reaches the server is served, from other machines too.
    pub allow_anonymous: bool,
    /// While open maps take more memory than so many mebibytes, those that nobody uses are closed.
    pub map_memory_mib: u64,
    /// Connections without an admitted call that each listener keeps.
    pub stranger_connections: NonZeroU32,
    /// Those of them that may come from one address.
    pub stranger_connections_per_address: NonZeroU32,
    /// How long each of them is kept.
    pub stranger_time_s: NonZeroU32,
    /// Wrong tokens that are taken from one address in a minute.
    pub wrong_tokens_per_minute: u32,
    /// Maps that there may be.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_maps: Option<NonZeroU32>,
    /// Sessions that maps may keep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_sessions: Option<NonZeroU32>,
    /// Mebibytes that sessions may keep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_kept_mib: Option<NonZeroU32>,
    /// Pages of these origins may ask over HTTP from a browser; none by default.
    pub cors_origins: Vec<Origin>,
    /// The server's certificate and those above it, PEM.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tls_certificate: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tls_key: Option<PathBuf>,
    /// Authorities whose certificates clients must have, PEM.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tls_client_ca: Option<PathBuf>,
    /// Authorities of the other servers of a fleet, PEM.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tls_fleet_ca: Option<PathBuf>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            data_dir: PathBuf::from("waypost-data"),
            storage: StorageAddress::Sqlite,
            media: MediaAddress::Database,
            grpc_address: (Ipv4Addr::LOCALHOST, 7600).into(),
            http_address: (Ipv4Addr::LOCALHOST, 7601).into(),
            advertised_host: None,
            ready_file: None,
            log: "info".to_owned(),
            log_format: LogFormat::Text,
            allow_anonymous: false,
            map_memory_mib: 1024,
            stranger_connections: nonzero(128),
            stranger_connections_per_address: nonzero(64),
            stranger_time_s: nonzero(30),
            wrong_tokens_per_minute: 1000,
            max_maps: None,
            max_sessions: None,
            max_kept_mib: None,
            cors_origins: Vec::new(),
            tls_certificate: None,
            tls_key: None,
            tls_client_ca: None,
            tls_fleet_ca: None,
        }
    }
}

fn nonzero(number: u32) -> NonZeroU32 {
    NonZeroU32::new(number).unwrap_or(NonZeroU32::MIN)
}

/// How log lines are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people
    Text,
    /// One JSON object a line
    Json,
}

/// Settings as flags: what is left out comes from the environment, the file or the defaults.
#[derive(Clone, Debug, Default, Serialize, clap::Args)]
pub struct Flags {
    /// Directory of the database; made if it is missing [default: waypost-data]
    #[arg(long, global = true, value_name = "DIR")]
    #[serde(skip_serializing_if = "Option::is_none")]
    data_dir: Option<PathBuf>,
    /// What keeps maps, models and tokens: sqlite, a file in the data directory, or postgres://USER@HOST/DATABASE
    /// [default: sqlite]
    #[arg(long, global = true, value_name = "STORAGE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    storage: Option<StorageAddress>,
    /// Where media of frames lie: database, or beside PostgreSQL s3://BUCKET/FOLDER, or a folder [default: database]
    #[arg(long, global = true, value_name = "MEDIA")]
    #[serde(skip_serializing_if = "Option::is_none")]
    media: Option<MediaAddress>,
    /// Where robots connect (gRPC); port 0 picks a free one [default: 127.0.0.1:7600]
    #[arg(long, value_name = "ADDRESS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    grpc_address: Option<SocketAddr>,
    /// Where people look (HTTP); port 0 picks a free one [default: 127.0.0.1:7601]
    #[arg(long, value_name = "ADDRESS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    http_address: Option<SocketAddr>,
    /// By which name other servers on the same database reach this one [default: the address that it listens on, or
    /// the machine's name if that is every address]
    #[arg(long, value_name = "HOST")]
    #[serde(skip_serializing_if = "Option::is_none")]
    advertised_host: Option<String>,
    /// Once the server listens, its addresses are written to this file as JSON: {"grpc": …, "http": …}
    #[arg(long, value_name = "FILE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    ready_file: Option<PathBuf>,
    /// What is logged: a level, or levels by module, as in warn,waypost_server=debug [default: info]
    #[arg(long, value_name = "FILTER")]
    #[serde(skip_serializing_if = "Option::is_none")]
    log: Option<String>,
    /// How it is logged [default: text]
    #[arg(long, value_name = "FORMAT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    log_format: Option<LogFormat>,
    /// Serve everyone who reaches the server while there is no token, on other addresses than loopback too
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    #[serde(skip_serializing_if = "Option::is_none")]
    allow_anonymous: Option<bool>,
    /// While open maps take more mebibytes of memory, those that nobody uses are closed [default: 1024]
    #[arg(long, value_name = "MIB")]
    #[serde(skip_serializing_if = "Option::is_none")]
    map_memory_mib: Option<u64>,
    /// Connections without an admitted call that each listener keeps; the oldest make room for further ones
    /// [default: 128]
    #[arg(long, value_name = "NUMBER")]
    #[serde(skip_serializing_if = "Option::is_none")]
    stranger_connections: Option<NonZeroU32>,
    /// Those of them that may come from one address; raise it for a proxy [default: 64]
    #[arg(long, value_name = "NUMBER")]
    #[serde(skip_serializing_if = "Option::is_none")]
    stranger_connections_per_address: Option<NonZeroU32>,
    /// Seconds after which a connection without an admitted call is closed [default: 30]
    #[arg(long, value_name = "SECONDS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    stranger_time_s: Option<NonZeroU32>,
    /// Wrong tokens that are taken from one address in a minute [default: 1000]
    #[arg(long, value_name = "NUMBER")]
    #[serde(skip_serializing_if = "Option::is_none")]
    wrong_tokens_per_minute: Option<u32>,
    /// Maps that there may be; others are refused [default: any number]
    #[arg(long, value_name = "NUMBER")]
    #[serde(skip_serializing_if = "Option::is_none")]
    max_maps: Option<NonZeroU32>,
    /// Sessions that maps may keep; others are refused [default: any number]
    #[arg(long, value_name = "NUMBER")]
    #[serde(skip_serializing_if = "Option::is_none")]
    max_sessions: Option<NonZeroU32>,
    /// Mebibytes that sessions may keep in all maps; frames above it wait [default: what the disk has]
    #[arg(long, value_name = "MIB")]
    #[serde(skip_serializing_if = "Option::is_none")]
    max_kept_mib: Option<NonZeroU32>,
    /// Pages of these origins (scheme, host and port) may ask over HTTP from a browser; several with commas
    #[arg(long, value_name = "ORIGINS", value_delimiter = ',')]
    #[serde(skip_serializing_if = "Option::is_none")]
    cors_origins: Option<Vec<Origin>>,
    /// The server's certificate and those above it (PEM); both listeners then speak TLS
    #[arg(long, value_name = "FILE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    tls_certificate: Option<PathBuf>,
    /// Private key of the certificate (PEM)
    #[arg(long, value_name = "FILE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    tls_key: Option<PathBuf>,
    /// Authorities whose certificates clients must have (PEM)
    #[arg(long, value_name = "FILE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    tls_client_ca: Option<PathBuf>,
    /// Authorities whose certificates the other servers of a fleet have (PEM) [default: this server's own certificates]
    #[arg(long, value_name = "FILE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    tls_fleet_ca: Option<PathBuf>,
}

impl Config {
    /// What is in force with these flags, this file, and `environment`, whose other variables are left
    /// alone. An empty variable counts as none.
    ///
    /// # Errors
    /// If the file cannot be read, has an unknown key, or a value is of no use; the message names the
    /// key, where it was set, and how to write it.
    pub fn load(
        flags: &Flags,
        file: Option<&Path>,
        environment: impl IntoIterator<Item = (OsString, OsString)>,
    ) -> Result<Self, ConfigError> {
        let mut layers = Figment::from(Serialized::defaults(Self::default()));
        if let Some(path) = file {
            check_file(path)?;
            layers = layers.merge(Toml::file_exact(path));
        }
        layers = layers.merge(Environment::of(environment)?).merge(CommandLine(flags));
        let config: Self = layers.extract().map_err(|error| unusable(&error))?;
        config.check(&layers)?;
        Ok(config)
    }

    /// In TOML, as [`load`](Self::load) reads it.
    ///
    /// # Errors
    /// If a path is not UTF-8.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// Where all lies that the server has.
    #[must_use]
    pub fn location(&self) -> DataLocation {
        DataLocation {
            storage: self.storage.clone(),
            data_dir: self.data_dir.clone(),
            media: self.media.clone(),
        }
    }

    /// [`Config::map_memory_mib`] in bytes.
    #[must_use]
    pub fn map_memory_bytes(&self) -> u64 {
        self.map_memory_mib.saturating_mul(1 << 20)
    }

    /// What connections are granted on which no call was admitted.
    #[must_use]
    pub fn strangers(&self) -> Strangers {
        Strangers {
            connections: self.stranger_connections.get() as usize,
            connections_per_address: self.stranger_connections_per_address.get() as usize,
            time: Duration::from_secs(self.stranger_time_s.get().into()),
        }
    }

    /// How much may be there, whosever it is.
    #[must_use]
    pub fn limits(&self) -> ServerLimits {
        let Self { max_maps, max_sessions, max_kept_mib, .. } = *self;
        ServerLimits { max_maps, max_sessions, max_kept_mib }
    }

    /// Files of the certificates, if there are any.
    #[must_use]
    pub fn tls_files(&self) -> Option<TlsFiles> {
        let (certificate, key) = self.tls_certificate.clone().zip(self.tls_key.clone())?;
        Some(TlsFiles {
            certificate,
            key,
            client_ca: self.tls_client_ca.clone(),
            fleet_ca: self.tls_fleet_ca.clone(),
        })
    }

    fn check(&self, layers: &Figment) -> Result<(), ConfigError> {
        let origin_of = |key: &str| origin(layers.find_metadata(key), key);
        if let Err(error) = EnvFilter::try_new(&self.log) {
            let key = "log";
            let reason = error.to_string();
            return Err(ConfigError::Value {
                key: key.to_owned(),
                origin: origin_of(key),
                reason,
                form: form(key),
            });
        }
        if let Some(host) = &self.advertised_host
            && let Err(reason) = check_host(host)
        {
            let key = "advertised_host";
            let (key, origin, form) = (key.to_owned(), origin_of(key), form(key));
            return Err(ConfigError::Value { key, origin, reason, form });
        }
        if self.grpc_address == self.http_address && self.http_address.port() != 0 {
            let origin = origin_of("http_address");
            return Err(ConfigError::SameAddress { origin, address: self.http_address });
        }
        let certificate = self.tls_certificate.is_some();
        let key = self.tls_key.is_some();
        let lacks = |key, missing| Err(ConfigError::Lacks { key, origin: origin_of(key), missing });
        match (certificate, key) {
            (true, false) => lacks("tls_certificate", "tls_key"),
            (false, true) => lacks("tls_key", "tls_certificate"),
            (false, false) if self.tls_client_ca.is_some() => lacks("tls_client_ca", "tls_certificate"),
            (false, false) if self.tls_fleet_ca.is_some() => lacks("tls_fleet_ca", "tls_certificate"),
            (true, true) | (false, false) => Ok(()),
        }
    }
}

/// Whether a text is a host alone.
fn check_host(host: &str) -> Result<(), String> {
    let with_port = format!("{host}:1").parse::<Authority>();
    match with_port {
        Ok(authority) if !host.is_empty() && authority.host() == host => Ok(()),
        Ok(_) | Err(_) => Err(format!(
            "`{host}` is no host: it has neither scheme nor port, and an address of IPv6 stands in brackets"
        )),
    }
}

/// Reads the file once by itself, so that what is wrong with it is said of the file.
fn check_file(path: &Path) -> Result<(), ConfigError> {
    let failed = |reason: String| ConfigError::File { path: path.to_owned(), reason };
    let text = std::fs::read_to_string(path).map_err(|error| failed(error.to_string()))?;
    let table: toml::Table =
        toml::from_str(&text).map_err(|error| failed(error.to_string().trim_end().to_owned()))?;
    match table.keys().find(|key| !KEYS.iter().any(|(known, _)| known == key)) {
        Some(key) => Err(ConfigError::UnknownKey { path: path.to_owned(), key: key.clone() }),
        None => Ok(()),
    }
}

fn unusable(error: &figment::Error) -> ConfigError {
    // What follows is where in a list it is wrong, which the reason shows.
    let key = error.path.first().cloned().unwrap_or_default();
    ConfigError::Value {
        origin: origin(error.metadata.as_ref(), &key),
        reason: error.kind.to_string(),
        form: form(&key),
        key,
    }
}

/// Where a setting comes from, in words.
fn origin(metadata: Option<&Metadata>, key: &str) -> String {
    let Some(metadata) = metadata else { return "default".to_owned() };
    match &metadata.source {
        Some(Source::File(path)) => format!("in {}", path.display()),
        Some(_) | None if metadata.name == Environment::NAME => {
            format!("from the environment, {PREFIX}{}", key.to_uppercase())
        }
        Some(_) | None if metadata.name == CommandLine::NAME => {
            format!("from the command line, --{}", key.replace('_', "-"))
        }
        Some(_) | None => "default".to_owned(),
    }
}

#[cfg(test)]
mod tests;
