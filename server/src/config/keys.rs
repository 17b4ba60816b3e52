//! What settings are called, and how each is written.

use std::ffi::OsString;

/// Begins the names of variables in the environment.
pub(super) const PREFIX: &str = "WAYPOST_";

/// Every setting, with how it is written.
pub(super) const KEYS: [(&str, &str); 23] = [
    ("data_dir", "a directory, as in \"waypost-data\""),
    ("storage", "\"sqlite\", or a URL, as in \"postgres://waypost@db.example.org/waypost\""),
    (
        "media",
        "\"database\", a bucket, as in \"s3://waypost/halls\", or a folder, as in \"/srv/waypost-media\"",
    ),
    ("grpc_address", "an address and a port, as in \"127.0.0.1:7600\""),
    ("http_address", "an address and a port, as in \"127.0.0.1:7601\""),
    ("advertised_host", "a host's name or address, as in \"waypost-2.example.org\""),
    ("ready_file", "a file, as in \"/run/waypost/ready.json\""),
    ("log", "a level, or levels by module, as in \"info\" or \"warn,waypost_server=debug\""),
    ("log_format", "\"text\" or \"json\""),
    ("allow_anonymous", "true or false"),
    ("map_memory_mib", "a whole number of mebibytes, as in 1024"),
    ("stranger_connections", "a whole number from 1 on, as in 128"),
    ("stranger_connections_per_address", "a whole number from 1 on, as in 64"),
    ("stranger_time_s", "a whole number of seconds from 1 on, as in 30"),
    ("wrong_tokens_per_minute", "a whole number, as in 1000"),
    ("max_maps", "a whole number from 1 on, as in 100; leave it out for any number"),
    ("max_sessions", "a whole number from 1 on, as in 10000; leave it out for any number"),
    (
        "max_kept_mib",
        "a whole number of mebibytes from 1 on, as in 500000; leave it out for as many as the disk has",
    ),
    ("cors_origins", "origins of pages, as in \"https://fleet.example\" or \"http://127.0.0.1:8080\""),
    ("tls_certificate", "a file, as in \"/etc/waypost/server.crt\""),
    ("tls_key", "a file, as in \"/etc/waypost/server.key\""),
    ("tls_client_ca", "a file, as in \"/etc/waypost/clients.crt\""),
    ("tls_fleet_ca", "a file, as in \"/etc/waypost/servers.crt\""),
];

/// Variables that are not settings: the file itself, and what `waypost` reads.
const OTHER_VARIABLES: [&str; 6] = ["CONFIG", "SERVER", "TOKEN", "CA", "CLIENT_CERT", "CLIENT_KEY"];

/// Variables that look like settings and are none, probably misspelt.
pub fn unknown_variables(environment: impl IntoIterator<Item = (OsString, OsString)>) -> Vec<String> {
    let names = environment.into_iter().filter_map(|(name, _)| name.into_string().ok());
    let unknown = |name: &String| {
        name.strip_prefix(PREFIX).is_some_and(|rest| {
            let key = rest.to_lowercase();
            !OTHER_VARIABLES.contains(&rest) && !KEYS.iter().any(|(known, _)| *known == key)
        })
    };
    names.filter(unknown).collect()
}

/// How a setting is written.
pub(super) fn form(key: &str) -> &'static str {
    KEYS.into_iter().find(|(known, _)| *known == key).map_or("it as --help says", |(_, form)| form)
}

/// All settings' names.
pub(super) fn names() -> String {
    KEYS.map(|(key, _)| key).join(", ")
}
