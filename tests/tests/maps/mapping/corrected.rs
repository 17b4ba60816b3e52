//! What people say of the loop closures of a map with metres.

use std::path::Path;

use serde_json::{Value, json};
use tempfile::TempDir;

use super::*;
use crate::harness::{Answer, Template, http};

const SESSION: &str = "maps/drive/sessions/robot";

#[track_caller]
fn assert_refused<T: std::fmt::Debug>(result: Result<T, waypost_client::Error>, code: Code, says: &str) {
    let (status, message) = refused(result);
    assert_status(says, (status, &message), code, says);
}

fn name_of(frame: &v1::FrameReference) -> String {
    format!("{}/frames/{}", frame.session, frame.sequence)
}

/// Twice round a building.
static MAPPED: Template = Template::new();

/// The drive, and a directory with its map.
async fn mapped() -> (TempDir, Server, Client, Drive) {
    let drive = drive_round(5, "twice");
    let make = async |directory: &Path| {
        let server = Server::start_on(directory).await;
        let client = server.client().await;
        let model = import_model(&client).await;
        client.create_map(map_request("drive", &model.name)).await.unwrap();
        let options = SessionOptions { camera: Some(camera()), ..words_options("drive", "robot") };
        stream(client.open_session(options).await.unwrap(), drive.words()).await;
        server.stop().await;
    };
    let directory = MAPPED.directory(make).await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    (directory, server, client, drive)
}

