//! Loop closures that geometry has a say in.

use std::collections::HashSet;

use waypost_client::{Client, FrameInput, SessionOptions, v1};

use crate::harness::{
    Server, ServerProcess, answers, answers_of, as_histogram, as_words, frame, frame_count, import_model,
    session_options, state_hash, words_options, workspace,
};

/// Pairs of images, by index, of `loops.csv` or `ignore.csv`.
fn pairs(file: &str) -> HashSet<(u64, u64)> {
    let text = std::fs::read_to_string(workspace().join("demo/sequence").join(file)).unwrap();
    let pair = |line: &str| {
        let (query, matched) = line.split_once(',').unwrap();
        (query.trim().parse().unwrap(), matched.trim().parse().unwrap())
    };
    text.lines().skip(1).map(pair).collect()
}

async fn verified_map(client: &Client, map: &str, keep: v1::map_settings::Keep) {
    map_verified_by(client, map, keep, v1::map_settings::Verification::Similarity).await;
}

async fn map_verified_by(
    client: &Client,
    map: &str,
    keep: v1::map_settings::Keep,
    verification: v1::map_settings::Verification,
) {
    let settings = v1::MapSettings {
        verification: verification.into(),
        keep: keep.into(),
        ..v1::MapSettings::default()
    };
    let (map_id, model) = (map.to_owned(), "shipped".to_owned());
    let request = v1::CreateMapRequest { map_id, model, settings: Some(settings) };
    let map = client.create_map(request).await.unwrap();
    assert_eq!(map.settings.unwrap().verification(), verification);
}

/// Right and wrong loop closures of the shipped drive; neither where the truth says nothing.
fn judged(answers: &[v1::FrameAnswer]) -> (usize, usize) {
    let (loops, ignored) = (pairs("loops.csv"), pairs("ignore.csv"));
    let closures = answers.iter().filter(|answer| answer.reason() == v1::Reason::LoopClosure);
    let pairs = closures.map(|answer| {
        let matched = answer.r#match.as_ref().and_then(|closure| closure.frame.as_ref()).unwrap();
        (answer.sequence - 1, matched.sequence - 1)
    });
    let pairs: Vec<(u64, u64)> = pairs.collect();
    let right = pairs.iter().filter(|pair| loops.contains(pair)).count();
    (right, pairs.iter().filter(|pair| !loops.contains(pair) && !ignored.contains(pair)).count())
}

/// What an answer says but for what is of the moment.
fn decided(answer: &v1::FrameAnswer) -> v1::FrameAnswer {
    v1::FrameAnswer { timings: None, resent: false, last_committed_sequence: 0, ..answer.clone() }
}

