//! Maps of a simulated building become one through the real server, and two again.

use std::time::Duration;

use posegraph::Pose as _;
use posegraph::trajectory::to_tum;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use waypost_client::v1::merge::State;
use waypost_client::{Code, v1};

use crate::harness::{
    Server, ServerProcess, answers, as_words, assert_status, evo_rmse_m, followed, frame_count, get,
    map_request, planar, refused, said, state_hash,
};

use super::rounds::{OnceFound, Rounds, done, note, overlap, request};

#[tokio::test(flavor = "multi_thread")]
async fn two_maps_become_one_and_two_again() {
    let rounds = Rounds::new();
    let directory = rounds.mapped().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
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
    let number = |name: &str| name.rsplit('/').next().unwrap().parse::<u64>().unwrap();
    assert_eq!(strongest.source_note, note(number(&strongest.source_frame)));
    assert_eq!(strongest.target_note, note(number(&strongest.target_frame)));
    let picture = String::from_utf8(client.merge_picture(&proposed.name).await.unwrap()).unwrap();
    assert!(picture.contains("tuesday before") && picture.contains("together"), "{picture:.400}");
    assert_eq!(get(&server, &format!("/v1/{}/picture", proposed.name)).await.text(), picture);
    assert_eq!([state_hash(&client, "monday").await, state_hash(&client, "tuesday").await], before);
    assert_eq!(refused(client.map("week", v1::MapView::Full).await).0, Code::NotFound);
    // The name is kept for it meanwhile.
    let taken = refused(client.create_map(map_request("week", "")).await);
    assert_eq!(taken.0, Code::AlreadyExists, "{taken:?}");

    let committed = done(&client, &client.commit_merge(&proposed.name).await.unwrap()).await;
    assert_eq!(committed.state(), State::Committed, "{committed:?}");
    assert_eq!(committed.sources[0].sessions, ["tuesday-robot"]);
    let base = committed.base.as_ref().unwrap();
    assert_eq!(
        (base.map.as_str(), base.sessions.as_slice()),
        ("maps/monday", ["robot".to_owned()].as_slice())
    );
    let week = client.map("week", v1::MapView::Full).await.unwrap();
    assert_eq!((week.sessions, week.frames), (2, rounds.0.frames.len() as u64));
    let fewer = found_overlap.fused_places;
    let maps = [
        client.map("monday", v1::MapView::Full).await.unwrap(),
        client.map("tuesday", v1::MapView::Full).await.unwrap(),
    ];
    assert_eq!(week.places, maps[0].places + maps[1].places - fewer);
    assert_eq!(maps.each_ref().map(|map| map.state_hash.clone().unwrap()), before);
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
    assert_eq!(Some(state_hash(&client, "week").await), week.state_hash);

    // Another robot starts anywhere in it, lost, and is anchored at what it recognises.
    let answers = rounds.drive(&client, "week", "third", &rounds.day(1)[20..40]).await;
    let anchored = answers.iter().position(|answer| answer.reason() == v1::Reason::LoopClosure);
    let anchored = anchored.unwrap_or_else(|| panic!("{answers:?}"));
    assert!(answers[anchored..].iter().all(|answer| answer.map_pose.as_ref().unwrap().part == 0));
    // So the merge's map is not that of the merge alone any more, and does not go as a whole.
    let undone = client.undo_merge(&committed.name).await.unwrap();
    let job = client.job(&undone.job).await.unwrap();
    let last = followed(&client, &job).await.pop().unwrap();
    assert!(said(&last.error).contains("sessions have driven in the map week since"), "{last:?}");
    let job = client.delete_session("maps/week/sessions/third").await.unwrap();
    assert_eq!(followed(&client, &job).await.pop().unwrap().state(), v1::job::State::Succeeded);
    assert_eq!(Some(state_hash(&client, "week").await), week.state_hash);
    let undone = done(&client, &client.undo_merge(&committed.name).await.unwrap()).await;
    assert_eq!(undone.state(), State::Undone, "{undone:?}");
    assert_eq!(refused(client.map("week", v1::MapView::Full).await).0, Code::NotFound);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_merge_into_a_map_is_there_whole_or_not_at_all_and_can_be_undone() {
    const KILLS: u64 = 3;
    let rounds = Rounds::new();
    let directory = rounds.mapped_in_sqlite().await;
    let mut server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let monday = client.map("monday", v1::MapView::Full).await.unwrap();
    let tuesday = client.map("tuesday", v1::MapView::Full).await.unwrap();

    // Killed at some moment of it; each time the next server comes to its end, and then it is undone.
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let mut cut_off = 0;
    for kill in 0..KILLS {
        let client = server.client().await;
        let asked = client.merge_maps(request(&["tuesday"], "monday", OnceFound::Commit)).await.unwrap();
        if kill == KILLS - 1 {
            done(&client, &asked).await;
        } else {
            tokio::time::sleep(Duration::from_millis(random.random_range(0..1_000) * kill)).await;
        }
        let state = client.merge(&asked.name).await.unwrap().state();
        cut_off += u32::from(matches!(state, State::Searching | State::Proposed));
        server.kill();
        server = ServerProcess::start(directory.path());
        let client = server.client().await;
        let merge = done(&client, &client.merge(&asked.name).await.unwrap()).await;
        assert_eq!(merge.state(), State::Committed, "{merge:?}");
        let now = client.map("monday", v1::MapView::Full).await.unwrap();
        assert_eq!(Some(state_hash(&client, "tuesday").await), tuesday.state_hash);
        assert_eq!((now.sessions, now.frames), (2, monday.frames + tuesday.frames));
        let undone = done(&client, &client.undo_merge(&merge.name).await.unwrap()).await;
        assert_eq!(undone.state(), State::Undone, "{undone:?}");
        let back = client.map("monday", v1::MapView::Full).await.unwrap();
        assert_eq!((back.state_hash, back.sessions), (monday.state_hash.clone(), 1));
    }
    println!("{cut_off} of {KILLS} were cut off");
    assert!(cut_off >= 1);

    // A budget of places: what goes is said first, then done.
    let client = server.client().await;
    let budget = |mode: v1::trim_map_request::Mode| v1::TrimMapRequest {
        name: "maps/tuesday".to_owned(),
        max_places: 60,
        mode: mode.into(),
    };
    let said = client.trim_map(budget(v1::trim_map_request::Mode::Preview)).await.unwrap();
    assert_eq!((said.remaining_places, said.excess_places), (60, 0), "{said:?}");
    assert_eq!(said.dropped.len() as u64, tuesday.places - 60);
    assert!(said.dropped.iter().all(|dropped| dropped.reason.is_some()));
    assert_eq!(Some(state_hash(&client, "tuesday").await), tuesday.state_hash);
    assert_eq!(client.trim_map(budget(v1::trim_map_request::Mode::Apply)).await.unwrap(), said);
    let trimmed = client.map("tuesday", v1::MapView::Full).await.unwrap();
    assert_eq!((trimmed.places, trimmed.frames), (60, tuesday.frames));
    let again = client.trim_map(budget(v1::trim_map_request::Mode::Apply)).await.unwrap();
    assert!(again.dropped.is_empty() && again.remaining_places == 60, "{again:?}");

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
    assert_eq!(followed(&client, &job).await.pop().unwrap().result.as_deref(), Some("maps/monday"));
    let answer = refused(client.undo_merge(&merge.name).await);
    assert_status("compacted", (answer.0, &answer.1), Code::FailedPrecondition, "deleted or compacted since");
    assert_eq!(state_hash(&client, "monday").await, before);
    server.stop();
}

/// Maps without metres are drawn by their places in order.
#[tokio::test(flavor = "multi_thread")]
async fn a_merge_without_metres_has_a_picture_too() {
    let (server, client) = Server::with_map().await;
    let model = client.map("drive", v1::MapView::Basic).await.unwrap().model;
    client.create_map(map_request("again", &model)).await.unwrap();
    // The second drive begins where the first one's second round does.
    let half = frame_count() / 2;
    answers(&client, "drive", "robot", (1..=half).map(as_words)).await;
    answers(&client, "again", "robot", (half..=frame_count()).map(as_words)).await;
    let proposed =
        done(&client, &client.merge_maps(request(&["again"], "drive", OnceFound::Propose)).await.unwrap())
            .await;
    assert_eq!(proposed.state(), State::Proposed, "{proposed:?}");
    let picture = String::from_utf8(client.merge_picture(&proposed.name).await.unwrap()).unwrap();
    assert!(picture.contains("places in order, a row for each session"), "{picture:.600}");
    assert!(!picture.contains(" m<"), "a scale without metres: {picture:.600}");
    let [first, second] = [
        client.map("drive", v1::MapView::Basic).await.unwrap().places,
        client.map("again", v1::MapView::Basic).await.unwrap().places,
    ];
    let fused = overlap(&proposed).fused_places;
    let drawn = picture.matches("<circle").count() as u64;
    assert_eq!(drawn, first + second + (first + second - fused), "{first} and {second}, {fused} fused");
    server.stop().await;
}
