//! Backups while robots stream, and data directories made of them.

use std::net::TcpListener;
use std::path::Path;
use std::process::Output;

use waypost_client::{FrameOutcome, v1};

use crate::harness::{
    Built, ServerProcess, answers, frame, import_model, in_time, map_request, run_to_its_end, session_options,
};

/// Runs `waypost-server` on a data directory; its exit code and all that it says.
fn run(data: &Path, arguments: &[&str]) -> (i32, String) {
    run_at("127.0.0.1:0", data, arguments)
}

/// The same, of a server that robots are to find at an address.
fn run_at(grpc_address: &str, data: &Path, arguments: &[&str]) -> (i32, String) {
    let mut command = Built::command("waypost-server");
    let ports = ["--grpc-address", grpc_address, "--http-address", "127.0.0.1:0"];
    command.args(["--data-dir", data.to_str().unwrap()]).args(ports).args(arguments);
    let Output { status, stdout, stderr } = run_to_its_end(command);
    let said = format!("{}{}", String::from_utf8(stdout).unwrap(), String::from_utf8(stderr).unwrap());
    assert!(!said.contains("panicked"), "{said}");
    (status.code().expect("no signal ended it"), said)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_made_while_a_robot_streams_is_whole_and_restored_by_one_command() {
    const FRAMES: u64 = 60;
    let (data, target, restored) =
        (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let backup = target.path().join("monday");
    let server = ServerProcess::start(data.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    let (mut sender, mut outcomes) =
        client.open_session(session_options("drive", "robot")).await.unwrap().split();
    let sending = tokio::spawn(async move {
        for sequence in 1..=FRAMES {
            sender.send(frame(sequence)).await.unwrap();
        }
    });
    let mut answered = Vec::new();
    let mut backing_up = None;
    while let Some(outcome) = in_time(outcomes.next()).await.unwrap() {
        let FrameOutcome::Answer(answer) = outcome else { panic!("{outcome:?}") };
        answered.push(answer);
        if answered.len() == 10 {
            let (data, backup) = (data.path().to_owned(), backup.clone());
            let made = move || run(&data, &["backup", backup.to_str().unwrap()]);
            backing_up = Some(tokio::task::spawn_blocking(made));
        }
    }
    sending.await.unwrap();
    let (code, said) = in_time(backing_up.unwrap()).await.unwrap();
    assert_eq!(code, 0, "{said}");
    assert!(said.contains("ok     contents: 1 models and 1 maps"), "{said}");
    // A copy is looked at beside the server whose address is taken.
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let (code, said) = run_at(&address, &backup, &["check", "--deep"]);
    assert!(code == 0 && said.contains("ok     contents: "), "{said}");
    let (code, said) = run_at(&address, &backup, &["check"]);
    assert!(code != 0 && said.contains("`check --deep`, which leaves addresses out"), "{said}");
    // Nothing is overwritten, on either side.
    let (code, said) = run(data.path(), &["backup", backup.to_str().unwrap()]);
    assert!(code != 0 && said.contains("move it away first"), "{said}");
    let (code, said) = run(data.path(), &["restore", backup.to_str().unwrap()]);
    assert!(code != 0 && said.contains("used by another waypost-server"), "{said}");
    server.stop();
    let (code, said) = run(data.path(), &["restore", backup.to_str().unwrap()]);
    assert!(code != 0 && said.contains("move it away first"), "{said}");

    let (code, said) = run(restored.path(), &["restore", backup.to_str().unwrap()]);
    assert_eq!(code, 0, "{said}");
    let server = ServerProcess::start(restored.path());
    let client = server.client().await;
    let kept = client.map("drive", v1::MapView::Basic).await.unwrap().frames;
    assert!((10..=FRAMES).contains(&kept), "{kept} frames were kept");
    // What was answered by then is answered alike, and the rest comes to what it came to before.
    let again = answers(&client, "drive", "robot", (1..=FRAMES).map(frame)).await;
    for (before, after) in answered.iter().zip(&again) {
        assert_eq!(after.resent, after.sequence <= kept);
        let decided = |answer: &v1::FrameAnswer| (answer.sequence, answer.reason, answer.place_number);
        assert_eq!(decided(before), decided(after));
    }
    server.stop();
    let (code, said) = run(restored.path(), &["check", "--deep"]);
    assert_eq!(code, 0, "{said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_backup_is_not_restored() {
    let (data, target, restored) =
        (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let server = ServerProcess::start(data.path());
    import_model(&server.client().await).await;
    server.stop();
    let backup = target.path().join("monday");
    assert_eq!(run(data.path(), &["backup", backup.to_str().unwrap()]).0, 0);
    let file = backup.join("waypost.sqlite");
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    std::fs::write(&file, bytes).unwrap();
    let (code, said) = run(restored.path(), &["restore", backup.to_str().unwrap()]);
    assert!(code != 0 && said.contains("is damaged"), "{said}");
    assert!(!restored.path().join("waypost.sqlite").exists());
    let (code, said) = run(&backup, &["check", "--deep"]);
    assert!(code != 0 && said.contains("wrong  contents: "), "{said}");
    // Nor is one made of what is damaged: nothing is left of it.
    let of_it = target.path().join("tuesday");
    let (code, said) = run(&backup, &["backup", of_it.to_str().unwrap()]);
    assert!(code != 0 && said.contains("`waypost-server check --deep` tells which"), "{said}");
    assert_eq!(std::fs::read_dir(&of_it).unwrap().count(), 0);
    // A name with a typo: it is told, and nothing is made of it.
    let typo = target.path().join("munday");
    for (arguments, expected) in [
        (&["check", "--deep"][..], "there is no data directory "),
        (&["backup", of_it.to_str().unwrap()], " holds no database; name the data directory of a server"),
    ] {
        let (code, said) = run(&typo, arguments);
        assert!(code == 1 && said.contains(expected), "{said}");
        assert!(!typo.exists(), "{arguments:?} made it");
    }
    let (code, said) = run(restored.path(), &["restore", typo.to_str().unwrap()]);
    assert!(code == 1 && said.contains("holds no backup") && !typo.exists(), "{said}");
    // A directory without one.
    let (code, said) = run(restored.path(), &["restore", data.path().join("nothing").to_str().unwrap()]);
    assert!(code != 0 && said.contains("holds no backup"), "{said}");
}
