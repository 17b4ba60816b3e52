//! Closures that measure: a robot drives on beyond what it knows, and says in metres how it lies to what it sees again.

use posegraph::{PlanarPose, Pose as _};
use waypost_client::{Client, FrameInput, FrameOutcome, SessionOptions, v1};
use waypost_sim::robot::WheelErrors;
use waypost_sim::worlds::NamedWorld;

use crate::harness::{
    Drive, Server, ServerProcess, import_model, map_request, planar, session_options, state_hash, stream,
};

/// A drive through the gallery, whose halls end in far walls, by wheels that are 2 % and 2 degrees a metre off.
fn drive_gallery(route: &str) -> Drive {
    let wheels = WheelErrors { scale: 0.02, drift_rad_per_m: 2_f64.to_radians(), ..WheelErrors::NONE };
    Drive::new(NamedWorld::Gallery, 11, route, wheels)
}

async fn answers(
    client: &Client,
    drive: &Drive,
    frames: impl IntoIterator<Item = FrameInput>,
) -> Vec<v1::FrameAnswer> {
    let options = SessionOptions { camera: Some(drive.camera()), ..session_options("gallery", "robot") };
    let outcomes = stream(client.open_session(options).await.unwrap(), frames).await;
    let answer = |outcome| match outcome {
        FrameOutcome::Answer(answer) => answer,
        other => panic!("{other:?}"),
    };
    outcomes.into_iter().map(answer).collect()
}

/// Where the robot truly was at a frame, seen from where it was at the one that it matched.
fn truth(drive: &Drive, answer: &v1::FrameAnswer, matched: &v1::Match) -> PlanarPose {
    let index = |sequence: u64| sequence as usize - 1;
    let earlier = matched.frame.as_ref().unwrap().sequence;
    drive.truth(index(earlier)).inverse().compose(&drive.truth(index(answer.sequence)))
}

#[tokio::test(flavor = "multi_thread")]
async fn closures_say_how_far_the_robot_is_from_what_it_sees_again() {
    let drive = drive_gallery("rooms");
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("gallery", &model.name)).await.unwrap();
    let answers = answers(&client, &drive, drive.inputs()).await;
    let mut errors_m = Vec::new();
    let mut closures = 0;
    for answer in answers.iter().filter(|answer| answer.reason() == v1::Reason::LoopClosure) {
        closures += 1;
        let matched = answer.r#match.as_ref().unwrap();
        let truth = truth(&drive, answer, matched);
        let is_far = truth.x_m().hypot(truth.y_m()) > 1.5 || truth.heading_rad().abs() > 40_f64.to_radians();
        assert!(!is_far, "frame {} closes onto one {truth:?} away", answer.sequence);
        let Some(placement) = &matched.geometry.as_ref().unwrap().placement else { continue };
        assert!(placement.inliers >= 12 && placement.covariance.len() == 9, "{placement:?}");
        let off =
            PlanarPose::error(&planar(placement.pose.as_ref().unwrap()), &PlanarPose::identity(), &truth);
        errors_m.push(off.x.hypot(off.y));
    }
    errors_m.sort_by(f64::total_cmp);
    assert!(
        closures >= 30 && errors_m.len() * 4 >= closures * 3,
        "{} of {closures} measured",
        errors_m.len()
    );
    assert!(errors_m[errors_m.len() / 2] < 0.05, "{errors_m:?}");
    assert!(errors_m[errors_m.len() * 9 / 10] < 0.15, "{errors_m:?}");

    // Asked again, the same solution comes out, and is said in words.
    let measured = |answer: &&v1::FrameAnswer| {
        let geometry = answer.r#match.as_ref().and_then(|matched| matched.geometry.as_ref());
        answer.reason() == v1::Reason::LoopClosure && geometry.is_some_and(|it| it.placement.is_some())
    };
    let closed = answers.iter().find(measured).unwrap();
    let name = format!("maps/gallery/sessions/robot/frames/{}", closed.sequence);
    let explained = client.explain_frame(&name, None, Some(0)).await.unwrap();
    assert!(explained.reproduced, "{explained:?}");
    let gate = |name: &str| explained.gates.iter().find(|gate| gate.name == name).unwrap();
    assert!(gate("distance").passed && gate("heading").passed && gate("placed_inliers").passed);
    assert_eq!(gate("distance").required, 1.0);
    assert!(explained.gates.iter().all(|gate| gate.passed), "{explained:?}");
    server.stop().await;
}

/// What the frames before showed is read from the disk when a robot goes on after a kill.
#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_was_killed_measures_the_same() {
    let drive = drive_gallery("frontier");
    let frames: Vec<FrameInput> = drive.inputs().collect();
    let mut told = Vec::new();
    for cut in [frames.len(), 55] {
        let directory = tempfile::tempdir().unwrap();
        let mut server = ServerProcess::start(directory.path());
        let mut client = server.client().await;
        let model = import_model(&client).await;
        client.create_map(map_request("gallery", &model.name)).await.unwrap();
        let mut heard = answers(&client, &drive, frames[..cut].to_vec()).await;
        if cut < frames.len() {
            server.kill();
            server = ServerProcess::start(directory.path());
            client = server.client().await;
            heard.extend(answers(&client, &drive, frames[cut..].to_vec()).await);
        }
        let placed = |answer: &v1::FrameAnswer| {
            let best = answer.best_candidate.as_ref()?;
            best.geometry.as_ref()?.placement.clone()
        };
        let placements: Vec<_> = heard.iter().map(placed).collect();
        assert!(placements[cut.min(55)..].iter().flatten().count() > 3, "{placements:?}");
        told.push((placements, state_hash(&client, "gallery").await));
        server.kill();
    }
    assert!(told[0] == told[1], "a server that was killed measures something else");
}
