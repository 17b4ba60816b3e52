//! Bits that rot on the disk: what is damaged is named and not handed out, its map takes nothing more, and all else goes on.

mod flips;
mod notes;
mod old_databases;
mod repair;

use std::io::Cursor;
use std::path::Path;

use sqlx::{AssertSqlSafe, ConnectOptions, Connection};
use waypost_client::{Client, Code, FrameInput, FrameOutcome, v1};

use crate::harness::{
    Server, answers, assert_status, database_options, first_return, frame, get, import_model, in_time,
    map_request, model_file, model_of_other_words, refused, session_options, take_model,
};

/// What the robot calls frames of the session `first`.
fn note(sequence: u64) -> String {
    format!("camera-{sequence:06}.jpg")
}

fn noted(sequence: u64) -> FrameInput {
    FrameInput { note: note(sequence), ..frame(sequence) }
}

/// A directory with the maps `drive` and `spare`.
async fn two_maps() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    for map in ["drive", "spare"] {
        client.create_map(map_request(map, &model.name)).await.unwrap();
    }
    answers(&client, "drive", "first", (1..=20).map(noted)).await;
    let again = first_return();
    answers(&client, "drive", "second", (again..again + 12).map(frame)).await;
    answers(&client, "spare", "only", (1..=5).map(frame)).await;
    server.stop().await;
    directory
}

async fn sql(directory: &Path, statement: &str) {
    let mut database = database_options(directory).connect().await.unwrap();
    let done = sqlx::query(AssertSqlSafe(statement.to_owned())).execute(&mut database).await.unwrap();
    assert!(done.rows_affected() > 0, "{statement} changed nothing");
    database.close().await.unwrap();
}

/// One byte of what the log has of a frame is another.
const ROTTEN_FRAME: &str = "UPDATE log SET event = CAST(substr(event, 1, 40) || \
     (CASE hex(substr(event, 41, 1)) WHEN '00' THEN x'01' ELSE x'00' END) || substr(event, 42) AS BLOB) \
     WHERE map_id = (SELECT id FROM maps WHERE name = 'drive') AND session = 0 AND sequence = 7";

/// Flips a bit of the file where `bytes` lie in it.
fn flip_at(directory: &Path, bytes: &[u8]) {
    let file = directory.join("waypost.sqlite");
    let mut content = std::fs::read(&file).unwrap();
    let at = content.windows(bytes.len()).position(|window| window == bytes).expect("it is in the file");
    content[at] ^= 1;
    std::fs::write(&file, content).unwrap();
}

async fn deep(directory: &Path) -> Vec<String> {
    let findings = waypost_server::offline::check_all(directory).await.unwrap();
    findings.into_iter().filter_map(|finding| finding.result.err()).collect()
}

async fn export(client: &Client, map: &str) -> Result<u64, waypost_client::Error> {
    in_time(client.export_map(map, &mut Vec::new())).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rotten_frame_is_named_and_its_map_takes_nothing_more() {
    let directory = two_maps().await;
    assert_eq!(deep(directory.path()).await, [""; 0]);
    sql(directory.path(), ROTTEN_FRAME).await;
    let found = deep(directory.path()).await;
    assert!(found.len() == 1 && found[0].contains("map drive, session first, frame 7:"), "{found:?}");

    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let (code, message) = refused(client.frame("maps/drive/sessions/first/frames/7").await);
    assert_status("the frame", (code, &message), Code::DataLoss, "map drive, session first, frame 7");
    assert_status("the frame", (code, &message), Code::DataLoss, "check --deep");
    // All that is whole is served.
    client.frame("maps/drive/sessions/first/frames/8").await.unwrap();
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.frames, 32);
    assert_eq!(client.frames("maps/spare/sessions/only").await.unwrap().len(), 5);

    watches_end(&server, &client).await;
    takes_nothing_more(&client).await;
    assert_eq!(answers(&client, "spare", "later", (1..=3).map(frame)).await.len(), 3);
    let (code, message) = refused(export(&client, "drive").await);
    assert_status("export", (code, &message), Code::DataLoss, "session first, frame 7");
    assert!(export(&client, "spare").await.unwrap() > 0);
    server.stop().await;

    // It is remembered, and the map can be taken away.
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    takes_nothing_more(&client).await;
    client.delete_map("drive").await.unwrap();
    server.stop().await;
}

