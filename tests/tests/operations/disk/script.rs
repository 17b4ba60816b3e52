//! A server's work while its disk is recorded: robots that stream, and whoever looks after maps meanwhile.

use std::io::Cursor;

use waypost_client::{Client, ClientOptions, FrameInput, FrameOutcome, Outcomes, SessionOptions, v1};

use super::watched::WatchedDisk;
use crate::harness::{
    ServerProcess, answers, as_histogram, by_words_request, followed, frame, import_model, in_time,
    map_request, session_options, words_options,
};

/// A frame that was answered.
#[derive(Clone, Debug)]
pub(super) struct Acknowledged {
    /// How much was recorded by then.
    pub(super) recorded: u64,
    /// Map and session.
    pub(super) session: (String, String),
    /// How many frames of the session were answered, with this one.
    pub(super) count: u64,
    /// As it is kept.
    pub(super) answer: v1::FrameAnswer,
}

/// What a server has said.
#[derive(Debug, Default)]
pub(super) struct Said {
    pub(super) frames: Vec<Acknowledged>,
    /// How much was recorded each time when the server was at rest: all that was written by then is durable.
    pub(super) at_rest: Vec<u64>,
    /// Of the token that there is at the end.
    pub(super) secret: String,
}

/// How many frames a robot sends before it waits for answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sending {
    OneByOne,
    AllAtOnce,
}

/// What does not change while it is kept: see `FrameRecord`.
pub(super) fn kept(answer: &v1::FrameAnswer) -> v1::FrameAnswer {
    let last_committed_sequence = answer.sequence;
    v1::FrameAnswer {
        last_committed_sequence,
        timings: None,
        map_pose: None,
        resent: false,
        ..answer.clone()
    }
}

/// Frames that go to one session, and what was said to them.
async fn streamed(
    disk: &WatchedDisk,
    client: &Client,
    (options, session): (SessionOptions, (&str, &str)),
    frames: Vec<FrameInput>,
    sending: Sending,
) -> Vec<Acknowledged> {
    let (mut sender, mut outcomes) = client.open_session(options).await.unwrap().split();
    let mut said = Vec::new();
    let mut hear = async |outcomes: &mut Outcomes| match in_time(outcomes.next()).await.unwrap() {
        Some(FrameOutcome::Answer(answer)) => {
            let (recorded, answer) = (disk.recorded(), kept(&answer));
            let session = (session.0.to_owned(), session.1.to_owned());
            said.push(Acknowledged { recorded, session, count: said.len() as u64 + 1, answer });
        }
        other => panic!("{other:?}"),
    };
    let count = frames.len();
    match sending {
        Sending::OneByOne => {
            for frame in frames {
                sender.send(frame).await.unwrap();
                hear(&mut outcomes).await;
            }
        }
        Sending::AllAtOnce => {
            let sending = tokio::spawn(async move {
                for frame in frames {
                    sender.send(frame).await.unwrap();
                }
            });
            for _ in 0..count {
                hear(&mut outcomes).await;
            }
            sending.await.unwrap();
        }
    }
    said
}

/// The map that nothing but frames of one session comes to: its hash is known frame by frame.
pub(super) const DRIVE: (&str, &str) = ("drive", "robot");

/// Frames of it in the first part, before the restart.
const FIRST: u64 = 36;
const AFTERWARDS: u64 = 24;

/// Works on a disk that is empty, is stopped in good order, and works on until it is killed.
pub(super) async fn work(disk: &WatchedDisk) -> Said {
    let mut said = Said::default();
    let server = disk.start();
    let client = server.client().await;
    let model = import_model(&client).await;
    said.at_rest.push(disk.at_rest().await);
    client.create_map(by_words_request(DRIVE.0, &model.name)).await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    client.create_map(map_request("house", &model.name)).await.unwrap();
    let drive = || (words_options(DRIVE.0, DRIVE.1), DRIVE);
    let first = (1..=FIRST).map(as_histogram).collect();
    said.frames.extend(streamed(disk, &client, drive(), first, Sending::OneByOne).await);
    said.at_rest.push(disk.at_rest().await);

    // Two robots in one map at once.
    let one = (session_options("house", "one"), ("house", "one"));
    let two = (session_options("house", "two"), ("house", "two"));
    let (one, two) = tokio::join!(
        streamed(disk, &client, one, (1..=12).map(frame).collect(), Sending::AllAtOnce),
        streamed(disk, &client, two, (21..=30).map(frame).collect(), Sending::OneByOne),
    );
    said.frames.extend(one.into_iter().chain(two));
    look_after_maps(disk, &client, &mut said).await;
    server.stop();
    said.at_rest.push(disk.at_rest().await);

    let server = disk.start();
    let client = server.client().await;
    let later = (FIRST + 1..=FIRST + AFTERWARDS).map(as_histogram).collect();
    let mut later = streamed(disk, &client, drive(), later, Sending::AllAtOnce).await;
    later.iter_mut().for_each(|frame| frame.count += FIRST);
    said.frames.extend(later);
    said.at_rest.push(disk.at_rest().await);
    look_after_tokens(disk, &server, &mut said).await;
    server.kill();
    said
}

/// What is done to maps besides driving in them.
async fn look_after_maps(disk: &WatchedDisk, client: &Client, said: &mut Said) {
    client.set_label("maps/house/places/0", "hall", v1::LabelScope::Place).await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    client.delete_label("maps/house/places/0").await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    let frame_of = |session: &str, sequence: u64| format!("maps/house/sessions/{session}/frames/{sequence}");
    let correction = client.confirm_loop_closure(&frame_of("one", 9), &frame_of("one", 2)).await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    client.undo_correction(&correction.name).await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    let mut snapshot = Vec::new();
    client.export_map("house", &mut snapshot).await.unwrap();
    let job = client.import_map("copy", Cursor::new(snapshot)).await.unwrap();
    followed(client, &job).await;
    said.at_rest.push(disk.at_rest().await);
    let job = client.delete_session("maps/copy/sessions/two").await.unwrap();
    followed(client, &job).await;
    said.at_rest.push(disk.at_rest().await);
    let mode = v1::trim_map_request::Mode::Apply.into();
    client.trim_map(v1::TrimMapRequest { name: "maps/copy".to_owned(), max_places: 6, mode }).await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    answers(client, "copy", "later", (40..=42).map(frame)).await;
    client.delete_map("copy").await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    let job = client.compact_map("house").await.unwrap();
    followed(client, &job).await;
    said.at_rest.push(disk.at_rest().await);
}

async fn look_after_tokens(disk: &WatchedDisk, server: &ServerProcess, said: &mut Said) {
    let (_, secret) = server.client().await.create_token("operator", v1::token::Role::Admin).await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    said.secret = secret;
    let admin = ClientOptions::new(server.endpoint()).with_token(&said.secret);
    let admin = Client::connect(admin).await.unwrap();
    admin.create_token("cart", v1::token::Role::Robot).await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    let rotation = v1::RotateTokenRequest { name: "tokens/cart".to_owned(), ..Default::default() };
    admin.rotate_token(rotation).await.unwrap();
    said.at_rest.push(disk.at_rest().await);
    admin.delete_token("cart").await.unwrap();
    said.at_rest.push(disk.at_rest().await);
}