async fn tum_lines(client: &Client) -> usize {
    use v1::export_poses_request::{Body, Format, Frame};
    let text = exported(client, SESSION, Format::Tum, Frame::Map, Body::Base).await;
    from_tum(&text).unwrap().len()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_withdrawn_closure_is_told_everywhere_and_undone_to_the_bit() {
    use v1::export_poses_request::{Body, Format, Frame};
    let (directory, server, client, drive) = mapped().await;
    let before = client.map("drive", v1::MapView::Full).await.unwrap();
    let extent = before.extent.unwrap();
    assert_eq!((extent.parts, extent.measured_places), (1, before.places), "{extent:?}");
    assert!(extent.length_m > 1.0 && extent.width_m > 0.0, "{extent:?}");
    let closures = client.loop_closures("drive").await.unwrap();
    assert!(closures.len() >= 10, "{} closures", closures.len());
    let closure = &closures[closures.len() / 2];
    let (frame, matched) = (closure.frame.clone().unwrap(), closure.matched_frame.clone().unwrap());
    let name = name_of(&frame);
    let answered = client.frame(&name).await.unwrap();

    let withdrawn = client.withdraw_loop_closure(&name).await.unwrap();
    assert_eq!(withdrawn.verdict(), v1::correction::Verdict::Withdrawn);
    assert_eq!((withdrawn.frame.clone(), withdrawn.matched_frame.clone()), (Some(frame), Some(matched)));
    assert_eq!(withdrawn.place_number, Some(closure.place_number));
    assert!(
        withdrawn.frames >= 1 && withdrawn.token.is_empty() && withdrawn.undone.is_none(),
        "{withdrawn:?}"
    );
    let hash = state_hash(&client, "drive").await;
    assert_ne!(Some(&hash), before.state_hash.as_ref());

    // What was decided stays to be read, and beside it who says otherwise.
    let record = client.frame(&name).await.unwrap();
    assert_eq!((record.answer, record.corrections), (answered.answer, vec![withdrawn.clone()]));
    let explained = client.explain_frame(&name, None, None).await.unwrap();
    assert!(explained.reproduced && explained.corrections == [withdrawn.clone()], "{explained:?}");
    let listed = client.loop_closures("drive").await.unwrap();
    let of_frame = |listed: &[v1::LoopClosure]| {
        listed.iter().filter_map(|closure| closure.correction.clone()).collect::<Vec<_>>()
    };
    assert_eq!((listed.len(), of_frame(&listed)), (closures.len(), vec![withdrawn.clone()]));
    let picture = client.frame_picture(&name, None).await.unwrap();
    assert!(String::from_utf8(picture).unwrap().contains("withdrawn by somebody without a token"));
    let map = client.map("drive", v1::MapView::Basic).await.unwrap();
    assert_eq!((map.withdrawn_loop_closures, map.confirmed_loop_closures), (1, 0));
    let place = client.place(&format!("maps/drive/places/{}", closure.place_number)).await.unwrap();
    assert!(place.frames.iter().all(|learnt| name_of(learnt) != name), "its place matches it no more");
    assert_eq!(tum_lines(&client).await, drive.frames.len() - withdrawn.frames as usize);
    let graph = exported(&client, "maps/drive", Format::G2o, Frame::Unspecified, Body::Unspecified).await;
    let first = std::str::from_utf8(&graph).unwrap().lines().next().unwrap();
    assert!(first.starts_with(&format!("# {name} and ")) && first.contains("withdrawn by"), "{first}");
    G2o::read(&graph).unwrap();
    let table = get(&server, "/v1/maps/drive/loop-closures.csv").await;
    assert_eq!(
        table.text().lines().filter(|line| line.contains(&withdrawn.create_time_ns.to_string())).count(),
        1
    );

    let again = client.withdraw_loop_closure(&name).await;
    assert_refused(again, Code::FailedPrecondition, "undo that to have it back");
    let first_frame = client.withdraw_loop_closure(&format!("{SESSION}/frames/1")).await;
    assert_refused(first_frame, Code::FailedPrecondition, "closed no loop");

    // A restart, and a copy, know of it.
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(state_hash(&client, "drive").await, hash);
    assert_eq!(client.corrections("drive").await.unwrap(), std::slice::from_ref(&withdrawn));
    let mut copy = Vec::new();
    client.export_map("drive", &mut copy).await.unwrap();
    let file = directory.path().join("drive.snapshot");
    std::fs::write(&file, copy).unwrap();
    let job = client.import_map("copy", tokio::fs::File::open(&file).await.unwrap()).await.unwrap();
    assert_eq!(followed(&client, &job).await.last().unwrap().state(), v1::job::State::Succeeded);
    assert_eq!(state_hash(&client, "copy").await, hash);
    let copied = client.corrections("copy").await.unwrap();
    assert_eq!((copied.len(), &copied[0].create_time_ns), (1, &withdrawn.create_time_ns));

    // Undone, and the map is what it was; after a restart, too.
    let undone = client.undo_correction(&withdrawn.name).await.unwrap();
    assert!(undone.undone.is_some(), "{undone:?}");
    let now = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(now, v1::Map { storage: now.storage, ..before.clone() });
    assert_eq!(of_frame(&client.loop_closures("drive").await.unwrap()), []);
    assert_eq!(tum_lines(&client).await, drive.frames.len());
    assert_refused(client.undo_correction(&withdrawn.name).await, Code::NotFound, "list its corrections");
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(Some(state_hash(&client, "drive").await), before.state_hash);
    assert_eq!(client.corrections("drive").await.unwrap(), [undone]);
    server.stop().await;
}

/// Where places are, and how far the robot's way is from the truth.
async fn relaxed(client: &Client, drive: &Drive) -> (Vec<PlanarPose>, f64) {
    use v1::export_poses_request::{Body, Format, Frame};
    let places = client.places("drive").await.unwrap();
    let pose = |place: &v1::Place| planar(place.pose.as_ref().unwrap().pose.as_ref().unwrap());
    let text = exported(client, "maps/drive", Format::G2o, Frame::Unspecified, Body::Unspecified).await;
    let G2o::Planar(graph) = G2o::read(&text).unwrap() else { panic!("a graph in space") };
    assert_eq!(graph.ids().len(), places.len(), "every place is measured");
    let way = exported(client, SESSION, Format::Tum, Frame::Map, Body::Base).await;
    (places.iter().map(pose).collect(), drive.rmse_m(&from_tum(&way).unwrap()))
}

fn furthest_m(before: &[PlanarPose], after: &[PlanarPose]) -> f64 {
    let apart = before.iter().zip(after).map(|(before, after)| before.inverse().compose(after));
    apart.map(|apart| apart.x_m().hypot(apart.y_m())).fold(0.0, f64::max)
}

/// Each closure of this drive is right: without any the map is as bent as the wheels have it.
#[tokio::test(flavor = "multi_thread")]
async fn places_are_laid_out_anew_by_the_links_that_stand() {
    let (directory, server, client, drive) = mapped().await;
    let before = client.map("drive", v1::MapView::Full).await.unwrap();
    let (places, rmse_m) = relaxed(&client, &drive).await;
    assert!(rmse_m < 1.0, "{rmse_m} m");
    let closures = client.loop_closures("drive").await.unwrap();
    for closure in &closures {
        client.withdraw_loop_closure(&name_of(closure.frame.as_ref().unwrap())).await.unwrap();
    }
    let corrected = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(corrected.withdrawn_loop_closures, closures.len() as u64);
    assert_eq!(corrected.loop_closures, before.loop_closures, "what was decided is still counted");
    let (bent, bent_m) = relaxed(&client, &drive).await;
    let moved_m = furthest_m(&places, &bent);
    assert!(moved_m > 1.0 && bent_m > 2.0 * rmse_m, "moved by {moved_m} m, {bent_m} m off");

    // Opened anew, they lie where they did.
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(Some(state_hash(&client, "drive").await), corrected.state_hash);
    let again_m = furthest_m(&bent, &relaxed(&client, &drive).await.0);
    assert!(again_m < 0.05, "{again_m} m");
    let corrections = client.corrections("drive").await.unwrap();
    for correction in corrections.iter().rev() {
        client.undo_correction(&correction.name).await.unwrap();
    }
    let now = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(now, v1::Map { storage: now.storage, ..before });
    let (straight, straight_m) = relaxed(&client, &drive).await;
    let left_m = furthest_m(&places, &straight);
    assert!(left_m < 0.05 && straight_m < 1.0, "{left_m} m from where they were, {straight_m} m off");
    server.stop().await;
}

/// Frames of different places that were taken near to each other, the later one first; nearest first.
async fn pairs(client: &Client, drive: &Drive) -> Vec<[String; 2]> {
    let frames = client.frames(SESSION).await.unwrap();
    let place = |number: usize| frames[number].answer.as_ref().and_then(|answer| answer.place_number);
    let mut found = Vec::new();
    for later in 0..frames.len() {
        for earlier in 0..later.saturating_sub(20) {
            let apart = drive.truth(earlier).inverse().compose(&drive.truth(later));
            let apart_m = apart.x_m().hypot(apart.y_m());
            if place(later) != place(earlier) && apart_m < 0.5 && apart.heading_rad().abs() < 0.1 {
                found.push((apart_m, [later, earlier].map(|number| frames[number].name.clone())));
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, pair)| pair).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_one_place_are_linked_by_what_their_features_measure() {
    let (directory, server, client, drive) = mapped().await;
    let before = client.map("drive", v1::MapView::Full).await.unwrap();
    // Across the building.
    let far =
        client.confirm_loop_closure(&format!("{SESSION}/frames/20"), &format!("{SESSION}/frames/2")).await;
    assert_refused(far, Code::FailedPrecondition, "cannot be measured");
    let round =
        client.confirm_loop_closure(&format!("{SESSION}/frames/2"), &format!("{SESSION}/frames/20")).await;
    assert_refused(round, Code::InvalidArgument, "did not come in before");
    assert_eq!(state_hash(&client, "drive").await, *before.state_hash.as_ref().unwrap());

    let pairs = pairs(&client, &drive).await;
    assert!(!pairs.is_empty(), "no place of the second round is beside one of the first");
    let mut confirmed = None;
    for [later, earlier] in &pairs {
        let body = json!({ "confirm": { "frame": later, "matched_frame": earlier } });
        let answer = Answer::to(http().post(server.url("/v1/maps/drive/corrections")).json(&body)).await;
        if answer.status == 200 {
            confirmed = Some(answer.json());
            break;
        }
        assert!(
            answer.text().contains("cannot be measured") || answer.text().contains("does not say"),
            "{}",
            answer.text()
        );
    }
    let confirmed: Value = confirmed.expect("no pair was measured");
    assert_eq!(confirmed["verdict"], "confirmed");
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!((map.confirmed_loop_closures, map.links), (1, before.links + 1));
    assert_ne!(map.state_hash, before.state_hash);
    use v1::export_poses_request::{Body, Format, Frame};
    let text = exported(&client, SESSION, Format::Tum, Frame::Map, Body::Base).await;
    let rmse_m = drive.rmse_m(&from_tum(&text).unwrap());
    assert!(rmse_m < 1.0, "{rmse_m} m");

    // It rests on what it says: that goes first.
    let name = confirmed["name"].as_str().unwrap();
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(client.map("drive", v1::MapView::Full).await.unwrap().state_hash, map.state_hash);
    client.undo_correction(name).await.unwrap();
    assert_eq!(Some(state_hash(&client, "drive").await), before.state_hash);

    // What is corrected stays so in a map with fewer places, and in a copy of that.
    let closures = client.loop_closures("drive").await.unwrap();
    let closed = closures.last().and_then(|closure| closure.frame.clone()).unwrap();
    client.withdraw_loop_closure(&name_of(&closed)).await.unwrap();
    let trim = v1::TrimMapRequest {
        name: "maps/drive".to_owned(),
        max_places: u32::try_from(before.places).unwrap() - 4,
        mode: v1::trim_map_request::Mode::Apply.into(),
    };
    assert!(!client.trim_map(trim).await.unwrap().dropped.is_empty());
    let hash = state_hash(&client, "drive").await;
    let mut copy = Vec::new();
    client.export_map("drive", &mut copy).await.unwrap();
    let file = directory.path().join("trimmed.snapshot");
    std::fs::write(&file, copy).unwrap();
    let job = client.import_map("copy", tokio::fs::File::open(&file).await.unwrap()).await.unwrap();
    let job = followed(&client, &job).await.pop().unwrap();
    assert_eq!(job.state(), v1::job::State::Succeeded, "{job:?}");
    assert_eq!(state_hash(&client, "copy").await, hash);
    server.stop().await;
}
