//! Maps of a simulated building become one through the real server, and two again.

use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::relaxation::Pose as _;
use topomap::trajectory::{from_tum, to_tum};
use waypost_client::v1::export_poses_request::{Body, Format, Frame};
use waypost_client::v1::merge::State;
use waypost_client::v1::merge_maps_request::OnceFound;
use waypost_client::v1::merge_source::Outcome;
use waypost_client::{Client, Code, FrameOutcome, SessionOptions, v1};
use waypost_sim::robot::WheelErrors;
use waypost_sim::simulation::CameraFrame;
use waypost_sim::worlds::NamedWorld;

use crate::harness::{
    Building, Drive, Server, ServerProcess, answers, assert_status, camera_ahead, evo_rmse_m, exported,
    followed, found, frame, get, http, images, import_model, map_request, model_of_other_words, planar,
    refused, session_options, state_hash, stream, take_model,
};

/// Twice round a ring of corridors: a round each day.
struct Rounds(Drive);

impl Rounds {
    fn new() -> Self {
        let wheels = WheelErrors { scale: 0.01, drift_rad_per_m: 0.2_f64.to_radians(), ..WheelErrors::NONE };
        Self(Drive::new(Building::new(NamedWorld::Loop, 3, "twice"), wheels, 3))
    }

    /// A round, the first or the second.
    fn day(&self, day: usize) -> &[CameraFrame] {
        let (first, second) = self.0.frames.split_at(self.0.frames.len() / 2);
        if day == 0 { first } else { second }
    }

    /// Makes a map of a day.
    async fn map(&self, client: &Client, model: &v1::Model, map: &str, day: usize) {
        client.create_map(map_request(map, &model.name)).await.unwrap();
        let outcomes = self.drive(client, map, "robot", self.day(day)).await;
        assert_eq!(outcomes.len(), self.day(day).len());
    }

    async fn drive(
        &self,
        client: &Client,
        map: &str,
        session: &str,
        frames: &[CameraFrame],
    ) -> Vec<v1::FrameAnswer> {
        let options = SessionOptions { camera: Some(camera_ahead()), ..session_options(map, session) };
        let outcomes = stream(client.open_session(options).await.unwrap(), self.0.inputs_of(frames)).await;
        let answer = |outcome| match outcome {
            FrameOutcome::Answer(answer) => answer,
            FrameOutcome::Refusal(refusal) => panic!("{refusal:?}"),
        };
        outcomes.into_iter().map(answer).collect()
    }

    /// A drive on the map as TUM.
    async fn exported(&self, client: &Client, session: &str) -> Vec<u8> {
        exported(client, session, Format::Tum, Frame::Map, Body::Base).await
    }

    /// Root mean square of how far the frames of a session are from the truth, in the frame of the first day's first.
    async fn rmse_m(&self, client: &Client, session: &str) -> f64 {
        self.0.rmse_m(&from_tum(&self.exported(client, session).await).unwrap())
    }
}

fn request(sources: &[&str], target: &str, once_found: OnceFound) -> v1::MergeMapsRequest {
    v1::MergeMapsRequest {
        sources: sources.iter().map(|map| format!("maps/{map}")).collect(),
        target: format!("maps/{target}"),
        once_found: once_found.into(),
        min_support: None,
    }
}

/// The merge once its job is done.
async fn done(client: &Client, merge: &v1::Merge) -> v1::Merge {
    let job = client.job(&merge.job).await.unwrap();
    followed(client, &job).await;
    client.merge(&merge.name).await.unwrap()
}

