use clap::Parser;

use super::*;

#[derive(Parser)]
struct OnlyFlags {
    #[command(flatten)]
    flags: Flags,
}

fn flags(arguments: &[&str]) -> Flags {
    OnlyFlags::try_parse_from([&["waypost-server"], arguments].concat()).unwrap().flags
}

fn variables(pairs: &[(&str, &str)]) -> Vec<(OsString, OsString)> {
    pairs.iter().map(|(name, value)| (name.into(), value.into())).collect()
}

/// A file of that content, kept until dropped.
fn file(content: &str) -> tempfile::NamedTempFile {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), content).unwrap();
    file
}

fn refused(arguments: &[&str], content: &str, environment: &[(&str, &str)]) -> String {
    let file = file(content);
    let loaded = Config::load(&flags(arguments), Some(file.path()), variables(environment));
    let path = file.path().display().to_string();
    loaded.unwrap_err().to_string().replace(&path, "FILE")
}

#[test]
fn flags_go_before_the_environment_and_that_before_the_file() {
    let file = file("data_dir = \"of-file\"\nlog = \"debug\"\ngrpc_address = \"127.0.0.1:1\"\n");
    let environment = [("WAYPOST_DATA_DIR", "of-environment"), ("WAYPOST_LOG", "warn")];
    let flags = flags(&["--data-dir", "of-flags"]);
    let config = Config::load(&flags, Some(file.path()), variables(&environment)).unwrap();
    let expected = Config {
        data_dir: "of-flags".into(),
        log: "warn".to_owned(),
        grpc_address: "127.0.0.1:1".parse().unwrap(),
        ..Config::default()
    };
    assert_eq!(config, expected);
}

#[test]
fn a_misspelt_variable_is_found() {
    let environment =
        variables(&[("WAYPOST_LOGS", "x"), ("WAYPOST_LOG", "x"), ("WAYPOST_TOKEN", "x"), ("HOME", "x")]);
    assert_eq!(unknown_variables(environment), ["WAYPOST_LOGS"]);
}

#[test]
fn nothing_said_means_the_defaults() {
    let foreign =
        [("WAYPOST_TOKEN", "of-a-client"), ("WAYPOST_SERVER", "http://x"), ("WAYPOST_READY_FILE", "")];
    let config = Config::load(&Flags::default(), None, variables(&foreign)).unwrap();
    assert_eq!(config, Config::default());
}

#[test]
fn every_key_is_known_and_every_setting_has_one() {
    let all = Config {
        advertised_host: Some("waypost-2.example.org".to_owned()),
        ready_file: Some("ready".into()),
        max_maps: NonZeroU32::new(100),
        max_sessions: NonZeroU32::new(10_000),
        max_kept_mib: NonZeroU32::new(500_000),
        cors_origins: vec!["https://a.example".parse().unwrap(), "http://127.0.0.1:8080".parse().unwrap()],
        tls_certificate: Some("crt".into()),
        tls_key: Some("key".into()),
        tls_client_ca: Some("ca".into()),
        tls_fleet_ca: Some("servers".into()),
        ..Config::default()
    };
    let table: toml::Table = toml::from_str(&all.to_toml().unwrap()).unwrap();
    let mut known = KEYS.map(|(key, _)| key);
    known.sort_unstable();
    assert_eq!(table.keys().map(String::as_str).collect::<Vec<_>>(), known);
    // Each one is a variable, too, and what it says is what a file would.
    let environment: Vec<(OsString, OsString)> = table
        .iter()
        .map(|(key, value)| {
            let text = |value: &toml::Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            let list = value.as_array().map(|list| list.iter().map(text).collect::<Vec<_>>().join(","));
            let value = list.unwrap_or_else(|| text(value));
            (format!("WAYPOST_{}", key.to_uppercase()).into(), value.into())
        })
        .collect();
    assert_eq!(environment.len(), KEYS.len());
    assert_eq!(Config::load(&Flags::default(), None, environment).unwrap(), all);
}

#[test]
fn a_directory_may_be_called_by_a_number() {
    let environment = variables(&[("WAYPOST_DATA_DIR", "7"), ("WAYPOST_ALLOW_ANONYMOUS", "1")]);
    let config = Config::load(&Flags::default(), None, environment).unwrap();
    assert_eq!((config.data_dir, config.allow_anonymous), (PathBuf::from("7"), true));
}

