//! Many robots at once: none is delayed by another, none loses a frame, and waiting costs no memory.

use std::num::NonZeroUsize;
use std::sync::LazyLock;
use std::time::Duration;

use fabmap::model::Model;
use futures::future::{join_all, try_join_all};
use futures::{StreamExt, stream};
use tokio::sync::{Barrier, Semaphore};
use waypost_client::{Client, Code, FrameContent, FrameInput, FrameOutcome, SessionOptions, v1};
use waypost_proto::v1::stream_request::Content as Request;
use waypost_proto::v1::stream_response::Content as Response;

use crate::harness::{
    RawStream, SECOND_NS, Server, ServerProcess, answers, as_words, channel_with_window, frame, frame_count,
    images, import_model, in_time, map_request, model_file, open, session_options, state_hash,
    stream as stream_to_end, wire,
};

const ROBOTS: [&str; 4] = ["robot-0", "robot-1", "robot-2", "robot-3"];

/// What the model's training images showed: frames that take the server a millisecond.
static WORDS: LazyLock<(String, Vec<v1::WordHistogram>)> = LazyLock::new(|| {
    let model = Model::from_bytes(&std::fs::read(model_file()).unwrap()).unwrap();
    let histograms = model.sampling_set().iter().map(|observation| {
        let (words, counts) = observation.histogram();
        v1::WordHistogram { words, counts }
    });
    (model.words_hash().to_string(), histograms.collect())
});

/// Words in place of an image, `offset` places on in what there is.
fn frame_of_words(sequence: u64, offset: usize) -> FrameInput {
    let (_, histograms) = &*WORDS;
    let histogram = histograms[(sequence as usize + offset) % histograms.len()].clone();
    let stamp_ns = SECOND_NS * i64::try_from(sequence).unwrap();
    FrameInput {
        sequence,
        stamp_ns,
        content: FrameContent::Histogram(histogram),
        odometry: None,
        note: String::new(),
    }
}

fn words_options(session: &str) -> SessionOptions {
    SessionOptions { words_hash: WORDS.0.clone(), ..session_options("drive", session) }
}

async fn with_map(server: &ServerProcess) -> Client {
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    client
}

fn sequences(answers: &[v1::FrameAnswer]) -> Vec<u64> {
    answers.iter().map(|answer| answer.sequence).collect()
}

/// Two robots see the odd frames of the drive and two the even ones.
fn seen_by(robot: usize) -> impl Iterator<Item = u64> {
    (1 + robot as u64 % 2..=frame_count()).step_by(2)
}

/// Streams the drive by four robots side by side; what each was answered.
async fn four_robots(server: &ServerProcess) -> Vec<Vec<v1::FrameAnswer>> {
    let robots = ROBOTS.iter().enumerate().map(|(robot, session)| {
        let endpoint = server.endpoint();
        tokio::spawn(async move {
            let client = Client::connect(&endpoint).await.unwrap();
            answers(&client, "drive", session, seen_by(robot).map(as_words)).await
        })
    });
    try_join_all(robots).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn four_robots_stream_into_one_map_at_once() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = with_map(&server).await;
    let first = four_robots(&server).await;
    for (robot, answers) in first.iter().enumerate() {
        assert_eq!(sequences(answers), seen_by(robot).collect::<Vec<_>>(), "robot {robot}");
        assert!(answers.iter().all(|answer| !answer.resent), "robot {robot}");
    }
    // They met: what one has seen, another recognised.
    let closes_with = |answer: &v1::FrameAnswer| {
        let matched = answer.r#match.as_ref().filter(|_| answer.reason() == v1::Reason::LoopClosure)?;
        Some(matched.frame.as_ref().unwrap().session.clone())
    };
    let foreign = first.iter().zip(ROBOTS).flat_map(|(answers, robot)| {
        let own = format!("maps/drive/sessions/{robot}");
        answers.iter().filter_map(closes_with).filter(move |session| *session != own)
    });
    assert!(foreign.count() > 0, "no robot recognised what another had seen");

    // The log holds it all, each frame as its robot was told.
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!((map.frames, map.sessions), (first.iter().map(|answers| answers.len() as u64).sum(), 4));
    for (answers, robot) in first.iter().zip(ROBOTS) {
        let kept = client.frames(&format!("maps/drive/sessions/{robot}")).await.unwrap();
        let kept: Vec<_> = kept.into_iter().map(|frame| decided(&frame.answer.unwrap())).collect();
        assert_eq!(kept, answers.iter().map(decided).collect::<Vec<_>>(), "{robot}");
    }

    // Sent again, every frame gets its stored answer.
    let again = four_robots(&server).await;
    for (first, again) in first.iter().zip(&again) {
        assert_eq!(
            again.iter().map(decided).collect::<Vec<_>>(),
            first.iter().map(decided).collect::<Vec<_>>()
        );
        assert!(again.iter().all(|answer| answer.resent && answer.timings.is_none()));
    }
    assert_eq!(Some(state_hash(&client, "drive").await), map.state_hash);

    // By replay of the log, then from the checkpoint.
    server.kill();
    let server = ServerProcess::start(directory.path());
    assert_eq!(Some(state_hash(&server.client().await, "drive").await), map.state_hash, "replayed");
    server.stop();
    let server = ServerProcess::start(directory.path());
    assert_eq!(Some(state_hash(&server.client().await, "drive").await), map.state_hash, "restored");
    server.stop();
}

