//! A server that cannot start says why, and how to mend it.

use std::path::Path;
use std::process::Output;

use sqlx::{ConnectOptions, Connection};

use crate::harness::{Built, ServerProcess, database_options, import_model, run_to_its_end};

const ANY_PORTS: [&str; 4] = ["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0"];

/// Starts a server that is to fail; gives what it wrote to stderr.
fn fails(data_dir: &Path, addresses: [&str; 4]) -> String {
    let mut command = Built::command("waypost-server");
    command.arg("--data-dir").arg(data_dir).args(addresses);
    let Output { status, stdout, stderr } = run_to_its_end(command);
    let stderr = String::from_utf8(stderr).unwrap();
    assert!(!status.success(), "it started well: {stderr}");
    assert!(status.code().is_some(), "it was ended by a signal: {stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    assert_eq!(String::from_utf8(stdout).unwrap(), "");
    stderr
}

fn says(stderr: &str, fragments: &[&str]) {
    for fragment in fragments {
        assert!(stderr.contains(fragment), "{stderr:?} does not say {fragment:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_of_a_newer_version_is_left_alone() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    import_model(&server.client().await).await;
    server.stop();

    let file = directory.path().join("waypost.sqlite");
    let mut database = database_options(directory.path()).connect().await.unwrap();
    sqlx::query(
        "INSERT INTO _sqlx_migrations (version, description, installed_on, success, checksum, execution_time) \
         SELECT 77, 'of the future', installed_on, success, checksum, execution_time FROM _sqlx_migrations LIMIT 1",
    )
    .execute(&mut database)
    .await
    .unwrap();
    database.close().await.unwrap();
    let before = std::fs::read(&file).unwrap();
    let stderr = fails(directory.path(), ANY_PORTS);
    says(&stderr, &["newer Waypost", "77", "update this server"]);
    assert_eq!(std::fs::read(&file).unwrap(), before);
}

#[tokio::test(flavor = "multi_thread")]
async fn two_servers_do_not_share_a_directory() {
    let directory = tempfile::tempdir().unwrap();
    let mut first = ServerProcess::start(directory.path());
    let stderr = fails(directory.path(), ANY_PORTS);
    says(
        &stderr,
        &["is used by another waypost-server", "stop that one", directory.path().to_str().unwrap()],
    );
    assert!(first.is_running());
    assert!(first.client().await.maps().await.unwrap().is_empty());
    first.stop();
    // And the directory is free again, also after a kill.
    ServerProcess::start(directory.path()).kill();
    ServerProcess::start(directory.path()).stop();
}

#[test]
fn a_directory_that_cannot_be_used_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("a-file");
    std::fs::write(&file, b"x").unwrap();
    let below = file.join("data");
    // The kernel's own tree takes no files, not even from root.
    for unusable in [file.as_path(), below.as_path(), Path::new("/proc/waypost")] {
        let stderr = fails(unusable, ANY_PORTS);
        says(&stderr, &["cannot use the data directory", unusable.to_str().unwrap(), "may write to"]);
    }
}

#[test]
fn a_file_that_is_no_database_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let noise: Vec<u8> = (0..20_000_u32).map(|index| (index * 7919 % 251) as u8).collect();
    std::fs::write(directory.path().join("waypost.sqlite"), &noise).unwrap();
    let stderr = fails(directory.path(), ANY_PORTS);
    says(&stderr, &["waypost.sqlite", "restore"]);
    assert_eq!(std::fs::read(directory.path().join("waypost.sqlite")).unwrap(), noise);
}

#[test]
fn a_port_in_use_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let directory = tempfile::tempdir().unwrap();
    for (option, other) in [("--grpc-address", "--http-address"), ("--http-address", "--grpc-address")] {
        let stderr = fails(directory.path(), [option, &address, other, "127.0.0.1:0"]);
        says(&stderr, &["cannot listen on", &address, "choose another with", option]);
    }
    // It cleaned up behind itself.
    ServerProcess::start(directory.path()).stop();
}

#[test]
fn wrong_usage_is_told_apart() {
    for arguments in [&["--no-such-option"][..], &["--grpc-address", "nowhere"], &["--data-dir"]] {
        let mut command = Built::command("waypost-server");
        command.args(arguments);
        let output = run_to_its_end(command);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!output.stderr.is_empty());
    }
}
