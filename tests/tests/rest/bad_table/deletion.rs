//! Maps that are being deleted, jobs and streams that were cancelled.

use std::future::Future;
use std::pin::Pin;

use waypost_client::{Client, Code, Error, v1};
use waypost_proto::v1::stream_request::Content::Frame;

use crate::harness::{
    RawStream, Server, answers_of, as_histogram, histogram, images, in_time, map_request, mapped, open,
    reference_by_words, refused, state_hash, wire, word_maker, words_options,
};

const ROUNDS: usize = 6;

type Asked<'a> = Pin<Box<dyn Future<Output = Result<(), Error>> + 'a>>;

/// Everything that can be asked of a map.
fn everything(client: &Client) -> Vec<(&'static str, Asked<'_>)> {
    let robot = "maps/doomed/sessions/robot";
    let frame = "maps/doomed/sessions/robot/frames/12";
    let content = || waypost_client::FrameContent::Histogram(histogram(3));
    let words_hash = word_maker().words_hash();
    vec![
        ("get", Box::pin(async { client.map("doomed", v1::MapView::Unspecified).await.map(drop) })),
        ("get all", Box::pin(async { client.map("doomed", v1::MapView::Full).await.map(drop) })),
        ("places", Box::pin(async { client.places("doomed").await.map(drop) })),
        ("place", Box::pin(async { client.place("maps/doomed/places/0").await.map(drop) })),
        ("matches", Box::pin(async { client.loop_closures("doomed").await.map(drop) })),
        ("word places", Box::pin(async { client.word_places("doomed", 7).await.map(drop) })),
        ("sessions", Box::pin(async { client.sessions("doomed").await.map(drop) })),
        ("session", Box::pin(async move { client.session(robot).await.map(drop) })),
        ("frames", Box::pin(async move { client.frames(robot).await.map(drop) })),
        ("frame", Box::pin(async move { client.frame(frame).await.map(drop) })),
        ("explain", Box::pin(async move { client.explain_frame(frame, None, Some(0)).await.map(drop) })),
        (
            "query",
            Box::pin(async move { client.query("doomed", content(), words_hash, Some(3)).await.map(drop) }),
        ),
        ("rebind", Box::pin(async { client.rebind_map("doomed", "shipped").await.map(drop) })),
        ("delete again", Box::pin(async { client.delete_map("doomed").await })),
    ]
}

/// A caller meanwhile sees the map as it was or not at all, and never a half of it.
#[tokio::test(flavor = "multi_thread")]
async fn a_map_that_is_being_deleted_is_there_or_not() {
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "bystander", 1..=5).await;
    let before = state_hash(&client, "drive").await;
    let whole = without_and_with_late_session(&server, &client).await;
    for round in 0..ROUNDS {
        client.create_map(map_request("doomed", "shipped")).await.unwrap();
        answers_of(&client, words_options("doomed", "robot"), (1..=30).map(as_histogram)).await;
        let checked = async {
            match client.map("doomed", v1::MapView::Full).await {
                Ok(map) => {
                    assert_eq!(map.frames, 30, "a half of the map was seen");
                    // The late robot's session is part of the state from the moment it is opened.
                    let state_hash = map.state_hash.clone().expect("asked for in full");
                    assert!(whole.contains(&state_hash), "{state_hash} of {map:?} is none of {whole:?}");
                }
                Err(error) => assert_gone("state hash", Err(error)),
            }
        };
        let streaming = async {
            let opened = RawStream::open(&server.endpoint(), open("doomed", "late")).await;
            let refusal = opened.err();
            let expected = refusal.as_ref().is_none_or(|status| {
                matches!(tonic::Code::from(status.code() as i32), Code::NotFound | Code::Unavailable)
            });
            assert!(expected, "opening came to {refusal:?}");
        };
        let asked = everything(&client).into_iter().map(|(call, asked)| async move { (call, asked.await) });
        let (deleted, answers, (), ()) = in_time(async {
            tokio::join!(client.delete_map("doomed"), futures::future::join_all(asked), checked, streaming)
        })
        .await;
        for (call, answer) in answers {
            assert_gone(call, answer);
        }
        // The other of the two deletions may have come first.
        assert_gone("delete", deleted);
        for (call, asked) in everything(&client) {
            let (code, message) = refused(asked.await);
            assert_eq!(code, Code::NotFound, "round {round}, {call}: {message}");
            assert!(message.contains("there is no map doomed; list the maps"), "{call}: {message}");
        }
    }
    assert_eq!(state_hash(&client, "drive").await, before);
    server.stop().await;
}