/// Whoever watches the map is told of the damage; frames behind it are told.
async fn watches_end(server: &Server, client: &Client) {
    let mut watch = client.watch_map("drive", Some(0)).await.unwrap();
    let (code, message) = refused(in_time(watch.next()).await);
    assert_status("a watch", (code, &message), Code::DataLoss, "session first, frame 7");
    let sent = get(server, "/v1/maps/drive/events?from_position=0").await;
    let text = sent.text();
    assert!(text.contains("event: error") && text.contains("\"data_loss\""), "{text}");
    assert!(text.contains("session first, frame 7"), "{text}");
    let position = 8;
    let mut behind = client.watch_map("drive", Some(position)).await.unwrap();
    match in_time(behind.next()).await.unwrap().event {
        Some(v1::map_event::Event::Frame(frame)) => assert_eq!(frame.position, position),
        other => panic!("{other:?}"),
    }
}

async fn takes_nothing_more(client: &Client) {
    let opened = client.open_session(session_options("drive", "third")).await;
    let (code, message) = refused(opened.map(drop));
    assert_status("a session", (code, &message), Code::FailedPrecondition, "session first, frame 7");
    let labelled = client.set_label("maps/drive/places/0", "hall", v1::LabelScope::Place).await;
    let (code, message) = refused(labelled);
    assert_status("a label", (code, &message), Code::FailedPrecondition, "takes nothing more");
    // A session that is there may be asked for what it has, and gets no frame more.
    let (mut sender, mut outcomes) =
        client.open_session(session_options("drive", "first")).await.unwrap().split();
    sender.send(frame(20)).await.unwrap();
    match in_time(outcomes.next()).await.unwrap() {
        Some(FrameOutcome::Answer(answer)) => assert!(answer.resent),
        other => panic!("{other:?}"),
    }
    sender.send(frame(21)).await.unwrap();
    let (code, message) = refused(in_time(outcomes.next()).await);
    assert_status("a frame", (code, &message), Code::FailedPrecondition, "takes nothing more");
}

#[tokio::test(flavor = "multi_thread")]
async fn events_that_are_gone_or_changed_places_show() {
    const DRIVE: &str = "map_id = (SELECT id FROM maps WHERE name = 'drive')";
    for (change, told) in [
        (format!("DELETE FROM log WHERE {DRIVE} AND position = 10"), "event 10 of the log is gone"),
        (
            format!(
                "UPDATE log SET (event, checksum, chain) = (SELECT event, checksum, chain FROM log WHERE {DRIVE} \
                 AND position = 12) WHERE {DRIVE} AND position = 11"
            ),
            "session first, frame 11",
        ),
        (
            format!("UPDATE log SET chain = chain + 1 WHERE {DRIVE} AND position = 9"),
            "does not follow the event before it",
        ),
        (
            format!("UPDATE log SET place = place + 1 WHERE {DRIVE} AND position = 9"),
            "the log's columns are not those of the event",
        ),
        (
            format!("DELETE FROM sessions WHERE {DRIVE} AND number = 1"),
            "its sessions are not those of its log",
        ),
        (
            format!("UPDATE frame_media SET position = 900 WHERE {DRIVE} AND position = 9"),
            "of a frame that is none",
        ),
        (
            format!("UPDATE frame_notes SET position = 900 WHERE {DRIVE} AND position = 9"),
            "the note \"camera-000009.jpg\" is of a frame that is none",
        ),
    ] {
        let directory = two_maps().await;
        sql(directory.path(), &change).await;
        let found = deep(directory.path()).await;
        assert!(
            found.iter().any(|line| line.contains("map drive") && line.contains(told)),
            "{change}: {found:?}"
        );
        assert!(!found.iter().any(|line| line.contains("spare")), "{change}: {found:?}");
        let beside = ["SET place", "sessions", "frame_media", "frame_notes"];
        let chained = !beside.iter().any(|beside| change.contains(beside));
        if chained {
            let server = Server::start_on(directory.path()).await;
            let (code, message) = refused(export(&server.client().await, "drive").await);
            assert_status(&change, (code, &message), Code::DataLoss, "map drive");
            server.stop().await;
        }
    }
}

