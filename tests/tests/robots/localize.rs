//! Localizing: a robot hears where it is, and the map stays as it is.

use std::time::Duration;

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Row};
use tonic::Status;
use waypost_client::{Client, Code, SessionOptions, v1};
use waypost_proto::v1::stream_request::Content::Open;

use crate::harness::{
    CommandLine, Proxy, RawStream, Server, ServerProcess, answers_of, as_histogram, assert_status, channel,
    decided, first_return, folder, frame, frame_count, import_model, in_time, map_request, mapped, open,
    path, reference_by_words, state_hash, stream_through, told, wire, word_maker, words_options,
};

fn localizing(session: &str) -> SessionOptions {
    SessionOptions { mode: v1::SessionMode::Localize, ..words_options("drive", session) }
}

/// The first message of a stream of words.
fn opening(session: &str, mode: v1::SessionMode) -> v1::OpenSession {
    let words_hash = word_maker().words_hash().to_owned();
    v1::OpenSession { mode: mode.into(), words_hash, ..open("drive", session) }
}

async fn localizer(server: &Server, session: &str) -> (RawStream, v1::SessionOpened) {
    let opening = opening(session, v1::SessionMode::Localize);
    RawStream::open(&server.endpoint(), opening).await.unwrap()
}

async fn refusal_to_open(server: &Server, opening: v1::OpenSession) -> Status {
    match RawStream::begin(&server.endpoint(), Open(opening)).await {
        Ok(mut stream) => stream.next().await.expect_err("the session was opened"),
        Err(status) => status,
    }
}

/// Rows of each table that a session could leave something in.
async fn rows(server: &Server) -> Vec<(&'static str, i64)> {
    let file = server.directory().join("waypost.sqlite");
    let mut database = SqliteConnectOptions::new().filename(file).read_only(true).connect().await.unwrap();
    let mut rows = Vec::new();
    for table in ["sessions", "log", "frame_media", "map_models", "checkpoint_places", "checkpoint_sessions"]
    {
        let count = format!("SELECT count(*) FROM {table}");
        let row = sqlx::query(AssertSqlSafe(count)).fetch_one(&mut database).await.unwrap();
        rows.push((table, row.get(0)));
    }
    database.close().await.unwrap();
    rows
}

