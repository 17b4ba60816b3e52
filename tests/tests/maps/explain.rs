//! Why frames were decided as they were: explanations fit what was decided, to the bit.

use std::time::Duration;

use waypost_client::{Client, Code, FrameContent, FrameInput, v1};

use crate::harness::{
    CommandLine, Server, ServerProcess, answers_of, as_histogram, assert_status, by_words_request,
    first_return, folder, frame, import_model, mapped, path, recalibrated_model, reference_by_words, refused,
    take_model, words_options,
};

const GATES: [&str; 4] = ["words", "known_place", "guard", "threshold"];

fn frame_name(map: &str, session: &str, sequence: u64) -> String {
    format!("maps/{map}/sessions/{session}/frames/{sequence}")
}

/// The words that are listed and the rest come to what the place has over the average one.
#[track_caller]
pub(crate) fn assert_adds_up(explanation: &v1::PlaceExplanation, asked: usize) {
    let v1::PlaceExplanation {
        words_for, words_against, other_words_evidence_nats: other_words_nats, ..
    } = explanation;
    assert!(words_for.len() <= asked && words_against.len() <= asked, "more than {asked} words");
    assert!(
        words_for.iter().all(|word| word.evidence_nats > 0.0)
            && words_against.iter().all(|word| word.evidence_nats < 0.0)
    );
    assert!(
        words_for.is_sorted_by(|a, b| a.evidence_nats >= b.evidence_nats)
            && words_against.is_sorted_by(|a, b| a.evidence_nats <= b.evidence_nats)
    );
    let listed: f64 = words_for.iter().chain(words_against).map(|word| word.evidence_nats).sum();
    let over_average = explanation.log_likelihood - explanation.average_place_log_likelihood;
    let gap = (listed + other_words_nats - over_average).abs();
    assert!(gap < 1e-9, "{listed} + {other_words_nats} is not {over_average}");
}

/// What is explained is what was answered.
#[track_caller]
fn assert_explains(explained: &v1::FrameExplanation, answer: &v1::FrameAnswer) {
    let case = format!("frame {}: {explained:?}", answer.sequence);
    assert!(explained.reproduced, "{case}");
    assert_eq!(explained.reason(), answer.reason(), "{case}");
    let Some(place) = &explained.place_explanation else {
        assert!(answer.places.is_empty() && explained.gates.is_empty(), "{case}");
        return;
    };
    assert_adds_up(place, 10);
    let [words, known_place, guard, threshold] = explained.gates.as_slice() else { panic!("{case}") };
    assert_eq!([words, known_place, guard, threshold].map(|gate| gate.name.as_str()), GATES);
    let passed = [words, known_place, guard, threshold].map(|gate| gate.passed);
    let new_place = place.new_place_posterior.to_bits();
    match answer.reason() {
        v1::Reason::LoopClosure => {
            assert_eq!(passed, [true; 4], "{case}");
            assert_eq!(
                (Some(place.place_number), place.posterior),
                (answer.place_number, answer.posterior),
                "{case}"
            );
        }
        v1::Reason::SamePlace => {
            assert_eq!(passed[..3], [true, true, false], "{case}");
            assert_eq!(
                (Some(place.place_number), place.posterior),
                (answer.place_number, answer.posterior),
                "{case}"
            );
        }
        v1::Reason::BelowThreshold => {
            assert_eq!(passed, [true, true, true, false], "{case}");
            let closure = answer.r#match.as_ref().expect("a closure that was not accepted");
            assert_eq!(
                (place.place_number, place.posterior),
                (closure.place_number, closure.posterior),
                "{case}"
            );
        }
        v1::Reason::NewPlace => {
            assert_eq!(passed[..2], [true, false], "{case}");
            assert_eq!(place.place_number, answer.places[0].place_number, "{case}");
            assert_eq!(place.posterior.to_bits(), answer.places[0].posterior.to_bits(), "{case}");
        }
        v1::Reason::TooFewWords => assert!(!passed[0], "{case}"),
        // The maps here are not verified.
        v1::Reason::GeometryRefused | v1::Reason::Unspecified => panic!("{case}"),
    }
    if answer.reason() != v1::Reason::TooFewWords {
        assert_eq!(new_place, answer.new_place_posterior.to_bits(), "{case}");
        let gate_values = (known_place.value, known_place.required, threshold.value);
        assert_eq!(gate_values, (place.posterior, place.new_place_posterior, place.posterior), "{case}");
    }
    assert_eq!(words.value, f64::from(answer.words), "{case}");
    for gate in [words, known_place, threshold] {
        assert_eq!(gate.passed, gate.value >= gate.required, "{case}");
    }
    assert!(explained.gates.iter().all(|gate| !gate.description.is_empty()), "{case}");
}