fn overlap(merge: &v1::Merge) -> &v1::MapOverlap {
    match &merge.sources[0].outcome {
        Some(Outcome::Overlap(overlap)) => overlap,
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn two_maps_become_one_and_two_again() {
    let rounds = Rounds::new();
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    rounds.map(&client, &model, "monday", 0).await;
    rounds.map(&client, &model, "tuesday", 1).await;
    let before = [state_hash(&client, "monday").await, state_hash(&client, "tuesday").await];

    // A preview changes nothing, and says how the maps lie to each other.
    let asked = client.merge_maps(request(&["monday", "tuesday"], "week", OnceFound::Propose)).await.unwrap();
    let proposed = done(&client, &asked).await;
    assert_eq!(proposed.state(), State::Proposed, "{proposed:?}");
    let found_overlap = overlap(&proposed);
    println!("{found_overlap:?}");
    assert!(found_overlap.agreeing_matches >= 20 && found_overlap.fused_places >= 20, "{found_overlap:?}");
    assert!(found_overlap.confirmed_places * 10 >= found_overlap.overlapping_places * 6);
    let pose = found_overlap.transformation.unwrap();
    let apart = planar(&pose).inverse().compose(&rounds.0.truth(rounds.day(0).len()));
    assert!(apart.x_m().hypot(apart.y_m()) < 1.0 && apart.heading_rad().abs() < 0.1, "{apart:?}");
    let strongest = &found_overlap.strongest_matches[0];
    assert!(strongest.source_frame.starts_with("maps/tuesday/sessions/robot/frames/"), "{strongest:?}");
    assert!(strongest.target_frame.starts_with("maps/monday/sessions/robot/frames/"), "{strongest:?}");
    let picture = String::from_utf8(client.merge_picture(&proposed.name).await.unwrap()).unwrap();
    assert!(picture.contains("tuesday before") && picture.contains("together"), "{picture:.400}");
    assert_eq!(get(&server, &format!("/v1/{}/picture", proposed.name)).await.text(), picture);
    assert_eq!([state_hash(&client, "monday").await, state_hash(&client, "tuesday").await], before);
    assert_eq!(refused(client.map("week", v1::MapView::Full).await).0, Code::NotFound);
    // The name is kept for it meanwhile.
    let taken = refused(client.create_map(map_request("week", &model.name)).await);
    assert_eq!(taken.0, Code::AlreadyExists, "{taken:?}");

    let committed = done(&client, &client.commit_merge(&proposed.name).await.unwrap()).await;
    assert_eq!(committed.state(), State::Committed, "{committed:?}");
    assert_eq!(committed.sources[0].sessions, ["tuesday-robot"]);
    let week = client.map("week", v1::MapView::Full).await.unwrap();
    assert_eq!((week.sessions, week.frames), (2, rounds.0.frames.len() as u64));
    let fewer = found_overlap.fused_places;
    let maps = [
        client.map("monday", v1::MapView::Full).await.unwrap(),
        client.map("tuesday", v1::MapView::Full).await.unwrap(),
    ];
    assert_eq!(week.places, maps[0].places + maps[1].places - fewer);
    assert_eq!([&maps[0].state_hash, &maps[1].state_hash], [&before[0], &before[1]]);
    for session in ["robot", "tuesday-robot"] {
        let rmse_m = rounds.rmse_m(&client, &format!("maps/week/sessions/{session}")).await;
        println!("{session}: {rmse_m} m");
        assert!(rmse_m < 0.6, "{session}: {rmse_m} m");
    }
    // Both days as one trajectory, as everybody judges one.
    let mut both = Vec::new();
    for session in ["robot", "tuesday-robot"] {
        both.extend(rounds.exported(&client, &format!("maps/week/sessions/{session}")).await);
    }
    if let Some(rmse_m) = evo_rmse_m("tum", &to_tum(&rounds.0.true_poses()), &both) {
        println!("by evo {rmse_m} m");
        assert!(rmse_m < 0.5, "{rmse_m} m");
    }
    let frame = format!("maps/week/sessions/tuesday-robot/frames/{}", rounds.day(1)[0].number + 1);
    let image = client.frame_picture(&frame, None).await.unwrap();
    assert!(!image.is_empty());

    // What is committed cannot be decided again; the sources may go, and the map stays.
    for refusal in [client.commit_merge(&committed.name).await, client.discard_merge(&committed.name).await] {
        assert_eq!(refused(refusal).0, Code::FailedPrecondition);
    }
    client.delete_map("tuesday").await.unwrap();
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(state_hash(&client, "week").await, week.state_hash);

    // Another robot starts anywhere in it, lost, and is anchored at what it recognises.
    let answers = rounds.drive(&client, "week", "third", &rounds.day(1)[20..40]).await;
    let anchored = answers.iter().position(|answer| answer.reason() == v1::Reason::LoopClosure);
    let anchored = anchored.unwrap_or_else(|| panic!("{answers:?}"));
    assert!(answers[anchored..].iter().all(|answer| answer.map_pose.as_ref().unwrap().part == 0));
    // So the merge's map is not that of the merge alone any more, and does not go as a whole.
    let undone = client.undo_merge(&committed.name).await.unwrap();
    let job = client.job(&undone.job).await.unwrap();
    let last = followed(&client, &job).await.pop().unwrap();
    assert!(last.error.contains("sessions have driven in the map week since"), "{last:?}");
    let job = client.remove_session("maps/week/sessions/third").await.unwrap();
    assert_eq!(followed(&client, &job).await.pop().unwrap().state(), v1::job::State::Succeeded);
    assert_eq!(state_hash(&client, "week").await, week.state_hash);
    let undone = done(&client, &client.undo_merge(&committed.name).await.unwrap()).await;
    assert_eq!(undone.state(), State::Undone, "{undone:?}");
    assert_eq!(refused(client.map("week", v1::MapView::Full).await).0, Code::NotFound);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_merge_into_a_map_is_there_whole_or_not_at_all_and_can_be_undone() {
    const KILLS: u64 = 6;
    let rounds = Rounds::new();
    let directory = tempfile::tempdir().unwrap();
    let mut server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    rounds.map(&client, &model, "monday", 0).await;
    rounds.map(&client, &model, "tuesday", 1).await;
    let monday = client.map("monday", v1::MapView::Full).await.unwrap();
    let tuesday = client.map("tuesday", v1::MapView::Full).await.unwrap();

    // Killed at some moment of it; each time the map is as it was, or whole, and then it is undone.
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let (mut whole, mut nothing) = (0, 0);
    for kill in 0..KILLS {
        let client = server.client().await;
        let asked = client.merge_maps(request(&["tuesday"], "monday", OnceFound::Commit)).await.unwrap();
        if kill == KILLS - 1 {
            done(&client, &asked).await;
        } else {
            tokio::time::sleep(Duration::from_millis(random.random_range(0..1_000) * kill)).await;
        }
        server.kill();
        server = ServerProcess::start(directory.path());
        let client = server.client().await;
        let merge = client.merge(&asked.name).await.unwrap();
        let now = client.map("monday", v1::MapView::Full).await.unwrap();
        assert_eq!(state_hash(&client, "tuesday").await, tuesday.state_hash);
        if merge.state() == State::Committed {
            whole += 1;
            assert_eq!((now.sessions, now.frames), (2, monday.frames + tuesday.frames));
            let undone = done(&client, &client.undo_merge(&merge.name).await.unwrap()).await;
            assert_eq!(undone.state(), State::Undone, "{undone:?}");
            let back = client.map("monday", v1::MapView::Full).await.unwrap();
            assert_eq!((back.state_hash, back.sessions), (monday.state_hash.clone(), 1));
        } else {
            nothing += 1;
            assert_eq!(merge.state(), State::Failed);
            assert!(merge.error.contains("ask for it again"), "{merge:?}");
            assert_eq!(now.state_hash, monday.state_hash);
        }
    }
    println!("{whole} whole, {nothing} nothing");
    assert!(whole >= 1 && nothing >= 1, "{whole} whole, {nothing} nothing");

    // A budget of places: what goes is said first, then done.
    let client = server.client().await;
    let budget = |mode: v1::trim_map_request::Mode| v1::TrimMapRequest {
        name: "maps/tuesday".to_owned(),
        max_places: 60,
        mode: mode.into(),
    };
    let said = client.trim_map(budget(v1::trim_map_request::Mode::Preview)).await.unwrap();
    assert_eq!((said.places_left, said.over), (60, 0), "{said:?}");
    assert_eq!(said.dropped.len() as u64, tuesday.places - 60);
    assert!(said.dropped.iter().all(|dropped| dropped.why.is_some()));
    assert_eq!(state_hash(&client, "tuesday").await, tuesday.state_hash);
    assert_eq!(client.trim_map(budget(v1::trim_map_request::Mode::Apply)).await.unwrap(), said);
    let trimmed = client.map("tuesday", v1::MapView::Full).await.unwrap();
    assert_eq!((trimmed.places, trimmed.frames), (60, tuesday.frames));
    let again = client.trim_map(budget(v1::trim_map_request::Mode::Apply)).await.unwrap();
    assert!(again.dropped.is_empty() && again.places_left == 60, "{again:?}");

    // A robot that drives in the target meanwhile notices nothing, and stays when the merge is undone.
    let client = server.client().await;
    let driving = rounds.drive(&client, "monday", "meanwhile", rounds.day(1));
    let merging = async {
        let asked = client.merge_maps(request(&["tuesday"], "monday", OnceFound::Commit)).await.unwrap();
        done(&client, &asked).await
    };
    let (answers, merge) = tokio::join!(driving, merging);
    assert_eq!((answers.len(), merge.state()), (rounds.day(1).len(), State::Committed), "{merge:?}");
    let both = client.map("monday", v1::MapView::Full).await.unwrap();
    assert_eq!((both.sessions, both.frames), (3, monday.frames + 2 * tuesday.frames));
    let undone = done(&client, &client.undo_merge(&merge.name).await.unwrap()).await;
    assert_eq!(undone.state(), State::Undone, "{undone:?}");
    let after = client.map("monday", v1::MapView::Full).await.unwrap();
    assert_eq!((after.sessions, after.frames), (2, monday.frames + tuesday.frames));
    let sessions = client.sessions("monday").await.unwrap();
    let names: Vec<&str> = sessions.iter().map(|session| session.name.rsplit('/').next().unwrap()).collect();
    assert_eq!(names, ["robot", "meanwhile"]);
    for session in names {
        let rmse_m = rounds.rmse_m(&client, &format!("maps/monday/sessions/{session}")).await;
        assert!(rmse_m < 1.0, "{session}: {rmse_m} m");
    }

    // A map that is compacted keeps what was merged into it.
    let asked = client.merge_maps(request(&["tuesday"], "monday", OnceFound::Commit)).await.unwrap();
    let merge = done(&client, &asked).await;
    assert_eq!(merge.state(), State::Committed, "{merge:?}");
    let before = state_hash(&client, "monday").await;
    let job = client.compact_map("monday").await.unwrap();
    assert_eq!(followed(&client, &job).await.pop().unwrap().result, "maps/monday");
    let answer = refused(client.undo_merge(&merge.name).await);
    assert_status("compacted", (answer.0, &answer.1), Code::FailedPrecondition, "deleted or compacted since");
    assert_eq!(state_hash(&client, "monday").await, before);
    server.stop();
}

/// What was removed is between the rows of the file until the map is compacted.
#[tokio::test(flavor = "multi_thread")]
async fn what_was_removed_is_wiped_from_the_disk() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=5).map(frame)).await;
    answers(&client, "drive", "visitor", (60..=64).map(frame)).await;
    let seen = client
        .frame_image("maps/drive/sessions/visitor/frames/62", v1::get_frame_image_request::Size::Thumbnail)
        .await;
    let seen = seen.unwrap().image;
    let middle = &seen[seen.len() / 2..seen.len() / 2 + 48];
    let traces = || {
        let files = ["waypost.sqlite", "waypost.sqlite-wal"].map(|file| server.directory().join(file));
        let bytes: Vec<u8> = files.iter().flat_map(|file| std::fs::read(file).unwrap_or_default()).collect();
        bytes.windows(middle.len()).filter(|window| *window == middle).count()
    };
    assert!(traces() > 0);
    let job = client.remove_session("maps/drive/sessions/visitor").await.unwrap();
    followed(&client, &job).await;
    assert!(traces() > 0, "there is nothing to wipe");
    let hash = state_hash(&client, "drive").await;
    let job = client.compact_map("drive").await.unwrap();
    assert_eq!(followed(&client, &job).await.pop().unwrap().state(), v1::job::State::Succeeded);
    assert_eq!(traces(), 0);
    assert_eq!(state_hash(&client, "drive").await, hash);
    assert_eq!(refused(client.compact_map("nowhere").await).0, Code::NotFound);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_merged_is_said() {
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    let other = take_model(&client, "other", &model_of_other_words()).await;
    client.create_map(map_request("empty", &model.name)).await.unwrap();
    client.create_map(map_request("bare", &model.name)).await.unwrap();
    client.create_map(crate::harness::by_words_request("foreign", &other.name)).await.unwrap();
    for (sources, target, code, fragment) in [
        (&["empty", "empty"][..], "new", Code::InvalidArgument, "named twice"),
        (&["empty"], "new", Code::InvalidArgument, "name two maps or more"),
        (&["empty"], "empty", Code::InvalidArgument, "nothing is to go into the map empty"),
        (&[], "empty", Code::InvalidArgument, "nothing is to go into"),
        (&["nowhere"], "empty", Code::NotFound, "there is no map nowhere"),
        (&["foreign"], "empty", Code::FailedPrecondition, "different words"),
        (&["foreign", "empty"], "new", Code::FailedPrecondition, "different words"),
        (&["No"], "empty", Code::InvalidArgument, "is no map name"),
    ] {
        let answer = refused(client.merge_maps(request(sources, target, OnceFound::Commit)).await);
        assert_status(&format!("{sources:?} into {target}"), (answer.0, &answer.1), code, fragment);
    }
    let few = v1::MergeMapsRequest { min_support: Some(2), ..request(&["bare"], "empty", OnceFound::Commit) };
    let answer = refused(client.merge_maps(few).await);
    assert_status("support", (answer.0, &answer.1), Code::InvalidArgument, "least support cannot be 2");
    assert_eq!(refused(client.merge("merges/77").await).0, Code::NotFound);
    assert_eq!(refused(client.merge("77").await).0, Code::InvalidArgument);
    assert_eq!(refused(client.commit_merge("merges/77").await).0, Code::NotFound);
    assert_eq!(refused(client.remove_session("maps/empty/sessions/none").await).0, Code::NotFound);

    // Nothing overlaps with an empty map: that is an answer.
    let asked = client.merge_maps(request(&["bare"], "empty", OnceFound::Commit)).await.unwrap();
    let apart = done(&client, &asked).await;
    assert_eq!(apart.state(), State::Apart);
    let Some(Outcome::Apart(why)) = &apart.sources[0].outcome else { panic!("{apart:?}") };
    assert!(why.contains("no two places"), "{why}");
    // It is seen over REST, too, and asked for there.
    let list = found(&server, "/v1/merges").await;
    assert_eq!(list["merges"][0]["state"], "apart");
    let body = r#"{"sources": ["maps/bare"], "target": "maps/empty"}"#;
    let asked = http()
        .post(server.url("/v1/merges"))
        .header("content-type", "application/json")
        .body(body)
        .send()
        .await
        .unwrap();
    assert!(asked.status().is_success(), "{asked:?}");
    server.stop().await;
}

/// The words of a map can be made anew from the descriptors that it keeps, and are as if its robots had sent them there.
#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_made_anew_with_another_model() {
    const FRAMES: u64 = 30;
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=FRAMES).map(frame)).await;
    let shipped = import_model(&client).await;
    let settings = v1::TrainModelSettings {
        display_name: "fewer words".to_owned(),
        extractor: shipped.extractor,
        words: 300,
        seed: 1,
        image_count: 40,
    };
    let images = futures::stream::iter(images()[..40].iter().cloned().map(Ok));
    let job = client.train_model(settings, images).await.unwrap();
    let other = followed(&client, &job).await.pop().unwrap().model.unwrap();
    let job = client.rebuild_map("drive", &other.name, "anew").await.unwrap();
    assert_eq!(followed(&client, &job).await.pop().unwrap().result, "maps/anew");
    client.create_map(map_request("sent", &other.name)).await.unwrap();
    answers(&client, "sent", "robot", (1..=FRAMES).map(frame)).await;
    assert_eq!(state_hash(&client, "anew").await, state_hash(&client, "sent").await);
    let anew = client.map("anew", v1::MapView::Full).await.unwrap();
    assert_eq!((anew.frames, &anew.model), (FRAMES, &other.name));

    // Asked for again, it goes on with what has come since.
    answers(&client, "drive", "robot", (FRAMES + 1..=FRAMES + 3).map(frame)).await;
    let job = client.rebuild_map("drive", &other.name, "anew").await.unwrap();
    followed(&client, &job).await;
    assert_eq!(client.map("anew", v1::MapView::Full).await.unwrap().frames, FRAMES + 3);

    // Of two sessions that are removed at once, neither takes another one's place.
    for session in ["second", "third", "fourth"] {
        answers(&client, "anew", session, (1..=3).map(frame)).await;
    }
    let jobs = [
        client.remove_session("maps/anew/sessions/robot").await.unwrap(),
        client.remove_session("maps/anew/sessions/third").await.unwrap(),
    ];
    let mut ends = Vec::new();
    for job in &jobs {
        ends.push(followed(&client, job).await.pop().unwrap());
    }
    assert_eq!(ends[0].state(), v1::job::State::Succeeded, "{ends:?}");
    let left = client.sessions("anew").await.unwrap();
    let left: Vec<&str> = left.iter().map(|session| session.name.rsplit('/').next().unwrap()).collect();
    match ends[1].state() {
        v1::job::State::Succeeded => assert_eq!(left, ["second", "fourth"]),
        _ => {
            assert!(ends[1].error.contains("try again"), "{ends:?}");
            assert_eq!(left, ["second", "third", "fourth"]);
        }
    }

    let foreign = take_model(&client, "foreign", &model_of_other_words()).await;
    for (map, model, into, code, fragment) in [
        ("drive", &foreign, "new", Code::FailedPrecondition, "give a model of the same features"),
        ("drive", &other, "drive", Code::AlreadyExists, "there is a map drive already"),
        ("drive", &other, "New", Code::InvalidArgument, "is no map name"),
        ("nowhere", &other, "new", Code::NotFound, "there is no map nowhere"),
    ] {
        let answer = refused(client.rebuild_map(map, &model.name, into).await);
        assert_status(map, (answer.0, &answer.1), code, fragment);
    }
    server.stop().await;
}