#[test]
fn both_ports_may_be_free_ones() {
    let flags = flags(&["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0"]);
    let config = Config::load(&flags, None, []).unwrap();
    assert_eq!(config.grpc_address, config.http_address);
}

#[test]
fn a_flag_without_a_value_is_a_yes() {
    for (arguments, expected) in
        [(&["--allow-anonymous"][..], true), (&["--allow-anonymous=false"], false), (&[], false)]
    {
        let config = Config::load(&flags(arguments), None, []).unwrap();
        assert_eq!(config.allow_anonymous, expected, "{arguments:?}");
    }
}

#[test]
fn what_is_wrong_is_named_with_its_source_and_its_form() {
    let environment = |key, value| refused(&[], "", &[(key, value)]);
    let cases = [
        (refused(&[], "grpc_adress = \"127.0.0.1:1\"", &[]), "FILE has the unknown key `grpc_adress`"),
        (
            refused(&[], "grpc_adress = \"127.0.0.1:1\"", &[]),
            "known are data_dir, storage, media, grpc_address",
        ),
        (refused(&[], "grpc_address = \"here\"", &[]), "grpc_address (in FILE) cannot be used"),
        (refused(&[], "grpc_address = \"here\"", &[]), "as in \"127.0.0.1:7600\""),
        (refused(&[], "data_dir = 7", &[]), "data_dir (in FILE) cannot be used"),
        (refused(&[], "[grpc_address]\nport = 1", &[]), "grpc_address (in FILE) cannot be used"),
        (refused(&[], "data_dir = ", &[]), "cannot read the settings in FILE"),
        (
            environment("WAYPOST_HTTP_ADDRESS", "nowhere"),
            "http_address (from the environment, WAYPOST_HTTP_ADDRESS) cannot be used",
        ),
        (environment("WAYPOST_ALLOW_ANONYMOUS", "perhaps"), "write true or false"),
        (environment("WAYPOST_MAP_MEMORY_MIB", "-1"), "write a whole number of mebibytes"),
        (
            environment("WAYPOST_CORS_ORIGINS", "https://a.example,*"),
            "cors_origins (from the environment, WAYPOST_CORS_ORIGINS) cannot be used: `*` is no origin",
        ),
        (refused(&[], "cors_origins = [\"https://a.example/\"]", &[]), "write origins of pages, as in"),
        (environment("WAYPOST_LOG_FORMAT", "xml"), "write \"text\" or \"json\""),
        (environment("WAYPOST_LOG", "a=b=c"), "log (from the environment, WAYPOST_LOG) cannot be used"),
        (
            refused(&["--tls-key", "k"], "", &[]),
            "tls_key (from the command line, --tls-key) needs tls_certificate",
        ),
        (
            refused(&[], "tls_certificate = \"c\"", &[]),
            "tls_certificate (in FILE) needs tls_key, which is not set",
        ),
        (environment("WAYPOST_MEDIA", "media"), "write \"database\", a bucket"),
        (environment("WAYPOST_TLS_CLIENT_CA", "c"), "tls_client_ca (from the environment"),
        (environment("WAYPOST_TLS_FLEET_CA", "c"), "tls_fleet_ca (from the environment"),
        (environment("WAYPOST_ADVERTISED_HOST", "http://a"), "`http://a` is no host"),
        (environment("WAYPOST_ADVERTISED_HOST", "a:7600"), "write a host's name or address"),
        (environment("WAYPOST_ADVERTISED_HOST", "fe80::1"), "stands in brackets"),
        (
            refused(&["--http-address", "127.0.0.1:7600"], "", &[]),
            "http_address (from the command line, --http-address) is 127.0.0.1:7600, and so is grpc_address",
        ),
    ];
    for (message, says) in cases {
        assert!(message.contains(says), "{message:?} does not say {says:?}");
    }
    let missing = Config::load(&Flags::default(), Some(Path::new("/nowhere/waypost.toml")), []);
    let message = missing.unwrap_err().to_string();
    assert!(message.contains("/nowhere/waypost.toml") && message.contains("--config"), "{message}");
}