#[tokio::test(flavor = "multi_thread")]
async fn localizing_changes_nothing_and_decides_as_in_process() {
    let (server, client) = Server::with_map_of_words().await;
    let before_return = first_return() - 1;
    mapped(&client, "mapper", 1..=before_return).await;
    let before = (client.map("drive", v1::MapView::Full).await.unwrap(), rows(&server).await);

    let returning = first_return()..=frame_count();
    // Some frames come as images.
    let form = |sequence| if sequence % 8 == 0 { frame(sequence) } else { as_histogram(sequence) };
    let answers = answers_of(&client, localizing("looker"), returning.clone().map(form)).await;
    let events = reference_by_words().localized([(before_return, returning)]);
    assert_eq!(answers.len(), events.len());
    for (answer, event) in answers.iter().zip(&events) {
        assert_eq!(told(answer), decided(event, reference_by_words()), "frame {}", event.sequence);
        let grows = matches!(answer.reason(), v1::Reason::NewPlace | v1::Reason::BelowThreshold);
        assert!(!(grows && answer.place_number.is_some()), "a place was made: {answer:?}");
        assert_eq!((answer.last_committed_sequence, answer.resent), (answer.sequence, false));
    }
    assert!(answers.iter().any(|answer| answer.reason() == v1::Reason::LoopClosure), "no loop was closed");

    let after = (client.map("drive", v1::MapView::Full).await.unwrap(), rows(&server).await);
    assert_eq!(after, before);
    let sessions = client.sessions("drive").await.unwrap();
    assert_eq!(
        sessions.iter().map(|session| session.name.as_str()).collect::<Vec<_>>(),
        ["maps/drive/sessions/mapper"]
    );
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_that_was_cut_is_resumed_with_its_belief_and_answers() {
    let (server, client) = Server::with_map_of_words().await;
    let before_return = first_return() - 1;
    mapped(&client, "mapper", 1..=before_return).await;
    let returning = first_return()..=first_return() + 9;
    let events = reference_by_words().localized([(before_return, returning.clone())]);

    let mut first_answers = Vec::new();
    for (sequence, event) in returning.clone().zip(&events) {
        // A new stream for each frame: what the robot was believed to be at is not lost with one.
        let (mut raw, opened) = localizer(&server, "looker").await;
        let last = first_answers.last().map(|answer: &v1::FrameAnswer| answer.sequence);
        assert_eq!(opened.last_committed_sequence, last);
        let answer = raw.answered(wire(as_histogram(sequence))).await;
        assert_eq!(told(&answer), decided(event, reference_by_words()), "frame {sequence}");
        first_answers.push(answer);
    }
    let (mut raw, _) = localizer(&server, "looker").await;
    for (sequence, first) in returning.zip(&first_answers) {
        let again = raw.answered(wire(as_histogram(sequence))).await;
        assert_eq!(again, v1::FrameAnswer { timings: None, resent: true, ..first.clone() });
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_last_hundred_answers_are_kept() {
    const KEPT: u64 = 100;
    const FRAMES: u64 = KEPT + 5;
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "mapper", 1..=20).await;
    let (mut raw, _) = localizer(&server, "looker").await;
    for sequence in 1..=FRAMES {
        assert!(!raw.answered(wire(as_histogram(sequence))).await.resent);
    }
    for forgotten in [1, FRAMES - KEPT] {
        let status = raw.refused(wire(as_histogram(forgotten))).await.status.unwrap();
        let said = (Code::from(status.code), status.message.as_str());
        assert_status("forgotten", said, Code::FailedPrecondition, "number frames upwards");
    }
    for kept in [FRAMES - KEPT + 1, FRAMES] {
        assert!(raw.answered(wire(as_histogram(kept))).await.resent, "frame {kept}");
    }
    assert!(!raw.answered(wire(as_histogram(FRAMES + 1))).await.resent);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_later_stream_takes_a_localizing_session_over() {
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "mapper", 1..=5).await;
    let (mut first, _) = localizer(&server, "looker").await;
    first.answered(wire(as_histogram(1))).await;
    let (mut second, opened) = localizer(&server, "looker").await;
    assert_eq!(opened.last_committed_sequence, Some(1));
    // The first hears of it whether it sends anything or not.
    let status = first.next().await.expect_err("the first stream goes on");
    assert_status("first", (status.code(), status.message()), Code::Aborted, "took this session over");
    second.answered(wire(as_histogram(2))).await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_name_is_not_for_both_mapping_and_localizing() {
    use v1::SessionMode::{Localize, Map};
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "mapper", 1..=5).await;
    let (mut looker, _) = localizer(&server, "looker").await;
    looker.answered(wire(as_histogram(1))).await;
    let before = (client.map("drive", v1::MapView::Full).await.unwrap(), rows(&server).await);
    for (name, mode, fragment) in [
        ("mapper", Localize, "choose another name for localizing"),
        ("looker", Map, "choose another name for the session"),
    ] {
        let status = refusal_to_open(&server, opening(name, mode)).await;
        assert_status(name, (status.code(), status.message()), Code::FailedPrecondition, fragment);
    }
    assert_eq!((client.map("drive", v1::MapView::Full).await.unwrap(), rows(&server).await), before);

    // Names that are made up clash with neither.
    let mut names = Vec::new();
    let mut streams = Vec::new();
    for mode in [Localize, Map, Localize, Map] {
        let (raw, opened) = RawStream::open(&server.endpoint(), opening("", mode)).await.unwrap();
        streams.push(raw);
        names.push(opened.session);
    }
    names.sort();
    names.dedup();
    assert_eq!(names.len(), 4, "{names:?}");
    looker.answered(wire(as_histogram(2))).await;
    server.stop().await;
}

/// Waits until the server has heard that a stream is closed: until then `open` is refused.
async fn opened_at_last(server: &Server, opening: v1::OpenSession) -> (RawStream, v1::SessionOpened) {
    in_time(async {
        loop {
            match RawStream::open(&server.endpoint(), opening.clone()).await {
                Ok(opened) => return opened,
                Err(_) => tokio::time::sleep(Duration::from_millis(10)).await,
            }
        }
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_is_free_for_mapping_when_nobody_localizes_by_it_any_more() {
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "mapper", 1..=5).await;
    let (mut looker, _) = localizer(&server, "looker").await;
    looker.answered(wire(as_histogram(1))).await;
    drop(looker);
    let (mut raw, opened) = opened_at_last(&server, opening("looker", v1::SessionMode::Map)).await;
    assert_eq!(opened.last_committed_sequence, None);
    assert!(!raw.answered(wire(as_histogram(1))).await.resent);
    // From now on it is a mapping session.
    let status = refusal_to_open(&server, opening("looker", v1::SessionMode::Localize)).await;
    let said = (status.code(), status.message());
    assert_status("looker", said, Code::FailedPrecondition, "choose another name for localizing");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_run_begins_anew_and_the_same_one_goes_on() {
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "mapper", 1..=20).await;
    let run = |run: &str| {
        let localize = opening("looker", v1::SessionMode::Localize);
        v1::OpenSession { run_id: run.to_owned(), ..localize }
    };
    let events = reference_by_words().localized([(20, 5..=7)]);
    for name in ["first", "second"] {
        let mut last = None;
        for event in &events {
            // A connection for each frame.
            let (mut raw, opened) = RawStream::open(&server.endpoint(), run(name)).await.unwrap();
            assert_eq!(opened.last_committed_sequence, last, "{name}");
            let answer = raw.answered(wire(as_histogram(event.sequence))).await;
            assert_eq!(
                (told(&answer), answer.resent),
                (decided(event, reference_by_words()), false),
                "{name}"
            );
            last = Some(event.sequence);
        }
    }
    // Without a run whatever is there is resumed.
    let (_, opened) = localizer(&server, "looker").await;
    assert_eq!(opened.last_committed_sequence, Some(7));
    // A stream of the run before hears that it is over, and does not spoil the new one.
    let (mut before, _) = RawStream::open(&server.endpoint(), run("second")).await.unwrap();
    let (mut after, opened) = RawStream::open(&server.endpoint(), run("third")).await.unwrap();
    assert_eq!(opened.last_committed_sequence, None);
    let status = before.next().await.expect_err("the stream goes on");
    assert_status("second", (status.code(), status.message()), Code::Aborted, "took this session over");
    assert!(!after.answered(wire(as_histogram(5))).await.resent);
    let status = refusal_to_open(&server, run("no id")).await;
    assert_status("bad run", (status.code(), status.message()), Code::InvalidArgument, "run id");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_who_localizes_is_forgotten_for_another() {
    const MOST: usize = 256;
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "mapper", 1..=5).await;
    let localize = |number: usize| opening(&format!("looker-{number}"), v1::SessionMode::Localize);
    let channels = [channel(&server.endpoint()).await, channel(&server.endpoint()).await];
    let mut streams = Vec::new();
    for number in 0..MOST {
        let channel = channels[number % channels.len()].clone();
        let mut stream = RawStream::begin_over(channel, Open(localize(number))).await.unwrap();
        stream.next().await.unwrap();
        streams.push(stream);
    }
    streams[0].answered(wire(as_histogram(1))).await;
    let status = refusal_to_open(&server, localize(MOST)).await;
    let said = (status.code(), status.message());
    assert_status("one too many", said, Code::ResourceExhausted, "ask again when one has ended");
    assert!(!streams[0].answered(wire(as_histogram(2))).await.resent);
    assert!(!streams[MOST - 1].answered(wire(as_histogram(1))).await.resent);

    // The one without a stream gives way, though another has been silent for longer.
    drop(streams.pop());
    let (mut latest, _) = opened_at_last(&server, localize(MOST)).await;
    latest.answered(wire(as_histogram(1))).await;
    streams[1].answered(wire(as_histogram(1))).await;
    assert!(!streams[0].answered(wire(as_histogram(3))).await.resent);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_localizer_sees_the_map_grow() {
    let (server, client) = Server::with_map_of_words().await;
    let stages = [(40, 30..=45), (80, 46..=60), (99, 100..=110)];
    let (mut looker, _) = localizer(&server, "looker").await;
    let (mut grown, mut answers) = (0, Vec::new());
    for (so_far, sequences) in stages.clone() {
        mapped(&client, "mapper", grown + 1..=so_far).await;
        grown = so_far;
        for sequence in sequences {
            answers.push(looker.answered(wire(as_histogram(sequence))).await);
        }
    }
    for (answer, event) in answers.iter().zip(&reference_by_words().localized(stages)) {
        assert_eq!(told(answer), decided(event, reference_by_words()), "frame {}", event.sequence);
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_that_look_leave_one_that_maps_alone() {
    let (server, client) = Server::with_map_of_words().await;
    let all = || 1..=frame_count();
    let looking = async |name: &str| answers_of(&client, localizing(name), all().map(as_histogram)).await;
    let (answers, one, other) =
        tokio::join!(mapped(&client, "mapper", all()), looking("one"), looking("other"));
    assert_eq!((one.len(), other.len()), (answers.len(), answers.len()));
    for (answer, event) in answers.iter().zip(&reference_by_words().events) {
        assert_eq!(told(answer), decided(event, reference_by_words()), "frame {}", event.sequence);
    }
    assert_eq!(state_hash(&client, "drive").await, reference_by_words().maps[answers.len()].state_hash);
    server.stop().await;
}

/// A server that starts anew knows nothing of robots that look: the client library opens again and goes on.
#[tokio::test(flavor = "multi_thread")]
async fn a_restart_of_the_server_is_not_noticed() {
    const FRAMES: u64 = 24;
    const RESTARTED_AFTER: [u64; 2] = [0, 12];
    let directory = tempfile::tempdir().unwrap();
    let proxy = Proxy::start().await;
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    mapped(&client, "mapper", 1..=30).await;
    let before = state_hash(&client, "drive").await;

    proxy.forward_to(Some(server.grpc()));
    let robot = Client::connect(&proxy.endpoint()).await.unwrap();
    let session = robot.open_session(localizing("looker")).await.unwrap();
    let server = stream_through(session, FRAMES, as_histogram, server, |answered, server| {
        if !RESTARTED_AFTER.contains(&answered) {
            return server;
        }
        proxy.forward_to(None);
        server.stop();
        let server = ServerProcess::start(directory.path());
        proxy.forward_to(Some(server.grpc()));
        server
    })
    .await;
    assert_eq!(state_hash(&server.client().await, "drive").await, before);
    server.stop();
}

#[test]
fn the_command_line_localizes() {
    const FRAMES: usize = 12;
    let waypost = CommandLine::new();
    waypost.prepare();
    let folder = folder(FRAMES);
    let stream = ["stream", path(folder.path()), "--map", "drive"];
    waypost.json(&[&stream[..], &["--session", "mapper", "--words"]].concat());
    let before = waypost.json(&["map", "show", "drive"]);
    let localize = [&stream[..], &["--session", "looker", "--localize"]].concat();
    for words in [&[][..], &["--words=histogram"]] {
        let summary = waypost.json(&[&localize[..], words].concat());
        assert_eq!(summary["session"], "maps/drive/sessions/looker");
        assert_eq!((&summary["refused"], &summary["places_created"]), (&0.into(), &0.into()), "{summary}");
        let rows = summary["frames"].as_array().unwrap();
        let events = reference_by_words().localized([(FRAMES as u64, 1..=FRAMES as u64)]);
        for (row, event) in rows.iter().zip(&events) {
            assert_eq!(row["place_number"].as_u64(), event.decision.place.map(u64::from), "{row}");
        }
        assert_eq!(rows.len(), FRAMES);
        // Also the second time nothing is told from memory.
        assert!(summary["resumed_after_sequence"].is_null(), "{summary}");
        assert!(rows.iter().all(|row| row["resent"] == false), "{summary}");
        let text = waypost.text(&localize);
        let counts_frames = |line: &str| line.split_whitespace().eq(["frames", &FRAMES.to_string()]);
        assert!(text.contains("begun") && text.lines().any(counts_frames), "{text}");
    }
    assert_eq!(waypost.json(&["map", "show", "drive"]), before);
    assert_eq!(waypost.json(&["session", "ls", "drive"])["sessions"].as_array().unwrap().len(), 1);
    // A name that maps cannot look.
    let (code, stderr) = waypost.fails(&[&stream[..], &["--session", "mapper", "--localize"]].concat());
    assert_eq!(code, 4, "{stderr}");
    assert!(stderr.contains("choose another name for localizing"), "{stderr}");
}
