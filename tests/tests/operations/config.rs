//! What a server is told, where from, and what it says to that.

use std::path::Path;
use std::process::Output;

use crate::harness::{Built, ServerProcess, run_to_its_end};

/// Runs `waypost-server` to its end; gives its exit code and what it wrote to stdout and stderr.
fn run(arguments: &[&str], environment: &[(&str, &str)]) -> (i32, String, String) {
    let mut command = Built::command("waypost-server");
    command.args(arguments).envs(environment.iter().copied());
    let Output { status, stdout, stderr } = run_to_its_end(command);
    let (stdout, stderr) = (String::from_utf8(stdout).unwrap(), String::from_utf8(stderr).unwrap());
    assert!(!stderr.contains("panicked"), "{stderr}");
    (status.code().expect("no signal ended it"), stdout, stderr)
}

#[track_caller]
fn says(text: &str, fragments: &[&str]) {
    for fragment in fragments {
        assert!(text.contains(fragment), "{text:?} does not say {fragment:?}");
    }
}

#[test]
fn what_is_printed_is_in_force_when_it_is_read_again() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("waypost.toml");
    std::fs::write(&file, "http_address = \"127.0.0.1:1\"\nlog = \"of-file\"\n").unwrap();
    let path = file.to_str().unwrap();
    let arguments =
        ["--print-config", "--data-dir", "a \"quoted\" one", "--tls-certificate", "c", "--tls-key", "k"];
    let environment = [
        ("WAYPOST_CONFIG", path),
        ("WAYPOST_LOG", "warn,waypost_server=debug"),
        ("WAYPOST_LOG_FORMAT", "json"),
    ];
    let (code, printed, stderr) = run(&arguments, &environment);
    assert_eq!((code, stderr.as_str()), (0, ""));
    let table: toml::Table = toml::from_str(&printed).unwrap();
    let text = |key: &str| table[key].as_str().unwrap().to_owned();
    assert_eq!(text("data_dir"), "a \"quoted\" one");
    assert_eq!((text("grpc_address"), text("http_address")), ("127.0.0.1:7600".into(), "127.0.0.1:1".into()));
    assert_eq!((text("log"), text("log_format")), ("warn,waypost_server=debug".into(), "json".into()));
    assert_eq!((text("tls_key"), table["allow_anonymous"].as_bool()), ("k".into(), Some(false)));

    std::fs::write(&file, &printed).unwrap();
    assert_eq!(run(&["--print-config", "--config", path], &[]), (0, printed, String::new()));
    let (code, defaults, _) = run(&["--print-config"], &[]);
    let defaults: toml::Table = toml::from_str(&defaults).unwrap();
    assert_eq!((code, defaults["data_dir"].as_str()), (0, Some("waypost-data")));
}

#[test]
fn what_is_wrong_is_named_before_anything_begins() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("waypost.toml");
    let path = file.to_str().unwrap();
    let data = directory.path().join("data");
    for (content, fragments) in [
        ("grpc_adress = \"127.0.0.1:0\"", &["`grpc_adress`", path, "grpc_address"][..]),
        ("grpc_address = \"somewhere\"", &["grpc_address", path, "127.0.0.1:7600"]),
        ("allow_anonymous = \"perhaps\"", &["allow_anonymous", path, "true or false"]),
        ("data_dir", &["cannot read the settings", path]),
        ("tls_key = \"k\"", &["tls_key", path, "tls_certificate"]),
        ("http_address = \"127.0.0.1:7600\"", &["http_address", path, "so is grpc_address", "port 0"]),
    ] {
        std::fs::write(&file, content).unwrap();
        let (code, stdout, stderr) = run(&["--config", path, "--data-dir", data.to_str().unwrap()], &[]);
        assert_eq!((code, stdout.as_str()), (1, ""), "{content}: {stderr}");
        says(&stderr, fragments);
    }
    let (code, _, stderr) = run(&[], &[("WAYPOST_GRPC_ADDRESS", "somewhere")]);
    assert_eq!(code, 1);
    says(&stderr, &["grpc_address", "WAYPOST_GRPC_ADDRESS", "127.0.0.1:7600"]);
    let (code, _, stderr) = run(&["--config", "/nowhere/waypost.toml"], &[]);
    assert_eq!(code, 1);
    says(&stderr, &["/nowhere/waypost.toml", "--config"]);
    assert!(!data.exists());
}

