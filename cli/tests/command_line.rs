//! The command line where it needs no server: exit codes, and errors that say what to do.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

use std::path::Path;
use std::process::{Command, Output};

use tokio::net::TcpSocket;

fn waypost(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_waypost"))
        .env_remove("WAYPOST_SERVER")
        .args(arguments)
        .output()
        .expect("the command line is built")
}

/// Exit code and stderr; nothing may be on stdout.
fn failed(arguments: &[&str]) -> (i32, String) {
    let output = waypost(arguments);
    assert_eq!(String::from_utf8(output.stdout).unwrap(), "", "{arguments:?}");
    (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
}

/// An address that nobody listens at, and nobody else gets while the socket is kept.
fn nowhere() -> (String, TcpSocket) {
    let socket = TcpSocket::new_v4().unwrap();
    socket.bind(([127, 0, 0, 1], 0).into()).unwrap();
    (format!("http://{}", socket.local_addr().unwrap()), socket)
}

fn images(folder: &Path, count: usize) {
    for index in 0..count {
        std::fs::write(folder.join(format!("{index:06}.jpg")), b"not looked at here").unwrap();
    }
}

#[test]
fn an_unreachable_server_is_code_3() {
    let folder = tempfile::tempdir().unwrap();
    images(folder.path(), 1);
    let dir = folder.path().to_str().unwrap();
    let commands: [&[&str]; 5] = [
        &["map", "ls"],
        &["map", "ls", "--json"],
        &["model", "show", "abcdef"],
        &["model", "train", "--images", dir, "--words", "100"],
        &["stream", dir, "--map", "office"],
    ];
    for command in commands {
        let (server, _port) = nowhere();
        let (code, stderr) = failed(&[command, &["--server", &server]].concat());
        assert_eq!(code, 3, "{command:?}: {stderr}");
        assert!(stderr.contains(&server) && stderr.contains("check that waypost-server runs"), "{stderr}");
    }
}

#[test]
fn the_address_may_come_from_the_environment() {
    let (server, _port) = nowhere();
    let output = Command::new(env!("CARGO_BIN_EXE_waypost"))
        .env("WAYPOST_SERVER", &server)
        .args(["map", "ls"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(3));
    assert!(String::from_utf8(output.stderr).unwrap().contains(&server));
}

#[test]
fn wrong_usage_is_code_2() {
    let commands: [&[&str]; 6] = [
        &["map"],
        &["map", "create", "office", "--model", "m", "--dependence", "blind"],
        &["model", "train", "--images", "x", "--words", "1"],
        &["stream", "x", "--map", "office", "--rate", "0"],
        &["stream", "x", "--map", "office", "--rate", "nan"],
        &["map", "ls", "--server", "ftp://127.0.0.1:7600"],
    ];
    for command in commands {
        let (code, stderr) = failed(command);
        assert_eq!(code, 2, "{command:?}: {stderr}");
    }
}

#[test]
fn a_missing_folder_is_named() {
    for command in [
        &["stream", "no/such/folder", "--map", "office"][..],
        &["model", "train", "--words", "9", "--images", "no/such/folder"],
    ] {
        let (code, stderr) = failed(command);
        assert_eq!(
            (code, stderr.as_str()),
            (1, "waypost: there is no folder no/such/folder; check the path\n")
        );
    }
}

#[test]
fn odometry_has_to_fit_the_images() {
    let folder = tempfile::tempdir().unwrap();
    images(folder.path(), 2);
    let odometry = folder.path().join("odometry.csv");
    let arguments = ["stream", folder.path().to_str().unwrap(), "--map", "office", "--odometry"];
    let stream = || failed(&[&arguments[..], &[odometry.to_str().unwrap()]].concat());

    std::fs::write(&odometry, "stamp_ns,x_m,y_m,yaw_rad\n1,0,0,0\n").unwrap();
    let (code, stderr) = stream();
    assert_eq!(code, 1);
    assert!(
        stderr.contains(
            "has 1 poses for 2 images that have no stamps to join them by; write one row per image"
        ),
        "{stderr}"
    );

    std::fs::write(&odometry, "stamp_ns,x_m,y_m,yaw_rad\n1,0,0,0\n2,0,wheel,0\n").unwrap();
    let (code, stderr) = stream();
    assert_eq!(code, 1);
    assert!(stderr.contains("odometry.csv: line 3: `wheel` is no number for y_m"), "{stderr}");

    std::fs::remove_file(&odometry).unwrap();
    let (code, stderr) = stream();
    assert_eq!(code, 1);
    assert!(stderr.contains("cannot read") && stderr.contains("odometry.csv"), "{stderr}");
}

#[test]
fn a_demo_without_its_files_or_server_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let keep_data = folder.path().join("kept");
    let arguments =
        ["demo", "--data", folder.path().to_str().unwrap(), "--keep-data", keep_data.to_str().unwrap()];
    let (code, stderr) = failed(&arguments);
    assert_eq!(code, 1);
    assert!(stderr.contains("loops.csv"), "{stderr}");

    let sequence = folder.path().join("sequence");
    std::fs::create_dir(&sequence).unwrap();
    images(&sequence, 1);
    std::fs::write(sequence.join("loops.csv"), "query_index,match_index\n").unwrap();
    std::fs::write(folder.path().join("model.waypost"), b"").unwrap();
    let (code, stderr) = failed(&[&arguments[..], &["--server-binary", "no/such/server", "--json"]].concat());
    assert_eq!(code, 1);
    assert!(stderr.contains("there is no server no/such/server; name the program"), "{stderr}");
}

/// What somebody gives is used, or refused with the way to what they want.
#[test]
fn commands_that_use_no_server_refuse_options_about_one() {
    let (server, _port) = nowhere();
    for (command, option, fragment) in [
        (&["demo"][..], &["--server", &server][..], "`waypost simulate`"),
        (&["demo", "--world", "office"], &["--token", "secret"], "starts a server of its own"),
        (&["inspect", "drive.mcap"], &["--ca", "ca.pem"], "shown without a server"),
        (&["completions", "bash"], &["--server", &server], "without a server"),
        (&["man", "pages"], &["--client-key", "key.pem"], "without a server"),
    ] {
        for arguments in [[option, command].concat(), [command, option].concat()] {
            let (code, stderr) = failed(&arguments);
            assert_eq!(code, 2, "{arguments:?}: {stderr}");
            let named = format!("{} is not used here", option[0]);
            assert!(stderr.contains(&named) && stderr.contains(fragment), "{arguments:?}: {stderr}");
        }
    }
    // The environment is for all commands: they go their ways, and a demo says so.
    let output = Command::new(env!("CARGO_BIN_EXE_waypost"))
        .env("WAYPOST_SERVER", &server)
        .args(["demo", "--data", "no/such/folder"])
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("the server of the environment is not used: a demo starts"), "{stderr}");
    let output = Command::new(env!("CARGO_BIN_EXE_waypost"))
        .env("WAYPOST_SERVER", &server)
        .args(["completions", "bash"])
        .output();
    assert!(output.unwrap().stderr.is_empty());
}

#[test]
fn help_tells_exit_codes_and_formats() {
    let help = |arguments: &[&str]| {
        let output = waypost(arguments);
        assert!(output.status.success());
        String::from_utf8(output.stdout).unwrap()
    };
    assert!(help(&["--help"]).contains("3  the server was not reached"));
    let stream = help(&["stream", "--help"]);
    assert!(stream.contains("stamp_ns,x_m,y_m,yaw_rad") && stream.contains("Exit codes"), "{stream}");
}