/// What was decided about a frame, whenever it is said.
fn decided(answer: &v1::FrameAnswer) -> v1::FrameAnswer {
    v1::FrameAnswer { last_committed_sequence: 0, timings: None, resent: false, ..answer.clone() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_never_reads_delays_nobody() {
    const UNREAD: u64 = 500;
    const FRAMES: u64 = 300;
    let (server, client) = Server::with_map().await;
    let opening = v1::OpenSession { words_hash: WORDS.0.clone(), ..open("drive", "stalled") };
    // So small that a few answers fill it.
    let channel = channel_with_window(&server.endpoint(), 1 << 10).await;
    let mut stalled = RawStream::begin_over(channel, Request::Open(opening)).await.unwrap();
    assert!(matches!(stalled.next().await, Ok(Some(Response::Opened(_)))));
    let requests = stalled.requests();
    let sending = tokio::spawn(async move {
        for sequence in 1..=UNREAD {
            let frame = Request::Frame(wire(frame_of_words(sequence, 0)));
            requests.send(v1::StreamRequest { content: Some(frame) }).await.unwrap();
        }
    });

    let robots = ROBOTS.iter().enumerate().map(|(robot, session)| {
        let endpoint = server.endpoint();
        tokio::spawn(async move {
            let client = Client::connect(&endpoint).await.unwrap();
            let session = client.open_session(words_options(session)).await.unwrap();
            let frames = (1..=FRAMES).map(|sequence| frame_of_words(sequence, 100 * robot));
            stream_to_end(session, frames).await
        })
    });
    for outcomes in try_join_all(robots).await.unwrap() {
        assert!(outcomes.iter().all(|outcome| matches!(outcome, FrameOutcome::Answer(_))));
        assert_eq!(
            outcomes.iter().map(FrameOutcome::sequence).collect::<Vec<_>>(),
            Vec::from_iter(1..=FRAMES)
        );
    }
    // It stalls still: the server took no more of it than it may have on the way.
    let committed = client.session("maps/drive/sessions/stalled").await.unwrap().frames;
    assert!((1..UNREAD / 2).contains(&committed), "{committed} frames of {UNREAD} that nobody reads of");

    for sequence in 1..=UNREAD {
        match stalled.next().await {
            Ok(Some(Response::Answer(answer))) => assert_eq!(answer.sequence, sequence),
            other => panic!("frame {sequence}: {other:?}"),
        }
    }
    in_time(sending).await.unwrap();
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.frames, UNREAD + FRAMES * ROBOTS.len() as u64);
    server.stop().await;
}

/// Images that the server has on hand at once, as extraction.rs bounds them: one a core, and 16 waiting.
fn images_on_hand() -> usize {
    17 * std::thread::available_parallelism().unwrap().get()
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_refused_under_overload_is_answered_later() {
    const FRAMES: u64 = 2;
    let (server, client) = Server::with_map().await;
    let (raw_robots, library_robots) = (2 * images_on_hand(), 8);
    let all_open = Barrier::new(raw_robots);
    // Fewer at a time than strangers may be: a slow machine admits none of them within their grace.
    let opening = Semaphore::new(16);
    let raw = stream::iter(0..raw_robots).map(|robot| {
        let (server, all_open, opening) = (&server, &all_open, &opening);
        async move {
            let turn = opening.acquire().await.unwrap();
            let first = open("drive", &format!("raw-{robot}"));
            let (stream, _) = RawStream::open(&server.endpoint(), first).await.unwrap();
            drop(turn);
            all_open.wait().await;
            by_the_contract(stream, FRAMES).await
        }
    });
    let library = stream::iter(0..library_robots).map(|robot| {
        let client = &client;
        async move { answers(client, "drive", &format!("library-{robot}"), (1..=2 * FRAMES).map(frame)).await }
    });
    let (raw, library): (Vec<_>, Vec<_>) = tokio::join!(
        raw.buffer_unordered(raw_robots).collect(),
        library.buffer_unordered(library_robots).collect()
    );
    let refusals: usize = raw.iter().sum();
    assert!(refusals > 0, "{raw_robots} images at once were not too many");
    for answers in &library {
        assert_eq!(sequences(answers), Vec::from_iter(1..=2 * FRAMES));
        assert!(answers.iter().all(|answer| !answer.resent));
    }
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.frames, FRAMES * raw_robots as u64 + 2 * FRAMES * library_robots as u64);
    server.stop().await;
}

/// Sends frames one by one, again when the server asks for it; how often it did.
async fn by_the_contract(mut stream: RawStream, frames: u64) -> usize {
    let mut refusals = 0;
    for sequence in 1..=frames {
        loop {
            match stream.frame(wire(frame(sequence))).await {
                Ok(Response::Answer(answer)) => {
                    assert_eq!((answer.sequence, answer.resent), (sequence, false));
                    break;
                }
                Ok(Response::Refusal(refusal)) => {
                    let status = refusal.status.unwrap();
                    assert_eq!(Code::from(status.code), Code::Unavailable, "{status:?}");
                    refusals += 1;
                    tokio::time::sleep(retry_delay(&status)).await;
                }
                other => panic!("frame {sequence}: {other:?}"),
            }
        }
    }
    refusals
}

/// What RetryInfo asks for; it must be there.
fn retry_delay(status: &waypost_proto::google::rpc::Status) -> Duration {
    use prost::Message;
    let [detail] = status.details.as_slice() else { panic!("no details: {status:?}") };
    assert_eq!(detail.type_url, "type.googleapis.com/google.rpc.RetryInfo");
    let hint = tonic_types::pb::RetryInfo::decode(detail.value.as_slice()).unwrap();
    let delay = Duration::try_from(hint.retry_delay.unwrap()).unwrap();
    assert!(delay > Duration::ZERO && delay <= Duration::from_secs(30), "{delay:?}");
    delay
}

const MIB: u64 = 1 << 20;

/// The largest images there may be: those that cannot be worked on yet wait at their robots.
#[tokio::test(flavor = "multi_thread")]
async fn frames_that_wait_stay_with_their_robots() {
    const ROBOTS: u64 = 16;
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = with_map(&server).await;
    let small = images()[0].clone();
    let usual = highest_memory(&server, send_by_robots(&client, "small", ROBOTS, &small)).await;
    // Decoders stop at the end of the picture.
    let mut large = small;
    large.resize(4 * MIB as usize, 0);
    let highest = highest_memory(&server, send_by_robots(&client, "large", ROBOTS, &large)).await;
    // Of each robot's eight, two are in work and one is on its way in.
    let allowed = usual + ROBOTS * 3 * 4 * MIB + 64 * MIB;
    assert!(highest <= allowed, "{} MiB, with small images {}", highest / MIB, usual / MIB);
    server.stop();
}

/// Robots that have eight frames on their way at once; each is answered.
async fn send_by_robots(client: &Client, prefix: &str, robots: u64, image: &[u8]) {
    const FRAMES: u64 = 8;
    let robots = (0..robots).map(|robot| async move {
        let options = SessionOptions {
            window_frames: NonZeroUsize::new(FRAMES as usize).unwrap(),
            ..session_options("drive", &format!("{prefix}-{robot}"))
        };
        let session = client.open_session(options).await.unwrap();
        let content = || FrameContent::Image(image.to_vec());
        let frames = (1..=FRAMES).map(|sequence| FrameInput { content: content(), ..frame(sequence) });
        let outcomes = stream_to_end(session, frames).await;
        assert_eq!(outcomes.len() as u64, FRAMES);
        assert!(outcomes.iter().all(|outcome| matches!(outcome, FrameOutcome::Answer(_))), "{outcomes:?}");
    });
    join_all(robots).await;
}

/// The most memory, in bytes, that a server has while it is at work.
async fn highest_memory(server: &ServerProcess, work: impl Future<Output = ()>) -> u64 {
    let mut highest = server.rss_bytes();
    tokio::pin!(work);
    loop {
        tokio::select! {
            () = &mut work => return highest,
            () = tokio::time::sleep(Duration::from_millis(10)) => highest = highest.max(server.rss_bytes()),
        }
    }
}