/// State hash of a map of the same frames before and after the late robot has opened its session.
async fn without_and_with_late_session(server: &Server, client: &Client) -> [String; 2] {
    client.create_map(map_request("twin", "shipped")).await.unwrap();
    answers_of(client, words_options("twin", "robot"), (1..=30).map(as_histogram)).await;
    let without = state_hash(client, "twin").await;
    let _late = RawStream::open(&server.endpoint(), open("twin", "late")).await.unwrap();
    [without, state_hash(client, "twin").await]
}

/// Served, not found, or to be asked again: nothing else.
#[track_caller]
fn assert_gone(call: &str, answer: Result<(), Error>) {
    let Err(error) = answer else { return };
    let (code, message) = refused::<()>(Err(error));
    let expected = match code {
        Code::NotFound => "doomed",
        Code::Unavailable => "send the request again",
        _ => panic!("{call} came to {code:?}: {message}"),
    };
    assert!(message.contains(expected), "{call}: {message}");
}

/// A job that was cancelled stays so, whatever is asked of it.
#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_job_stays_cancelled() {
    let (server, client) = Server::with_map_of_words().await;
    let settings = v1::TrainModelSettings { words: 5000, ..v1::TrainModelSettings::default() };
    let training = futures::stream::iter(images().iter().take(20).cloned().map(Ok));
    let job = in_time(client.train_model(settings, training)).await.unwrap();
    client.cancel_job(&job.name).await.unwrap();
    let mut steps = client.watch_job(&job.name).await.unwrap();
    let mut last = None;
    while let Some(step) = in_time(steps.next()).await.unwrap() {
        last = Some(step);
    }
    let cancelled = last.expect("a job that is watched is told of");
    assert_eq!((cancelled.state(), &cancelled.result), (v1::job::State::Cancelled, &None));
    assert_eq!(client.cancel_job(&job.name).await.unwrap(), cancelled);
    assert_eq!(client.job(&job.name).await.unwrap(), cancelled);
    assert_eq!(client.models().await.unwrap().len(), 1, "a cancelled training left a model");
    server.stop().await;
}

/// A robot that hangs up in the middle leaves whole frames, and can go on.
#[tokio::test(flavor = "multi_thread")]
async fn a_stream_that_was_cancelled_leaves_whole_frames() {
    const FRAMES: u64 = 60;
    let (server, client) = Server::with_map_of_words().await;
    let opening =
        || v1::OpenSession { words_hash: word_maker().words_hash().to_owned(), ..open("drive", "robot") };
    let mut next = 1;
    while next <= FRAMES {
        let (raw, opened) = RawStream::open(&server.endpoint(), opening()).await.unwrap();
        let committed = opened.last_committed_sequence.unwrap_or(0);
        assert!(committed >= next - 1, "{committed} is less than was answered");
        next = committed + 1;
        for sequence in next..=(next + 20).min(FRAMES) {
            raw.send(Frame(wire(as_histogram(sequence)))).await;
        }
        let mut raw = raw;
        if next <= FRAMES {
            // One is answered, the others are on their way when the robot hangs up.
            raw.next().await.unwrap();
            next += 1;
        }
    }
    let (_, opened) = RawStream::open(&server.endpoint(), opening()).await.unwrap();
    let committed = opened.last_committed_sequence.unwrap();
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.frames, committed);
    assert_eq!(map.state_hash, Some(reference_by_words().maps[committed as usize].state_hash.clone()));
    server.stop().await;
}
