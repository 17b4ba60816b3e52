//! Where settings come from besides files: the environment and the command line.

use std::ffi::OsString;

use figment::providers::Serialized;
use figment::value::{Dict, Map, Value};
use figment::{Metadata, Profile, Provider};

use super::keys::{KEYS, PREFIX, form};
use super::{ConfigError, Flags};

/// Settings that are whole numbers.
const NUMBERS: [&str; 8] = [
    "map_memory_mib",
    "stranger_connections",
    "stranger_connections_per_address",
    "stranger_time_s",
    "wrong_tokens_per_minute",
    "max_maps",
    "max_sessions",
    "max_kept_mib",
];

/// `WAYPOST_…`. Values are taken as they are: a directory may be called 7.
pub(super) struct Environment(Dict);

impl Environment {
    pub(super) const NAME: &'static str = "environment";

    pub(super) fn of(variables: impl IntoIterator<Item = (OsString, OsString)>) -> Result<Self, ConfigError> {
        let mut values = Dict::new();
        for (name, value) in variables {
            let Some(name) = name.to_str().and_then(|name| name.strip_prefix(PREFIX)) else { continue };
            let key = name.to_lowercase();
            if value.is_empty() || !KEYS.iter().any(|(known, _)| *known == key) {
                continue;
            }
            let Some(value) = value.to_str() else {
                return Err(ConfigError::Value {
                    origin: format!("from the environment, {PREFIX}{name}"),
                    reason: "it is not UTF-8".to_owned(),
                    form: form(&key),
                    key,
                });
            };
            let value = match (key.as_str(), value) {
                ("allow_anonymous", "true" | "1") => Value::from(true),
                ("allow_anonymous", "false" | "0") => Value::from(false),
                ("cors_origins", list) => {
                    Value::from(list.split(',').map(str::trim).map(Value::from).collect::<Vec<_>>())
                }
                (key, number) if NUMBERS.contains(&key) => {
                    number.parse::<u64>().map_or_else(|_| Value::from(number), Value::from)
                }
                (_, other) => Value::from(other),
            };
            values.insert(key, value);
        }
        Ok(Self(values))
    }
}

impl Provider for Environment {
    fn metadata(&self) -> Metadata {
        Metadata::named(Self::NAME)
    }

    fn data(&self) -> figment::Result<Map<Profile, Dict>> {
        Ok(Map::from([(Profile::Default, self.0.clone())]))
    }
}

/// The flags that were given.
pub(super) struct CommandLine<'a>(pub(super) &'a Flags);

impl CommandLine<'_> {
    pub(super) const NAME: &'static str = "command line";
}

impl Provider for CommandLine<'_> {
    fn metadata(&self) -> Metadata {
        Metadata::named(Self::NAME)
    }

    fn data(&self) -> figment::Result<Map<Profile, Dict>> {
        Serialized::defaults(self.0).data()
    }
}