/// Explains every frame of a session, and gives the reasons that there were.
async fn explain_all(
    client: &Client,
    map: &str,
    session: &str,
    answers: &[v1::FrameAnswer],
) -> Vec<v1::Reason> {
    for answer in answers {
        let name = frame_name(map, session, answer.sequence);
        let explained = client.explain_frame(&name, None, Some(0)).await.unwrap();
        assert_eq!(explained.name, name);
        assert_explains(&explained, answer);
    }
    let mut reasons: Vec<v1::Reason> = answers.iter().map(v1::FrameAnswer::reason).collect();
    reasons.sort();
    reasons.dedup();
    reasons
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_every_reason_are_explained() {
    let (server, client) = Server::with_map_of_words().await;
    let verification = v1::map_settings::Verification::None.into();
    let strict = v1::MapSettings { closure_threshold: Some(1.0), verification, ..v1::MapSettings::default() };
    let strict = v1::CreateMapRequest { settings: Some(strict), ..by_words_request("strict", "shipped") };
    client.create_map(strict).await.unwrap();
    let mut reasons = Vec::new();
    for map in ["drive", "strict"] {
        let few = v1::WordHistogram { words: vec![3, 5], counts: vec![1, 2] };
        let few = FrameInput { content: FrameContent::Histogram(few), ..frame(26) };
        let frames = (1..=25).map(as_histogram).chain([few]);
        let frames = frames.chain((first_return()..first_return() + 12).map(as_histogram));
        let answers = answers_of(&client, words_options(map, "robot"), frames.collect::<Vec<_>>()).await;
        reasons.extend(explain_all(&client, map, "robot", &answers).await);
    }
    use v1::Reason::{BelowThreshold, LoopClosure, NewPlace, SamePlace, TooFewWords};
    for reason in [NewPlace, SamePlace, LoopClosure, BelowThreshold, TooFewWords] {
        assert!(reasons.contains(&reason), "no frame came to {reason:?}: {reasons:?}");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn any_place_of_that_time_can_be_asked_about() {
    const MAPPED: u64 = 60;
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "robot", 1..=MAPPED).await;
    for sequence in [2, 20, MAPPED] {
        let posteriors = &reference_by_words().posteriors[sequence as usize - 1];
        let name = frame_name("drive", "robot", sequence);
        for place in [0, posteriors.len() / 2, posteriors.len() - 1] {
            let explained = client.explain_frame(&name, Some(place as u32), Some(3)).await.unwrap();
            let explanation = explained.place_explanation.expect("there is that place");
            assert!(explained.reproduced);
            assert_eq!(explanation.place_number as usize, place);
            assert_eq!(explanation.posterior.to_bits(), posteriors[place].to_bits(), "{name}, place {place}");
            assert_adds_up(&explanation, 3);
        }
        // Places that came later, this frame's own among them, and ones that never did.
        for place in [posteriors.len() as u32, u32::MAX] {
            let (code, message) = refused(client.explain_frame(&name, Some(place), Some(3)).await);
            assert_status(&name, (code, &message), Code::NotFound, "there was no place");
            assert!(message.contains(&format!("there were {}", posteriors.len())), "{message}");
        }
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn old_frames_are_explained_after_restarts_and_other_models() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    import_model(&client).await;
    client.create_map(by_words_request("drive", "shipped")).await.unwrap();
    let mut answers = mapped(&client, "robot", 1..=20).await;
    server.stop().await;

    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    explain_all(&client, "drive", "robot", &answers).await;
    // Through three models, with nothing mapped by the second, and back to the first.
    for (name, rate) in [("keen", 0.7), ("dull", 0.3)] {
        take_model(&client, name, &recalibrated_model(rate)).await;
    }
    client.rebind_map("drive", "keen").await.unwrap();
    client.rebind_map("drive", "dull").await.unwrap();
    answers.extend(mapped(&client, "robot", 21..=30).await);
    client.rebind_map("drive", "shipped").await.unwrap();
    answers.extend(mapped(&client, "robot", 31..=35).await);
    explain_all(&client, "drive", "robot", &answers).await;
    server.stop().await;

    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    explain_all(&client, "drive", "robot", &answers).await;
    // A model that is gone cannot tell any more; what was logged holds.
    client.delete_model("dull").await.unwrap();
    let name = frame_name("drive", "robot", 25);
    let explained = client.explain_frame(&name, None, Some(0)).await.unwrap();
    assert!(!explained.reproduced);
    assert_eq!(explained.reason(), answers[24].reason());
    assert_eq!(client.frame(&name).await.unwrap().answer.unwrap().posterior, answers[24].posterior);
    server.stop().await;
}

#[test]
fn the_command_line_explains() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let folder = folder(6);
    waypost.json(&["stream", path(folder.path()), "--map", "drive", "--session", "robot", "--words"]);
    let explained = waypost.json(&["explain", "drive", "robot", "6", "--words", "4"]);
    assert_eq!(explained["name"], "maps/drive/sessions/robot/frames/6");
    assert_eq!(explained["reproduced"], true);
    assert_eq!(explained["gates"].as_array().unwrap().len(), GATES.len());
    assert_eq!(explained["place_explanation"]["words_for"].as_array().unwrap().len(), 4);
    let about = waypost.json(&["explain", "maps/drive", "robot", "6", "--place", "0"]);
    assert_eq!(about["place_explanation"]["place_number"], 0);
    let posterior = reference_by_words().posteriors[5][0];
    assert!(
        (about["place_explanation"]["posterior"].as_f64().unwrap() - posterior).abs() <= 4.0 * f64::EPSILON
    );
    let first = waypost.json(&["explain", "drive", "robot", "1"]);
    assert_eq!((&first["reason"], &first["place_explanation"]), (&"new_place".into(), &().into()));
    let text = waypost.text(&["explain", "drive", "robot", "6"]);
    assert!(text.contains("evidence against average") && text.contains("threshold"), "{text}");
    for (arguments, fragment) in [
        (&["explain", "drive", "robot", "7"][..], "has no frame 7"),
        (&["explain", "drive", "other", "1"], "has no session other"),
        (&["explain", "drive", "robot", "6", "--place", "99"], "there was no place 99"),
        (&["explain", "drive", "robot", "6", "--words", "101"], "at most 100 words"),
    ] {
        let (code, stderr) = waypost.fails(arguments);
        assert_eq!(code, 4, "{stderr}");
        assert!(stderr.contains(fragment), "{stderr}");
    }
}

/// A replay whose caller has gone ends, and is no fault of the server's.
#[tokio::test(flavor = "multi_thread")]
async fn who_does_not_wait_for_an_explanation_is_no_fault() {
    const FRAMES: u64 = 150;
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(by_words_request("drive", &model.name)).await.unwrap();
    answers_of(&client, words_options("drive", "robot"), (1..=FRAMES).map(as_histogram)).await;
    let last = frame_name("drive", "robot", FRAMES);
    let explained = async || client.explain_frame(&last, None, Some(0)).await;
    let began = std::time::Instant::now();
    explained().await.unwrap();
    let whole = began.elapsed();
    let mut gone = 0;
    for step in 1..20 {
        gone += u32::from(tokio::time::timeout(whole * step / 20, explained()).await.is_err());
    }
    assert!(gone > 0, "all were explained within a part of {whole:?}");
    explained().await.unwrap();
    tokio::time::sleep(Duration::from_millis(100)).await;
    let log = server.log();
    assert!(log.contains(" INFO ") && !log.contains("ERROR"), "{log}");
}
