//! What a mistaken command says; a command that is refused has done nothing.

use std::process::Output;

use crate::harness::{Built, CommandLine, folder, path, run_to_its_end};

#[test]
fn a_command_that_cannot_write_its_file_asks_the_server_for_nothing() {
    let waypost = CommandLine::new();
    waypost.prepare();
    waypost.text(&["map", "create", "other", "--model", "shipped"]);
    let images = folder(2);
    let folder = tempfile::tempdir().unwrap();
    let there = folder.path().join("there");
    std::fs::write(&there, b"precious").unwrap();
    let nowhere = folder.path().join("nowhere/new.svg");
    let stream = ["stream", path(images.path()), "--map", "drive", "--session", "robot"];
    let merge = ["map", "merge", "drive", "other", "--into", "both"];
    let before = waypost.json(&["map", "ls"]);
    for (command, option) in [
        (&merge[..], Some("--picture")),
        (&["merge", "show", "merges/1"], Some("--picture")),
        (&["explain", "drive", "robot", "1"], Some("--picture")),
        (&stream[..], Some("--csv")),
        (&["map", "export", "drive"], None),
        (&["model", "export", "shipped"], None),
        (&["map", "graph", "drive"], Some("--out")),
    ] {
        for (file, fragment) in [
            (&there, "is there already; choose another file, or replace it with --force"),
            (&nowhere, "there is no folder"),
        ] {
            let output = [command, option.as_slice(), &[path(file)]].concat();
            let (code, said) = waypost.fails(&output);
            assert_eq!(code, 1, "{output:?}: {said}");
            assert!(said.contains(fragment), "{output:?}: {said}");
        }
    }
    assert_eq!(std::fs::read(&there).unwrap(), b"precious");
    assert_eq!(waypost.json(&["map", "ls"]), before);
    assert_eq!(waypost.json(&["merge", "ls"])["merges"].as_array().unwrap().len(), 0);
    assert_eq!(waypost.json(&["session", "ls", "drive"])["sessions"].as_array().unwrap().len(), 0);
}

#[test]
fn a_demo_without_a_server_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Built::command("waypost");
    command.args(["demo", "--server-binary", "no-such-server"]).current_dir(folder.path());
    let output = run_to_its_end(command);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("there is no server no-such-server; name the program with --server-binary"),
        "{said}"
    );
    assert_eq!(folder.path().read_dir().unwrap().count(), 0, "a folder is left");
}

#[test]
fn a_server_without_tls_is_told_from_one_that_is_not_there() {
    let waypost = CommandLine::new();
    let encrypted = waypost.endpoint().replace("http://", "https://");
    let mut command = Built::command("waypost");
    command.args(["map", "ls", "--server", &encrypted]);
    let output = run_to_its_end(command);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(3) && said.contains("speaks no TLS: name it with http://"),
        "{said}"
    );
}

#[test]
fn a_wrong_token_is_refused_with_the_way_to_a_right_one() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let images = folder(1);
    let created = waypost.json(&["token", "create", "operator", "--role", "admin"]);
    let admin = created["secret"].as_str().unwrap();
    for wrong in ["nonsense", &admin[..admin.len() - 1]] {
        for command in [
            &["map", "create", "hall"][..],
            &["stream", path(images.path()), "--map", "drive"],
            &["token", "rm", "operator", "--yes"],
        ] {
            let (code, said) = waypost.fails(&[command, &["--token", wrong]].concat());
            assert_eq!(code, 4, "{command:?}: {said}");
            let known = "this token is not known here: it was deleted, or is of another server, or not whole";
            assert!(said.contains(known), "{command:?}: {said}");
            assert!(said.contains("ask who runs the server for a new one"), "{command:?}: {said}");
            assert!(!said.contains(wrong), "a secret is told: {said}");
        }
    }
    // One that was copied with the line after it.
    let (code, said) = waypost.fails(&["map", "ls", "--token", "non\nsense"]);
    assert_eq!(code, 2, "{said}");
    assert!(said.contains("the token has characters that no token has; copy it again"), "{said}");
    for (list, of, there) in [
        (&["map", "ls"][..], "maps", 1),
        (&["session", "ls", "drive"], "sessions", 0),
        (&["token", "ls"], "tokens", 1),
    ] {
        let listed = waypost.json(&[list, &["--token", admin]].concat());
        assert_eq!(listed[of].as_array().unwrap().len(), there, "{listed}");
    }
}

#[test]
fn shells_and_man_know_every_command() {
    let run = |arguments: &[&str]| {
        let mut command = Built::command("waypost");
        command.args(arguments);
        let Output { status, stdout, stderr } = run_to_its_end(command);
        (status.code().unwrap(), [stdout, stderr].map(|said| String::from_utf8(said).unwrap()))
    };
    for shell in ["bash", "zsh", "fish"] {
        let (code, [script, said]) = run(&["completions", shell]);
        assert_eq!((code, said.as_str()), (0, ""));
        assert!(script.contains("navigate") && script.contains("to-label"), "{shell}");
    }
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man1");
    assert_eq!(run(&["man", path(&pages)]), (0, [String::new(), String::new()]));
    let page = std::fs::read_to_string(pages.join("waypost-map-create.1")).unwrap();
    assert!(page.contains("place\\-spacing\\-m"), "{page}");
    assert!(pages.join("waypost.1").is_file() && pages.join("waypost-stream.1").is_file());
    let (code, [_, said]) = run(&["man", path(&pages)]);
    assert!(code == 1 && said.contains("--force"), "{said}");
}
