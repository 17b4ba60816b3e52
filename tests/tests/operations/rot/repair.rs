//! A damaged map is made anew from what is left of it.

use std::io::Cursor;

use sqlx::{ConnectOptions, Connection};
use waypost_client::{Client, Code, v1};

use super::{ROTTEN_FRAME, flip_at, note, noted, sql, two_maps};
use crate::harness::{
    Server, answers, assert_status, database_options, first_return, followed, frame, map_request, refused,
    said, session_options, state_hash,
};

/// How a repair ended.
async fn repaired(client: &Client, into: &str, copy: Option<&str>) -> v1::Job {
    let job = client.repair_map("drive", into, copy).await.unwrap();
    followed(client, &job).await.pop().unwrap()
}

async fn snapshot(client: &Client) -> Vec<u8> {
    let mut snapshot = Vec::new();
    client.export_map("drive", &mut snapshot).await.unwrap();
    snapshot
}

const LABELLED: &str = "maps/drive/places/3";

/// The maps, with a label, and a snapshot of `drive`; then `statements` damage it.
async fn damaged(statements: &[&str]) -> (tempfile::TempDir, String, Vec<u8>) {
    let directory = two_maps().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    client.set_label(LABELLED, "kitchen", v1::LabelScope::Place).await.unwrap();
    let (whole, file) = (state_hash(&client, "drive").await, snapshot(&client).await);
    server.stop().await;
    for statement in statements {
        sql(directory.path(), statement).await;
    }
    (directory, whole, file)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_left_is_a_map_again_and_what_is_lost_is_told() {
    let (directory, whole, _) = damaged(&[ROTTEN_FRAME]).await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let job = repaired(&client, "again", None).await;
    assert_eq!(job.result.as_deref(), Some("maps/again"), "{job:?}");
    assert_eq!(
        (job.kind(), job.stage.as_str()),
        (v1::job::Kind::RepairMap, "lost: map drive, session first, frame 7")
    );
    let again = client.map("again", v1::MapView::Full).await.unwrap();
    assert_eq!((again.frames, again.sessions), (31, 2));
    assert_ne!(again.state_hash.unwrap(), whole);
    // As if its robots had not sent that frame.
    let model = client.models().await.unwrap().remove(0);
    client.create_map(map_request("sent", &model.name)).await.unwrap();
    let first = (1..=20).filter(|&sequence| sequence != 7).map(noted);
    answers(&client, "sent", "first", first).await;
    let begin = first_return();
    answers(&client, "sent", "second", (begin..begin + 12).map(frame)).await;
    assert_eq!(state_hash(&client, "again").await, state_hash(&client, "sent").await);
    let kept = client.frame("maps/again/sessions/first/frames/8").await.unwrap();
    assert_eq!(kept.note, note(8));
    // It takes frames, and leaves the other as it was.
    assert_eq!(answers(&client, "again", "third", (1..=3).map(frame)).await.len(), 3);
    assert_eq!(client.map("drive", v1::MapView::Basic).await.unwrap().frames, 32);
    let (code, _) = refused(client.open_session(session_options("drive", "more")).await.map(drop));
    assert_eq!(code, Code::FailedPrecondition);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn with_a_snapshot_nothing_is_lost() {
    let gone = "DELETE FROM log WHERE map_id = (SELECT id FROM maps WHERE name = 'drive') AND position IN (0, 10, 11)";
    let (directory, whole, file) = damaged(&[ROTTEN_FRAME, gone]).await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let imported = client.import_map("earlier", Cursor::new(file)).await.unwrap();
    followed(&client, &imported).await;
    let job = repaired(&client, "again", Some("earlier")).await;
    assert_eq!(
        (job.result.as_deref(), job.stage.as_str()),
        (Some("maps/again"), "nothing is lost"),
        "{job:?}"
    );
    assert_eq!(state_hash(&client, "again").await, whole);
    let labels = client.labels("again").await.unwrap();
    assert_eq!(labels.iter().map(|label| label.label.as_str()).collect::<Vec<_>>(), ["kitchen"]);
    let kept = client.frame("maps/again/sessions/first/frames/7").await.unwrap();
    assert_eq!(kept.note, note(7));

    // Asked for again, it is there.
    assert_eq!(repaired(&client, "again", Some("earlier")).await.result.as_deref(), Some("maps/again"));
    assert_eq!(state_hash(&client, "again").await, whole);
    // Without the snapshot, three frames and the beginning of a session are.
    let job = repaired(&client, "poorer", None).await;
    assert!(
        job.stage.starts_with("lost: map drive, event 0 of the log; map drive, session first, frame 7;"),
        "{job:?}"
    );
    assert_eq!(client.map("poorer", v1::MapView::Basic).await.unwrap().frames, 29);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_makes_no_sense_is_refused_and_makes_no_map() {
    let (directory, ..) = damaged(&[ROTTEN_FRAME]).await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    for (map, into, copy, code, fragment) in [
        ("nowhere", "again", None, Code::NotFound, "there is no map nowhere"),
        ("drive", "drive", None, Code::AlreadyExists, "there is a map drive already"),
        // Alike in model and settings, and somebody's own.
        ("drive", "spare", None, Code::AlreadyExists, "there is a map spare already"),
        ("drive", "Again", None, Code::InvalidArgument, "is no map name"),
        ("drive", "again", Some("nowhere"), Code::NotFound, "there is no map nowhere"),
        ("drive", "again", Some("drive"), Code::FailedPrecondition, "is no earlier copy of drive"),
    ] {
        let (refused_code, message) = refused(client.repair_map(map, into, copy).await);
        assert_status(map, (refused_code, &message), code, fragment);
    }
    // Another map of the same model.
    let model = client.models().await.unwrap().remove(0);
    client.create_map(map_request("other", &model.name)).await.unwrap();
    answers(&client, "other", "only", (5..=9).map(frame)).await;
    let job = repaired(&client, "again", Some("other")).await;
    assert!(said(&job.error).contains("other is no earlier copy of drive: event 1"), "{job:?}");
    let job = client.repair_map("spare", "again", None).await.unwrap();
    let job = followed(&client, &job).await.pop().unwrap();
    assert!(said(&job.error).contains("no damage was found in the map spare"), "{job:?}");
    assert_eq!(refused(client.map("again", v1::MapView::Basic).await).0, Code::NotFound);
    server.stop().await;
}

/// A robot drives on after the snapshot was made: what only the map has comes from it, and the snapshot stays whole.
#[tokio::test(flavor = "multi_thread")]
async fn an_older_snapshot_gives_what_it_has_and_is_not_taken_for_damaged() {
    let (directory, _, file) = damaged(&[]).await;
    let server = Server::start_on(directory.path()).await;
    answers(&server.client().await, "drive", "third", (1..=5).map(frame)).await;
    let whole = state_hash(&server.client().await, "drive").await;
    server.stop().await;
    sql(directory.path(), ROTTEN_FRAME).await;
    // The name and the camera of a session, too.
    let session =
        "DELETE FROM sessions WHERE map_id = (SELECT id FROM maps WHERE name = 'drive') AND number = 1";
    sql(directory.path(), session).await;

    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let imported = client.import_map("earlier", Cursor::new(file)).await.unwrap();
    followed(&client, &imported).await;
    let job = repaired(&client, "again", Some("earlier")).await;
    assert_eq!(
        (job.result.as_deref(), job.stage.as_str()),
        (Some("maps/again"), "nothing is lost"),
        "{job:?}"
    );
    assert_eq!(state_hash(&client, "again").await, whole);
    assert_eq!(answers(&client, "earlier", "more", (1..=3).map(frame)).await.len(), 3, "it is whole");
    let job = repaired(&client, "poorer", None).await;
    assert!(said(&job.error).contains("session number 1: its name and camera cannot be read"), "{job:?}");
    server.stop().await;
}

/// What is kept of a frame beside the log may be what is damaged.
#[tokio::test(flavor = "multi_thread")]
async fn features_come_from_the_snapshot_or_are_told_as_lost() {
    let (directory, whole, file) = damaged(&[]).await;
    let mut database = database_options(directory.path()).connect().await.unwrap();
    let select = "SELECT content FROM frame_media JOIN maps ON maps.id = map_id \
                  WHERE name = 'drive' AND position = 7 AND kind = 'features'";
    let features: Vec<u8> = sqlx::query_scalar(select).fetch_one(&mut database).await.unwrap();
    database.close().await.unwrap();
    flip_at(directory.path(), features.last_chunk::<24>().unwrap());
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    // Nobody has met the damage before.
    let job = repaired(&client, "poorer", None).await;
    assert!(job.stage.starts_with("lost: the features of session first, frame 7"), "{job:?}");
    assert_eq!(client.map("poorer", v1::MapView::Basic).await.unwrap().frames, 32);
    let (code, _) = refused(client.frame_picture("maps/drive/sessions/first/frames/7", None).await);
    assert_eq!(code, Code::DataLoss);
    let imported = client.import_map("earlier", Cursor::new(file)).await.unwrap();
    followed(&client, &imported).await;
    let job = repaired(&client, "again", Some("earlier")).await;
    assert_eq!(job.stage, "nothing is lost", "{job:?}");
    assert_eq!(state_hash(&client, "again").await, whole);
    server.stop().await;
}

/// What people said of loop closures goes with the frames that it is about, as who said it and when.
#[tokio::test(flavor = "multi_thread")]
async fn what_people_said_is_said_again_of_what_is_left() {
    let (directory, ..) = damaged(&[]).await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let first = |sequence: u64| format!("maps/drive/sessions/first/frames/{sequence}");
    let closures = client.loop_closures("drive").await.unwrap();
    let closing = |closure: &v1::LoopClosure| {
        let frame = closure.frame.as_ref().unwrap();
        format!("{}/frames/{}", frame.session, frame.sequence)
    };
    // Frames at three places of the first drive.
    let mut apart: Vec<(u32, u64)> = Vec::new();
    for frame in client.frames("maps/drive/sessions/first").await.unwrap() {
        let answer = frame.answer.unwrap();
        if let Some(place) = answer.place_number
            && apart.iter().all(|(other, _)| *other != place)
        {
            apart.push((place, answer.sequence));
        }
    }
    let [(_, earliest), (_, missed), (_, rotten), ..] = apart[..] else { panic!("{apart:?}") };
    // One that is withdrawn for good, one for a while, and two that were missed; the last is of the frame that rots.
    client.withdraw_loop_closure(&closing(&closures[0])).await.unwrap();
    let other = closures.iter().rev().map(closing).find(|frame| *frame != closing(&closures[0])).unwrap();
    let undone = client.withdraw_loop_closure(&other).await.unwrap();
    client.undo_correction(&undone.name).await.unwrap();
    client.confirm_loop_closure(&first(missed), &first(earliest)).await.unwrap();
    client.confirm_loop_closure(&first(rotten), &first(earliest)).await.unwrap();
    // A robot goes on: what is decided then rests on what was said.
    answers(&client, "drive", "third", (1..=5).map(frame)).await;
    let said_of = async |client: &Client, map: &str| {
        let said = client.corrections(map).await.unwrap();
        let told = |said: &v1::Correction| (said.verdict, said.create_time_ns, said.undone.clone());
        said.iter().map(told).collect::<Vec<_>>()
    };
    let (whole, file, said) =
        (state_hash(&client, "drive").await, snapshot(&client).await, said_of(&client, "drive").await);
    assert_eq!(said.len(), 4);
    server.stop().await;
    sql(directory.path(), &ROTTEN_FRAME.replace("sequence = 7", &format!("sequence = {rotten}"))).await;

    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let imported = client.import_map("earlier", Cursor::new(file)).await.unwrap();
    followed(&client, &imported).await;
    // Asked for again, nothing is said twice.
    for _ in 0..2 {
        let job = repaired(&client, "again", Some("earlier")).await;
        assert_eq!(job.stage, "nothing is lost", "{job:?}");
        assert_eq!(state_hash(&client, "again").await, whole);
    }
    let job = repaired(&client, "poorer", None).await;
    let lost = "a loop closure confirmed by \"\": what it is about is lost";
    assert!(
        job.stage.starts_with(&format!("lost: map drive, session first, frame {rotten};"))
            && job.stage.contains(lost),
        "{job:?}"
    );
    // What rested on the frame that is lost may make no sense of the others: that is told, too.
    let left = said_of(&client, "poorer").await;
    let times = |said: &[(i32, i64, Option<v1::Undoing>)]| said.iter().map(|said| said.1).collect::<Vec<_>>();
    assert!(times(&left).contains(&said[2].1) && !times(&left).contains(&said[3].1), "{left:?} of {said:?}");
    assert!(left.iter().all(|left| said.contains(left)), "{left:?} of {said:?}");
    assert_eq!(job.stage.matches(" of the log, a loop closure ").count(), said.len() - left.len(), "{job:?}");
    server.stop().await;
}