#[test]
fn other_machines_are_not_served_by_accident() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().to_str().unwrap();
    for (option, other) in [("--grpc-address", "--http-address"), ("--http-address", "--grpc-address")] {
        let (code, _, stderr) = run(&["--data-dir", data, option, "192.0.2.1:0", other, "127.0.0.1:0"], &[]);
        assert_eq!(code, 1, "{stderr}");
        says(&stderr, &["192.0.2.1:0", "token create", "--allow-anonymous"]);
    }
    // Both ways mend it. This address is none of this machine's, so that nothing is laid open here.
    let refused = |environment: &[(&str, &str)]| {
        let addresses = ["--grpc-address", "192.0.2.1:0", "--http-address", "127.0.0.1:0"];
        let (code, _, stderr) = run(&[&["--data-dir", data][..], &addresses].concat(), environment);
        assert_eq!(code, 1);
        stderr
    };
    says(&refused(&[("WAYPOST_ALLOW_ANONYMOUS", "true")]), &["cannot listen on 192.0.2.1:0"]);
    let (code, secret, _) = run(&["token", "create", "operator", "--role", "admin", "--data-dir", data], &[]);
    assert_eq!(code, 0);
    assert!(secret.starts_with("waypost_"), "{secret}");
    says(&refused(&[]), &["cannot listen on 192.0.2.1:0"]);
}

/// Looks whether a server could start; gives the exit code and what was found.
fn check(data: &Path, options: &[&str]) -> (i32, String) {
    let ports = ["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0"];
    let arguments = [&["--check", "--data-dir", data.to_str().unwrap()][..], &ports, options].concat();
    let (code, stdout, stderr) = run(&arguments, &[]);
    assert_eq!(stderr, "");
    (code, stdout)
}

#[test]
fn a_check_tells_what_would_go_wrong() {
    let directory = tempfile::tempdir().unwrap();
    let (code, found) = check(directory.path(), &[]);
    assert_eq!(code, 0, "{found}");
    says(&found, &["ok     settings", "holds no database yet", "this machine alone"]);
    assert!(!found.contains("wrong"), "{found}");

    let server = ServerProcess::start(directory.path());
    let (code, found) = check(directory.path(), &[]);
    assert_eq!(code, 1, "{found}");
    says(&found, &["wrong  data directory", "is used by another waypost-server"]);
    server.stop();
    let file = directory.path().join("waypost.sqlite");
    let before = std::fs::read(&file).unwrap();
    let (code, found) = check(directory.path(), &[]);
    assert_eq!(code, 0, "{found}");
    says(&found, &["holds 0 maps and 0 tokens"]);
    assert_eq!(std::fs::read(&file).unwrap(), before);

    // All is looked at, whatever is wrong.
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let tls = ["--tls-certificate", "/nowhere/server.crt", "--tls-key", "/nowhere/server.key"];
    let ports = ["--check", "--grpc-address", &address, "--http-address", "0.0.0.0:0"];
    let data = ["--data-dir", directory.path().to_str().unwrap()];
    let (code, found, _) = run(&[&ports[..], &tls, &data].concat(), &[]);
    assert_eq!(code, 1);
    says(
        &found,
        &[
            "wrong  certificates: cannot read /nowhere/server.crt",
            "ok     data directory",
            "wrong  access: 0.0.0.0:0 can be reached",
            "wrong  addresses: cannot listen on",
        ],
    );
    // What is refused before it begins leaves nothing behind.
    let missing = directory.path().join("missing");
    let everywhere = ["--grpc-address", "127.0.0.1:0", "--http-address", "0.0.0.0:0"];
    let (code, _, stderr) = run(&[&everywhere[..], &["--data-dir", missing.to_str().unwrap()]].concat(), &[]);
    assert!(code == 1 && stderr.contains("0.0.0.0:0 can be reached from other machines"), "{stderr}");
    assert!(!missing.exists());
    std::fs::write(&file, vec![7; 20_000]).unwrap();
    let (code, found) = check(directory.path(), &[]);
    assert_eq!(code, 1);
    says(&found, &["wrong  data directory", "is no database of Waypost", "restore"]);
}

#[test]
fn shells_and_man_know_every_command_whatever_the_settings_are() {
    let broken = [("WAYPOST_GRPC_ADDRESS", "nowhere")];
    for shell in ["bash", "zsh", "fish"] {
        let (code, script, stderr) = run(&["completions", shell], &broken);
        assert_eq!((code, stderr.as_str()), (0, ""));
        says(&script, &["restore", "grpc-address", "expires-in"]);
    }
    let directory = tempfile::tempdir().unwrap();
    let pages = directory.path().join("man8");
    let man = ["man", pages.to_str().unwrap()];
    assert_eq!(run(&man, &broken), (0, String::new(), String::new()));
    let page = |name: &str| std::fs::read_to_string(pages.join(name)).unwrap();
    says(&page("waypost-server.8"), &["wrong\\-tokens\\-per\\-minute", "waypost\\-server\\-backup(8)"]);
    says(&page("waypost-server-token-create.8"), &["\\-\\-may", "localize: Ask where"]);
    let (code, _, stderr) = run(&man, &[]);
    assert_eq!(code, 1);
    says(&stderr, &["waypost-server.8", "not replaced", "--force"]);
    std::fs::write(pages.join("waypost-server.8"), "old").unwrap();
    assert_eq!(run(&["man", pages.to_str().unwrap(), "--force"], &[]).0, 0);
    says(&page("waypost-server.8"), &["wrong\\-tokens\\-per\\-minute"]);
}
