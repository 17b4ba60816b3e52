//! Words mode: what a robot makes of its images itself decides as its images do.

use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

use waypost_client::{Code, FrameContent, FrameInput, v1};
use waypost_proto::v1::stream_request::Content::Open;

use crate::harness::{
    CommandLine, RawStream, Server, Told, answers_of, as_histogram, as_words, assert_status,
    by_words_request, decided, first_return, folder, frame, frame_count, histogram, images, map_request,
    model_of_other_words, open, path, reference_by_words, refused, state_hash, take_model, told, wire,
    word_maker, words_options,
};

/// What was decided, and the places that were listed, with the bits of every number.
fn all_told(answers: &[v1::FrameAnswer]) -> Vec<(Told, Vec<(u32, u64)>)> {
    let places = |answer: &v1::FrameAnswer| {
        answer.places.iter().map(|place| (place.place_number, place.posterior.to_bits())).collect()
    };
    answers.iter().map(|answer| (told(answer), places(answer))).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn images_words_and_histograms_decide_alike() {
    let (server, client) = Server::with_map_of_words().await;
    // There and back again: loops are closed.
    let sequences = || (1..=25).chain(first_return()..first_return() + 12);
    type Form = fn(u64) -> FrameInput;
    let forms: [(&str, Form); 3] = [("images", frame), ("words", as_words), ("histograms", as_histogram)];
    let mut outcomes = Vec::new();
    for (map, form) in forms {
        client.create_map(by_words_request(map, "shipped")).await.unwrap();
        let answers = answers_of(&client, words_options(map, "robot"), sequences().map(form)).await;
        assert!(answers.iter().any(|answer| answer.reason() == v1::Reason::LoopClosure), "{map}");
        outcomes.push((all_told(&answers), state_hash(&client, map).await));
    }
    assert!(outcomes[1] == outcomes[0], "words decide otherwise than images");
    assert!(outcomes[2] == outcomes[0], "histograms decide otherwise than images");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_mixes_all_forms_decides_as_one_of_images() {
    let (server, client) = Server::with_map_of_words().await;
    let mixed = |sequence| match sequence % 3 {
        0 => frame(sequence),
        1 => as_words(sequence),
        _ => as_histogram(sequence),
    };
    let frames = (1..=frame_count()).map(mixed);
    let answers = answers_of(&client, words_options("drive", "robot"), frames).await;
    for (answer, event) in answers.iter().zip(&reference_by_words().events) {
        assert_eq!(told(answer), decided(event, reference_by_words()), "frame {}", event.sequence);
    }
    assert_eq!(answers.len() as u64, frame_count());
    assert_eq!(state_hash(&client, "drive").await, reference_by_words().maps[answers.len()].state_hash);
    server.stop().await;
}

/// A histogram that leaves its counts out says that each word was seen once.
#[tokio::test(flavor = "multi_thread")]
async fn counts_may_be_left_out_and_words_come_in_any_order() {
    let (server, client) = Server::with_map_of_words().await;
    let full = |sequence| {
        let v1::WordHistogram { words, counts } = histogram(sequence);
        let counts = vec![1; counts.len()];
        v1::WordHistogram { words, counts }
    };
    let bare = |sequence| {
        let mut words = histogram(sequence).words;
        words.reverse();
        v1::WordHistogram { words, counts: Vec::new() }
    };
    let forms: [(&str, &dyn Fn(u64) -> v1::WordHistogram); 2] = [("full", &full), ("bare", &bare)];
    let mut hashes = Vec::new();
    for (map, form) in forms {
        client.create_map(by_words_request(map, "shipped")).await.unwrap();
        let frames = (1..=6).map(|sequence| FrameInput {
            content: FrameContent::Histogram(form(sequence)),
            ..frame(sequence)
        });
        answers_of(&client, words_options(map, "robot"), frames.collect::<Vec<_>>()).await;
        hashes.push(state_hash(&client, map).await);
    }
    assert_eq!(hashes[0], hashes[1]);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn words_must_be_those_of_the_maps_model() {
    let (server, client) = Server::with_map_of_words().await;
    let own = word_maker().words_hash();

    // Not declared: refused frame by frame, and images are still taken.
    let (mut raw, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert_eq!(opened.words_hash, own);
    for (case, undeclared) in [("words", as_words(1)), ("histogram", as_histogram(1))] {
        let status = raw.refused(wire(undeclared)).await.status.unwrap();
        let said = (Code::from(status.code), status.message.as_str());
        assert_status(case, said, Code::InvalidArgument, "give the words_hash of the model");
    }
    raw.answered(wire(frame(1))).await;

    // Declared wrongly: the stream is refused, and the message names what was said and what is needed.
    let before = state_hash(&client, "drive").await;
    let other = take_model(&client, "other", &model_of_other_words()).await;
    client.create_map(map_request("other", "other")).await.unwrap();
    let wrong = "0".repeat(64);
    for (case, map, declared, needed) in [
        ("made up", "drive", wrong.as_str(), own),
        ("cut short", "drive", &own[..20], own),
        ("of another extractor", "other", own, other.words_hash.as_str()),
    ] {
        let opening = v1::OpenSession { words_hash: declared.to_owned(), ..open(map, "words") };
        let refusal = match RawStream::begin(&server.endpoint(), Open(opening)).await {
            Ok(mut stream) => stream.next().await.expect_err(case),
            Err(status) => status,
        };
        assert_status(case, (refusal.code(), refusal.message()), Code::FailedPrecondition, declared);
        assert!(refusal.message().contains(needed), "{case}: {}", refusal.message());
        let content = FrameContent::Histogram(histogram(1));
        let (code, message) = refused(client.query(map, content, declared, Some(0)).await);
        assert_status(case, (code, &message), Code::FailedPrecondition, needed);
    }
    assert_eq!(state_hash(&client, "drive").await, before);
    assert_eq!(client.map("drive", v1::MapView::Unspecified).await.unwrap().sessions, 1);

    // In capitals it is the same hash.
    let opening = v1::OpenSession { words_hash: own.to_uppercase(), ..open("drive", "words") };
    let (mut raw, _) = RawStream::open(&server.endpoint(), opening).await.unwrap();
    raw.answered(wire(as_histogram(1))).await;
    server.stop().await;
}

#[test]
fn the_command_line_sends_words_and_tells_how_few_bytes_they_are() {
    const FRAMES: usize = 8;
    let waypost = CommandLine::new();
    waypost.prepare();
    let folder = folder(FRAMES);
    let mut bytes = Vec::new();
    for form in [None, Some("--words"), Some("--words=histogram")] {
        let map = format!("map-{}", bytes.len());
        waypost.create_by_words(&map);
        let stream = ["stream", path(folder.path()), "--map", &map];
        let summary = waypost.json(&[&stream[..], form.as_slice()].concat());
        assert_eq!((summary["frame_count"].as_u64(), summary["refused"].as_u64()), (Some(8), Some(0)));
        assert_eq!(
            waypost.json(&["map", "show", &map])["state_hash"],
            reference_by_words().maps[FRAMES].state_hash
        );
        bytes.push(summary["bytes_per_frame"].as_f64().unwrap());
    }
    let files: usize = images().iter().take(FRAMES).map(Vec::len).sum();
    assert_eq!(bytes[0], files as f64 / FRAMES as f64);
    assert!(bytes[1] < bytes[0] / 2.0 && bytes[2] < bytes[1] / 4.0, "images, words, histograms: {bytes:?}");
}

#[test]
fn a_model_is_downloaded_once_and_again_if_it_was_damaged() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let folder = folder(2);
    let stream = |session: &str| {
        let stream = ["stream", path(folder.path()), "--map", "drive", "--words", "--session", session];
        assert_eq!(waypost.json(&stream)["refused"], 0, "{session}");
    };
    stream("first");
    let kept = cached_models(&waypost);
    assert_eq!(kept.len(), 1, "{kept:?}");
    let shipped = std::fs::read(crate::harness::model_file()).unwrap();
    assert!(std::fs::read(&kept[0]).unwrap() == shipped, "the cached file is not the model");
    let file_number = || std::fs::metadata(&kept[0]).unwrap().ino();
    let first = file_number();
    stream("second");
    assert_eq!(file_number(), first, "downloaded twice");

    let mut damaged = shipped.clone();
    damaged[shipped.len() / 2] ^= 1;
    for (session, content) in [("flipped", damaged), ("cut", shipped[..1000].to_vec()), ("empty", Vec::new())]
    {
        std::fs::write(&kept[0], content).unwrap();
        stream(session);
        assert!(std::fs::read(&kept[0]).unwrap() == shipped, "{session}: the damaged file was kept");
        assert_eq!(cached_models(&waypost), kept, "{session}: something was left beside it");
    }
}

fn cached_models(waypost: &CommandLine) -> Vec<PathBuf> {
    let directory = waypost.cache().join("waypost/models");
    std::fs::read_dir(directory).unwrap().map(|file| file.unwrap().path()).collect()
}

#[test]
fn an_image_that_no_words_can_be_made_of_is_refused_as_an_image_is() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let folder = folder(3);
    std::fs::write(folder.path().join("000001.jpg"), b"no picture").unwrap();
    for form in [None, Some("--words"), Some("--words=histogram")] {
        let stream = ["stream", path(folder.path()), "--map", "drive", "--json"];
        let output = waypost.run(&[&stream[..], form.as_slice()].concat());
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(5), "{form:?}: {stderr}");
        assert!(
            stderr.contains("000001.jpg") && stderr.contains("neither JPEG nor PNG"),
            "{form:?}: {stderr}"
        );
        let summary = crate::harness::json_object(&String::from_utf8(output.stdout).unwrap());
        assert_eq!((&summary["frame_count"], &summary["refused"]), (&3.into(), &1.into()), "{form:?}");
    }
}