#[tokio::test(flavor = "multi_thread")]
async fn geometry_finds_more_loops_and_none_that_is_wrong() {
    let (server, client) = Server::with_map_of_words().await;
    let of_histograms = (1..=frame_count()).map(as_histogram);
    let by_words = answers_of(&client, words_options("drive", "robot"), of_histograms).await;
    verified_map(&client, "verified", v1::map_settings::Keep::Features).await;
    let verified = answers(&client, "verified", "robot", (1..=frame_count()).map(frame)).await;

    let (right_by_words, _) = judged(&by_words);
    let (right, wrong) = judged(&verified);
    assert_eq!(wrong, 0);
    assert!(right > right_by_words, "{right} of geometry, {right_by_words} of words alone");
    assert!(
        by_words.iter().all(|answer| answer.r#match.as_ref().is_none_or(|found| found.geometry.is_none()))
    );
    let unverified = client.loop_closures("drive").await.unwrap();
    assert!(!unverified.is_empty() && unverified.iter().all(|one| one.probability.is_none()));
    let listed = client.loop_closures("verified").await.unwrap();
    for answer in verified.iter().filter(|answer| answer.reason() == v1::Reason::LoopClosure) {
        let geometry = answer.r#match.as_ref().unwrap().geometry.as_ref().unwrap();
        assert!(geometry.inliers >= 8 && geometry.inliers <= geometry.matches, "{geometry:?}");
        let listed =
            listed.iter().find(|one| one.frame.as_ref().unwrap().sequence == answer.sequence).unwrap();
        assert_eq!(listed.probability, Some(geometry.probability));
        assert!((0.0..=1.0).contains(&geometry.probability), "{geometry:?}");
        assert!(geometry.similarity.is_some_and(|motion| motion.x_widths.hypot(motion.y_widths) <= 0.5));
    }
    server.stop().await;
}

/// The same decisions after a restart, by a robot that only looks, and in explanations.
#[tokio::test(flavor = "multi_thread")]
async fn what_geometry_decided_is_in_the_log() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    import_model(&client).await;
    verified_map(&client, "hall", v1::map_settings::Keep::Features).await;
    let half = frame_count() * 3 / 4;
    let first = answers(&client, "hall", "robot", (1..=half).map(as_words)).await;
    let before = state_hash(&client, "hall").await;
    server.kill();
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    assert_eq!(state_hash(&client, "hall").await, before);
    let resent = answers(&client, "hall", "robot", (1..=half).map(as_words)).await;
    assert!(resent.iter().zip(&first).all(|(resent, first)| decided(resent) == decided(first)));
    let rest = answers(&client, "hall", "robot", (half + 1..=frame_count()).map(as_words)).await;

    // A server that was never stopped decides the same.
    verified_map(&client, "whole", v1::map_settings::Keep::Features).await;
    let whole = answers(&client, "whole", "robot", (1..=frame_count()).map(as_words)).await;
    let unnamed = |answer: &v1::FrameAnswer| {
        let place = |found: &Option<v1::Match>| {
            found.as_ref().map(|found| (found.place_number, found.geometry.clone()))
        };
        (answer.reason(), answer.place_number, place(&answer.r#match), place(&answer.best_candidate))
    };
    let cut: Vec<_> = first.iter().chain(&rest).map(unnamed).collect();
    assert_eq!(cut, whole.iter().map(unnamed).collect::<Vec<_>>());
    assert_eq!(state_hash(&client, "hall").await, state_hash(&client, "whole").await);

    let closed = rest.iter().find(|answer| answer.reason() == v1::Reason::LoopClosure).unwrap();
    let name = format!("maps/hall/sessions/robot/frames/{}", closed.sequence);
    let explained = client.explain_frame(&name, None, Some(0)).await.unwrap();
    assert!(explained.reproduced, "{explained:?}");
    let gate = |name: &str| explained.gates.iter().find(|gate| gate.name == name).unwrap();
    let geometry = closed.r#match.as_ref().unwrap().geometry.as_ref().unwrap();
    assert_eq!(gate("inliers").value, f64::from(geometry.inliers));
    assert!(gate("inliers").passed && gate("translation").passed && gate("rotation").passed);
    assert_eq!(gate("probability").value, geometry.probability);
    assert!(gate("probability").passed && geometry.look_alike_inliers > 0.0);
    // What decides nothing is no condition.
    assert!(explained.gates.iter().all(|gate| gate.passed && gate.name != "known_place"), "{explained:?}");

    let looked = answers(&client, "hall", "lookout", (closed.sequence..=closed.sequence).map(as_words)).await;
    assert!(looked[0].best_candidate.as_ref().unwrap().geometry.is_some());
    drop(server);
}

/// Words with their places in the image are enough; without any there is nothing to verify.
#[tokio::test(flavor = "multi_thread")]
async fn words_are_verified_by_where_they_are() {
    let (server, client) = Server::with_map().await;
    verified_map(&client, "words", v1::map_settings::Keep::Features).await;
    let drive = |frame: fn(u64) -> FrameInput| (1..=frame_count()).map(frame);
    let of_words = answers_of(&client, words_options("words", "robot"), drive(as_words)).await;
    let (right, wrong) = judged(&of_words);
    assert!(right > 0 && wrong == 0, "{right} right, {wrong} wrong");

    verified_map(&client, "histograms", v1::map_settings::Keep::Features).await;
    let of_histograms = answers_of(&client, words_options("histograms", "robot"), drive(as_histogram)).await;
    let words = v1::map_settings::Keep::Words;
    map_verified_by(&client, "lean", words, v1::map_settings::Verification::None).await;
    let unkept = answers_of(&client, session_options("lean", "robot"), drive(frame)).await;
    for answer in of_histograms.iter().chain(&unkept) {
        assert!(answer.r#match.as_ref().is_none_or(|found| found.geometry.is_none()), "{answer:?}");
    }
    server.stop().await;
}

/// The phone of the shipped drive, about.
fn phone(image_width_px: u32, image_height_px: u32) -> v1::Camera {
    let model = v1::camera::Model::FieldOfView(v1::FieldOfView { horizontal_rad: 1.1 });
    v1::Camera {
        model: Some(model),
        image_width_px: Some(image_width_px),
        image_height_px: Some(image_height_px),
        base_to_camera: None,
    }
}

fn seen_by(map: &str, session: &str, camera: Option<v1::Camera>) -> SessionOptions {
    SessionOptions { camera, ..session_options(map, session) }
}

/// Only an essential matrix has a rotation, and so a gate for it.
#[tokio::test(flavor = "multi_thread")]
async fn views_of_known_cameras_are_judged_by_the_essential_matrix() {
    /// The last frames, by a robot that only looks.
    const LOOKED_AT: u64 = 10;
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    import_model(&client).await;
    let cameras = [("known", Some(phone(1280, 720)), true), ("unknown", None, false)];
    let mut told = Vec::new();
    for (map, camera, _) in &cameras {
        let (keep, epipolar) = (v1::map_settings::Keep::Features, v1::map_settings::Verification::Epipolar);
        map_verified_by(&client, map, keep, epipolar).await;
        let drive = (1..=frame_count() - LOOKED_AT).map(frame);
        told.push(answers_of(&client, seen_by(map, "robot", camera.clone()), drive).await);
    }
    // Cameras are read back from the disk, too.
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let mut by_map = Vec::new();
    for ((map, camera, essential), told) in cameras.iter().zip(&told) {
        let (right, wrong) = judged(told);
        assert!(right > 0 && wrong == 0, "{map}: {right} right, {wrong} wrong");
        let closures = told.iter().filter_map(|answer| Some((answer.sequence, answer.r#match.as_ref()?)));
        let compared: Vec<_> =
            closures.filter_map(|(sequence, found)| Some((sequence, found.geometry.as_ref()?))).collect();
        assert!(compared.len() > 3, "{map}: {compared:?}");
        for (sequence, geometry) in compared.iter().take(4) {
            let name = format!("maps/{map}/sessions/robot/frames/{sequence}");
            let explained = client.explain_frame(&name, None, Some(0)).await.unwrap();
            assert!(explained.reproduced, "{map}: {explained:?}");
            let gate = |name: &str| explained.gates.iter().find(|gate| gate.name == name);
            assert_eq!(gate("inliers").unwrap().value, f64::from(geometry.inliers));
            assert_eq!(gate("rotation").is_some(), *essential, "{map}: {explained:?}");
            assert_eq!(gate("translation"), None, "{map}: {explained:?}");
        }
        let looking = seen_by(map, "lookout", camera.clone());
        let looking = SessionOptions { mode: v1::SessionMode::Localize, ..looking };
        let looked =
            answers_of(&client, looking, (frame_count() - LOOKED_AT + 1..=frame_count()).map(frame)).await;
        let inliers =
            |answer: &v1::FrameAnswer| Some(answer.best_candidate.as_ref()?.geometry.as_ref()?.inliers);
        by_map.push(looked.iter().map(inliers).collect::<Vec<_>>());
    }
    assert!(by_map[0].iter().flatten().count() > 3, "{by_map:?}");
    assert!(by_map[0] != by_map[1], "{by_map:?}");
    server.stop().await;
}
