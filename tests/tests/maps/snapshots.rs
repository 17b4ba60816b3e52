//! Maps out and in as one file, and large maps taken away.

mod bad_files;
mod file;
mod interrupted;
mod removal;
mod versions;

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use sqlx::{AssertSqlSafe, Connection, Row};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;
use waypost_client::{Client, Code, FrameOutcome, v1};
use waypost_proto::v1::map_service_client::MapServiceClient;

use crate::harness::{
    Built, RawStream, Server, ServerProcess, answers, assert_status, channel, first_return, followed, frame,
    images, import_model, in_time, map_request, open, reference, refused, run_to_its_end, said,
    session_options, state_hash, tables, wire, workspace,
};

/// Snapshots of the format's versions. From the second on they have labels.
const VERSION_1: &str = "tests/tests/fixtures/map-v1.snapshot";
const VERSION_2: &str = "tests/tests/fixtures/map-v2.snapshot";
const VERSION_3: &str = "tests/tests/fixtures/map-v3.snapshot";

/// State hashes of the maps in them.
const VERSION_1_STATE: &str = include_str!("../fixtures/map-v1.state-hash").trim_ascii();
const VERSION_2_STATE: &str = include_str!("../fixtures/map-v2.state-hash").trim_ascii();
const VERSION_3_STATE: &str = include_str!("../fixtures/map-v3.state-hash").trim_ascii();

/// What people call places from the second on.
const LABELS: [(&str, &str); 2] = [("maps/fixture/places/0", "kitchen"), ("maps/fixture/places/1", "Küche")];

async fn export(client: &Client, map: &str) -> Vec<u8> {
    let mut file = Vec::new();
    let length = in_time(client.export_map(map, &mut file)).await.unwrap();
    assert_eq!(length, file.len() as u64);
    file
}

/// Imports a snapshot and waits; the job as it ended.
async fn import(client: &Client, name: &str, file: Vec<u8>) -> Result<v1::Job, waypost_client::Error> {
    let job = in_time(client.import_map(name, Cursor::new(file))).await?;
    assert_eq!(job.kind(), v1::job::Kind::ImportMap);
    Ok(followed(client, &job).await.pop().unwrap())
}

/// Imports a snapshot that is taken.
async fn imported(client: &Client, name: &str, file: Vec<u8>) -> v1::Job {
    let job = import(client, name, file).await.unwrap();
    assert_eq!(job.state(), v1::job::State::Succeeded, "{job:?}");
    assert_eq!(job.fraction, 1.0);
    job
}

async fn sql(directory: &Path, statement: &str) {
    let mut database = tables(directory).await;
    let done = sqlx::query(AssertSqlSafe(statement.to_owned())).execute(&mut database).await.unwrap();
    assert!(done.rows_affected() > 0, "{statement} changed nothing");
    database.close().await.unwrap();
}

/// Rows of all tables that maps fill, one after the other.
async fn rows(directory: &Path) -> Vec<(&'static str, i64)> {
    let mut database = tables(directory).await;
    let mut rows = Vec::new();
    for table in [
        "maps",
        "models",
        "sessions",
        "log",
        "frame_media",
        "frame_notes",
        "map_models",
        "labels",
        "checkpoints",
        "checkpoint_sessions",
        "checkpoint_links",
        "checkpoint_blocks",
        "checkpoint_places",
    ] {
        let count = format!("SELECT count(*) FROM {table}");
        let row = sqlx::query(AssertSqlSafe(count)).fetch_one(&mut database).await.unwrap();
        rows.push((table, row.get(0)));
    }
    database.close().await.unwrap();
    rows
}