/// Nobody exports it: who goes on with the map hears of it, and nothing is added to what rests on a gap.
#[tokio::test(flavor = "multi_thread")]
async fn a_map_whose_log_has_lost_an_event_takes_nothing_more() {
    for position in ["10", "(SELECT max(position) FROM log AS l WHERE l.map_id = log.map_id)"] {
        let directory = two_maps().await;
        let drive = "map_id = (SELECT id FROM maps WHERE name = 'drive')";
        sql(directory.path(), &format!("DELETE FROM log WHERE {drive} AND position = {position}")).await;
        let server = Server::start_on(directory.path()).await;
        let client = server.client().await;
        let found = in_time(async {
            let (mut sender, mut outcomes) =
                client.open_session(session_options("drive", "third")).await?.split();
            for sequence in 1..=20 {
                sender.send(frame(sequence)).await?;
                outcomes.next().await?;
            }
            Ok(())
        });
        let (code, message) = refused(found.await);
        assert!(matches!(code, Code::DataLoss | Code::FailedPrecondition), "{position}: {code:?} {message}");
        assert!(message.contains("of the log is gone"), "{position}: {message}");
        answers(&client, "spare", "only", (6..=8).map(frame)).await;
        server.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_kept_of_a_frame_is_named() {
    let directory = two_maps().await;
    let mut database = database_options(directory.path()).connect().await.unwrap();
    let select = "SELECT content FROM frame_media JOIN maps ON maps.id = map_id \
                  WHERE name = 'drive' AND position = 7 AND kind = 'features'";
    let features: Vec<u8> = sqlx::query_scalar(select).fetch_one(&mut database).await.unwrap();
    database.close().await.unwrap();
    flip_at(directory.path(), features.last_chunk::<24>().unwrap());
    let found = deep(directory.path()).await;
    let named = "map drive, session first, frame 7, its features: a part of the database is damaged";
    assert!(found.iter().any(|line| line.contains(named)), "{found:?}");
    assert!(found.iter().all(|line| line.lines().count() == 1), "{found:?}");

    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let (code, message) = refused(client.frame_picture("maps/drive/sessions/first/frames/7", None).await);
    assert_status("a picture", (code, &message), Code::DataLoss, "session first, frame 7");
    // Nor is anybody told to ask again.
    let (code, message) =
        refused(client.explain_frame("maps/drive/sessions/first/frames/7", None, None).await);
    assert_status("an explanation", (code, &message), Code::DataLoss, "check --deep");
    server.stop().await;
}

/// A model whose file is damaged keeps its name: whoever renames it would write the damage anew, with a right checksum.
#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_model_is_not_renamed() {
    let directory = two_maps().await;
    let model = std::fs::read(model_file()).unwrap();
    let middle = model.len() / 2;
    flip_at(directory.path(), &model[middle..middle + 24]);
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let before = client.models().await.unwrap();
    let (code, message) = refused(client.rename_model(&before[0].name, "other").await);
    assert_status("renaming", (code, &message), Code::DataLoss, "damaged");
    assert_eq!(client.models().await.unwrap(), before);
    server.stop().await;
    let found = deep(directory.path()).await;
    let named = before[0].name.strip_prefix("models/").unwrap();
    assert!(found.iter().any(|line| line.contains(&format!("the model {named}"))), "{found:?}");
}

/// The program has the model that ships, too; another one is named, and whoever brings it again is not told that it is there.
#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_model_is_named_and_the_one_that_ships_is_taken_from_the_program() {
    let directory = two_maps().await;
    let own = model_of_other_words();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let imported = take_model(&client, "own", &own).await;
    client.create_map(map_request("own", &imported.name)).await.unwrap();
    server.stop().await;
    // Both have the same words.
    let shipped = std::fs::read(model_file()).unwrap();
    let quarter = &shipped[shipped.len() / 4..][..24];
    let file = directory.path().join("waypost.sqlite");
    let mut content = std::fs::read(&file).unwrap();
    let found: Vec<usize> = (0..content.len() - 24).filter(|&at| &content[at..at + 24] == quarter).collect();
    assert_eq!(found.len(), 2, "one in each model");
    for at in found {
        content[at] ^= 1;
    }
    std::fs::write(&file, content).unwrap();

    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(answers(&client, "drive", "third", (1..=3).map(frame)).await.len(), 3);
    let named = format!("the model {}", imported.name.strip_prefix("models/").unwrap());
    let (code, message) = refused(client.open_session(session_options("own", "first")).await.map(drop));
    assert_status("a robot", (code, &message), Code::DataLoss, &named);
    let again = client.import_model("own", Cursor::new(own.to_bytes())).await;
    let (code, message) = refused(again);
    assert_status("it is brought again", (code, &message), Code::DataLoss, &named);
    assert!(message.contains("A backup has it") && !message.contains("snapshot"), "{message}");
    server.stop().await;
}
