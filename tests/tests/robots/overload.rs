//! More images than the server can work off: some are refused at once, with the time to come again.

use std::thread::available_parallelism;

use futures::future::join_all;
use tonic::{Code, Status};
use waypost_client::v1;
use waypost_proto::v1::query_request::Content;
use waypost_proto::v1::recognition_service_client::RecognitionServiceClient;

use crate::harness::{
    RawStream, Server, answers, channel, frame, images, in_time, open, reference, state_hash, wire,
};

/// More than may wait, whatever the machine: 16 a core beside those being worked on.
fn too_many() -> usize {
    3 * 17 * available_parallelism().unwrap().get()
}

#[tokio::test(flavor = "multi_thread")]
async fn too_many_images_are_refused_with_a_time_and_robots_get_through() {
    const FRAMES: u64 = 12;
    let (server, client) = Server::with_map().await;
    let service = RecognitionServiceClient::new(channel(&server.endpoint()).await);
    let query = |index: usize| {
        let mut service = service.clone();
        let content = Some(Content::Image(images()[index % images().len()].clone()));
        let map = "maps/drive".to_owned();
        let request = v1::QueryRequest { map, content, words_hash: String::new(), explained_words: Some(0) };
        async move { service.query(request).await.map(drop) }
    };
    let crowd = join_all((0..too_many()).map(query));
    let robot = answers(&client, "drive", "robot", (1..=FRAMES).map(frame));
    let (crowd, answers) = in_time(async { tokio::join!(crowd, robot) }).await;

    let refused: Vec<&Status> = crowd.iter().filter_map(|answer| answer.as_ref().err()).collect();
    assert!(!refused.is_empty() && refused.len() < crowd.len(), "{} of {}", refused.len(), crowd.len());
    for status in refused {
        assert_eq!(status.code(), Code::Unavailable, "{status:?}");
        assert!(status.message().contains("send this one again in"), "{status:?}");
        let details = String::from_utf8_lossy(status.details());
        assert!(details.contains("google.rpc.RetryInfo"), "{details}");
    }
    // The client library waits and sends again: its application notices nothing.
    assert_eq!(answers.len() as u64, FRAMES);
    assert_eq!(state_hash(&client, "drive").await, reference().maps[FRAMES as usize].state_hash);
    // Once the crowd is gone there is room again.
    query(0).await.unwrap();
    server.stop().await;
}

/// Each stream may hold some frames: their number is bounded, and those that are open are none the worse.
#[tokio::test(flavor = "multi_thread")]
async fn no_more_streams_are_opened_than_there_is_room_for() {
    const MOST: usize = 500;
    let (server, _) = Server::with_map().await;
    let mut streams = Vec::new();
    let refusal = loop {
        assert!(streams.len() <= MOST, "{} streams are open", streams.len());
        let session = open("drive", &format!("robot-{}", streams.len()));
        match in_time(RawStream::open(&server.endpoint(), session)).await {
            Ok((stream, _)) => streams.push(stream),
            Err(refusal) => break refusal,
        }
    };
    assert_eq!((streams.len(), refusal.code()), (MOST, Code::Unavailable), "{refusal:?}");
    assert!(refusal.message().contains("end some that are idle, or ask again"), "{refusal:?}");
    let details = String::from_utf8_lossy(refusal.details());
    assert!(details.contains("google.rpc.RetryInfo"), "{details}");

    let mut last = streams.pop().unwrap();
    assert!(!last.answered(wire(frame(1))).await.resent);
    drop(last);
    // The server notices in a moment that the stream is gone.
    in_time(async {
        while RawStream::open(&server.endpoint(), open("drive", "late")).await.is_err() {
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
    })
    .await;
    server.stop().await;
}
