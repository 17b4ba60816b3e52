//! A database that is held up: writers are asked to wait, robots wait, and nothing is lost.

use std::time::Duration;

use sqlx::{ConnectOptions, Connection, SqliteConnection};
use tonic_types::StatusExt;
use waypost_client::{Code, FrameOutcome};
use waypost_proto::v1;
use waypost_proto::v1::map_service_client::MapServiceClient;

use crate::harness::{Server, assert_status, channel, database_options, frame, in_time, session_options};

/// Holds the lock of those who write, as a backup tool or a person with a shell may.
async fn lock(server: &Server) -> SqliteConnection {
    let mut database = database_options(server.directory()).connect().await.unwrap();
    sqlx::query("BEGIN IMMEDIATE").execute(&mut database).await.unwrap();
    database
}

#[tokio::test(flavor = "multi_thread")]
async fn a_held_up_writer_is_waited_for() {
    let (server, client) = Server::with_map().await;
    let session = client.open_session(session_options("drive", "before")).await.unwrap();
    let held = lock(&server).await;

    let delete = v1::DeleteMapRequest { name: "maps/drive".to_owned() };
    let refused = in_time(MapServiceClient::new(channel(&server.endpoint()).await).delete_map(delete)).await;
    let status = refused.unwrap_err();
    assert_status("map", (status.code(), status.message()), Code::Unavailable, "held up");
    let wait = status.get_details_retry_info().and_then(|info| info.retry_delay);
    assert!(wait.is_some_and(|wait| wait > Duration::ZERO), "{status:?}");

    // Robots that have opened, and those that have not, go on when it is over.
    let (mut sender, mut outcomes) = session.split();
    sender.send(frame(1)).await.unwrap();
    let other = client.clone();
    let opening = tokio::spawn(async move { other.open_session(session_options("drive", "later")).await });
    let releasing = tokio::spawn(async move {
        tokio::time::sleep(Duration::from_secs(12)).await;
        held.close().await.unwrap();
    });
    match in_time(outcomes.next()).await.unwrap() {
        Some(FrameOutcome::Answer(answer)) => assert_eq!(answer.sequence, 1),
        other => panic!("{other:?}"),
    }
    in_time(opening).await.unwrap().unwrap();
    releasing.await.unwrap();
    server.stop().await;
}