/// Waits until the background has left just these rows.
async fn rows_become(directory: &Path, expected: &[(&'static str, i64)]) {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        let now = rows(directory).await;
        if now == expected {
            return;
        }
        assert!(Instant::now() < deadline, "{now:?} does not become {expected:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// A former model, as if the maps had been bound to another one.
async fn bound_before(directory: &Path) {
    sql(directory, "INSERT INTO map_models SELECT id, 3, model FROM maps").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_comes_back_as_it_was_and_goes_on() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "first", (1..=20).map(frame)).await;
    let again = first_return();
    let stored = answers(&client, "drive", "second", (again..again + 10).map(frame)).await;
    bound_before(server.directory()).await;
    for (place, label) in [(0, "hall"), (1, "Küche"), (2, "hall")] {
        let place = format!("maps/drive/places/{place}");
        client.set_label(&place, label, v1::LabelScope::Place).await.unwrap();
    }
    let labels = client.labels("drive").await.unwrap();
    assert_eq!(labels.len(), 3);
    let file = export(&client, "drive").await;
    assert!(export(&client, "maps/drive").await == file, "two snapshots of one state differ");
    let map = client.map("drive", v1::MapView::Full).await.unwrap();

    // On a server that has nothing.
    let elsewhere = Server::start().await;
    let there = elsewhere.client().await;
    let job = imported(&there, "", file.clone()).await;
    assert_eq!(job.result.as_deref(), Some("maps/drive"));
    // Opening a map that came with its log alone has written a checkpoint; the rest weighs what it weighed.
    let v1::MapStorage { checkpoint_bytes, bytes_per_frame, .. } =
        there.map("drive", v1::MapView::Full).await.unwrap().storage.unwrap();
    let storage = v1::MapStorage { checkpoint_bytes, bytes_per_frame, ..map.storage.unwrap() };
    let expected = v1::Map { storage: Some(storage), ..map.clone() };
    assert_eq!(there.map("drive", v1::MapView::Full).await.unwrap(), expected);
    assert_eq!(there.places("drive").await.unwrap(), client.places("drive").await.unwrap());
    assert_eq!(there.loop_closures("drive").await.unwrap(), client.loop_closures("drive").await.unwrap());
    assert_eq!(there.models().await.unwrap()[0].display_name, "shipped");
    assert_eq!(there.labels("drive").await.unwrap(), labels);
    assert!(export(&there, "drive").await == file, "the snapshot of the imported map differs");

    // A session goes on: the stored answers, then new ones, as at home.
    let next = again + 10;
    let mut decided = Vec::new();
    for server in [&server, &elsewhere] {
        let (mut raw, opened) = RawStream::open(&server.endpoint(), open("drive", "second")).await.unwrap();
        assert_eq!(opened.last_committed_sequence, Some(next - 1));
        let resent = raw.answered(wire(frame(again))).await;
        assert!(resent.resent);
        assert_eq!((resent.place_number, resent.posterior), (stored[0].place_number, stored[0].posterior));
        let fresh = raw.answered(wire(frame(next))).await;
        assert!(!fresh.resent);
        decided.push(v1::FrameAnswer { timings: None, ..fresh });
    }
    assert_eq!(decided[0], decided[1]);
    assert_eq!(state_hash(&there, "drive").await, state_hash(&client, "drive").await);

    // Beside the original, under a name of its own; the model is there already and stays.
    let models = client.models().await.unwrap();
    imported(&client, "copy", file).await;
    assert_eq!(Some(state_hash(&client, "copy").await), map.state_hash);
    assert_eq!(client.models().await.unwrap(), models);
    assert_eq!(client.maps().await.unwrap().len(), 2);
    server.stop().await;
    elsewhere.stop().await;
}

/// The point of a backup: nobody has to stop for it.
#[tokio::test(flavor = "multi_thread")]
async fn an_export_while_a_robot_streams_is_a_prefix_of_what_it_streamed() {
    const FRAMES: u64 = 60;
    let (server, client) = Server::with_map().await;
    let session = client.open_session(session_options("drive", "robot")).await.unwrap();
    let (mut sender, mut outcomes) = session.split();
    let sending = tokio::spawn(async move {
        for sequence in 1..=FRAMES {
            sender.send(frame(sequence)).await.unwrap();
        }
    });
    let mut exporting = Vec::new();
    let mut answered = 0;
    while let Some(outcome) = in_time(outcomes.next()).await.unwrap() {
        let FrameOutcome::Answer(answer) = outcome else { panic!("{outcome:?}") };
        answered += 1;
        assert_eq!(answer.sequence, answered);
        if answered % 15 == 5 {
            let client = client.clone();
            exporting.push((answered, tokio::spawn(async move { export(&client, "drive").await })));
        }
    }
    sending.await.unwrap();
    assert_eq!((answered, exporting.len()), (FRAMES, 4));
    assert_eq!(state_hash(&client, "drive").await, reference().maps[FRAMES as usize].state_hash);

    let elsewhere = Server::start().await;
    let there = elsewhere.client().await;
    for (acknowledged, file) in exporting {
        let name = format!("after-{acknowledged}");
        imported(&there, &name, file.await.unwrap()).await;
        let map = there.map(&name, v1::MapView::Full).await.unwrap();
        assert!((acknowledged..=FRAMES).contains(&map.frames), "{} of {acknowledged}", map.frames);
        let expected = &reference().maps[map.frames as usize];
        assert_eq!(
            (map.state_hash, map.places, map.links),
            (Some(expected.state_hash.clone()), expected.places, expected.links)
        );
    }
    server.stop().await;
    elsewhere.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn names_are_checked_and_kept_for_the_map_that_comes() {
    let (server, client) = Server::with_map().await;
    let file = export(&client, "drive").await;
    let cases = [
        ("taken, in the file", "", Code::AlreadyExists, "there is a map drive already; choose another name"),
        ("taken, asked for", "drive", Code::AlreadyExists, "choose another name, or delete it first"),
        ("no name", "Not A Name", Code::InvalidArgument, "is no map name; use 1 to 63"),
        ("a deleted map's", "~1", Code::InvalidArgument, "is no map name"),
    ];
    for (case, name, code, fragment) in cases {
        let (refused_with, message) = refused(import(&client, name, file.clone()).await);
        assert_status(case, (refused_with, &message), code, fragment);
    }
    let (code, message) = refused(client.export_map("nowhere", &mut Vec::new()).await);
    assert_status("no such map", (code, &message), Code::NotFound, "there is no map nowhere");

    let mut raw = MapServiceClient::new(channel(&server.endpoint()).await);
    let (uploading, receiver) = mpsc::channel(4);
    let first = v1::ImportMapRequest { map_id: Some("new".to_owned()), chunk: file[..100].to_vec() };
    uploading.send(first).await.unwrap();
    let call = tokio::spawn(async move { raw.import_map(ReceiverStream::new(receiver)).await });
    tokio::time::sleep(Duration::from_millis(300)).await;
    for (case, result) in [
        ("create", client.create_map(map_request("new", "shipped")).await.map(drop)),
        ("import", import(&client, "new", file.clone()).await.map(drop)),
    ] {
        let (code, message) = refused(result);
        assert_status(
            case,
            (code, &message),
            Code::AlreadyExists,
            "a map new is being imported or made of others; choose another",
        );
    }
    uploading
        .send(v1::ImportMapRequest { map_id: Some(String::new()), chunk: file[100..].to_vec() })
        .await
        .unwrap();
    drop(uploading);
    let job = in_time(call).await.unwrap().unwrap().into_inner();
    assert_eq!(followed(&client, &job).await.pop().unwrap().result.as_deref(), Some("maps/new"));
    let (code, _) = refused(client.create_map(map_request("new", "shipped")).await);
    assert_eq!(code, Code::AlreadyExists);
    // An upload that went away keeps no name.
    client.delete_map("new").await.unwrap();
    imported(&client, "new", file).await;
    server.stop().await;
}

/// Exports that nobody reads cost nobody else anything.
#[tokio::test(flavor = "multi_thread")]
async fn stalled_exports_are_limited_and_hold_nobody_up() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=8).map(frame)).await;
    // More than all buffers on the way can hold.
    sql(
        server.directory(),
        "INSERT INTO frame_media (map_id, position, kind, content) SELECT map_id, position, 'image', randomblob(4000000) FROM log WHERE sequence IS NOT NULL",
    )
    .await;
    let mut stalled: Vec<Streaming<v1::ExportMapResponse>> = Vec::new();
    for _ in 0..2 {
        let mut raw = MapServiceClient::new(channel(&server.endpoint()).await);
        let request = v1::ExportMapRequest { name: "maps/drive".to_owned() };
        stalled.push(in_time(raw.export_map(request)).await.unwrap().into_inner());
    }
    let (code, message) = refused(client.export_map("drive", &mut Vec::new()).await);
    assert_status(
        "a third",
        (code, &message),
        Code::ResourceExhausted,
        "2 exports are under way already; try again",
    );
    let more = in_time(answers(&client, "drive", "robot", (9..=14).map(frame))).await;
    assert_eq!(more.len(), 6);
    assert_eq!(
        in_time(client.loop_closures("drive")).await.unwrap().len() as u64,
        client.maps().await.unwrap()[0].loop_closures
    );

    // One reads on and gets the map as it was; the other goes away, and makes room.
    let mut file = Vec::new();
    while let Some(v1::ExportMapResponse { chunk }) = in_time(stalled[0].message()).await.unwrap() {
        assert!(chunk.len() <= 1 << 20);
        file.extend(chunk);
    }
    stalled.clear();
    imported(&client, "copy", file).await;
    assert_eq!(
        client.map("copy", v1::MapView::Full).await.unwrap().state_hash,
        Some(reference().maps[8].state_hash.clone())
    );
    let deadline = Instant::now() + Duration::from_secs(20);
    while client.export_map("drive", &mut Vec::new()).await.is_err() {
        assert!(Instant::now() < deadline, "an export that was given up still takes room");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stalled_export_does_not_hold_up_a_stop() {
    let directory = tempfile::tempdir().unwrap();
    let mut server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    answers(&client, "drive", "robot", (1..=8).map(frame)).await;
    sql(
        directory.path(),
        "INSERT INTO frame_media (map_id, position, kind, content) SELECT map_id, position, 'image', randomblob(4000000) FROM log WHERE sequence IS NOT NULL",
    )
    .await;
    let mut raw = MapServiceClient::new(channel(&server.endpoint()).await);
    let request = v1::ExportMapRequest { name: "maps/drive".to_owned() };
    let stalled = in_time(raw.export_map(request)).await.unwrap().into_inner();
    let stopped = server.terminate(Duration::from_secs(15));
    assert!(stopped.is_some_and(|status| status.success()), "{stopped:?}: {}", server.log());
    drop(stalled);
}

#[test]
fn maps_are_copied_on_the_command_line() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let run = |arguments: &[&str]| {
        let mut command = Built::command("waypost");
        command.args(arguments).args(["--server", &server.endpoint()]);
        run_to_its_end(command)
    };
    let json = |arguments: &[&str]| -> serde_json::Value {
        let output = run(&[arguments, &["--json"]].concat());
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let fails = |arguments: &[&str], code: i32, fragment: &str| {
        let output = run(arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
        assert!(stderr.contains(fragment) && output.stdout.is_empty(), "{arguments:?}: {stderr}");
    };
    let fixture = workspace().join(VERSION_1);
    let fixture = fixture.to_str().unwrap();
    let imported = json(&["map", "import", fixture, "--name", "hall"]);
    assert_eq!(imported["name"], "maps/hall");
    let mut shown = json(&["map", "show", "hall"]);
    assert_eq!(shown["state_hash"].take(), VERSION_1_STATE);
    assert!(shown["storage"].take().is_object(), "{shown}");
    assert_eq!(shown, imported);

    let out = tempfile::tempdir().unwrap();
    let file = out.path().join("hall.snapshot");
    let path = file.to_str().unwrap();
    let exported = json(&["map", "export", "hall", path]);
    assert_eq!((&exported["name"], &exported["file"]), (&"maps/hall".into(), &path.into()));
    assert_eq!(exported["size_bytes"].as_u64(), Some(std::fs::metadata(&file).unwrap().len()));
    fails(&["map", "export", "hall", path], 1, "replace it with --force");
    json(&["map", "export", "hall", path, "--force"]);
    fails(&["map", "export", "nowhere", path, "--force"], 4, "there is no map nowhere");
    assert_eq!(std::fs::read_dir(out.path()).unwrap().count(), 1, "something was left beside the file");

    fails(&["map", "import", path], 4, "there is a map hall already");
    fails(&["map", "import", path, "--name", "No"], 4, "is no map name");
    fails(&["map", "import", "nowhere.snapshot"], 1, "nowhere.snapshot");
    fails(
        &["map", "import", workspace().join("demo/model.waypost").to_str().unwrap()],
        4,
        "not a Waypost snapshot file",
    );
    let mut damaged = std::fs::read(&file).unwrap();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    std::fs::write(&file, damaged).unwrap();
    fails(&["map", "import", path, "--name", "copy"], 1, "the snapshot cannot be imported");
    let text = String::from_utf8(run(&["map", "import", fixture, "--name", "copy"]).stdout).unwrap();
    assert!(text.contains("maps/copy"), "{text}");
}
