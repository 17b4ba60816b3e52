//! What robots measure themselves between two frames.

use super::*;

/// How the robot at a frame lies to the robot at an earlier one, as a stereo camera would measure it.
fn measurement(
    session: &str,
    (frame, earlier): (u64, &str),
    pose: &PlanarPose,
) -> v1::AddRelativePoseRequest {
    let mut covariance = vec![0.0; 36];
    (0..6).for_each(|axis| covariance[7 * axis] = 1e-4);
    v1::AddRelativePoseRequest {
        frame: format!("{session}/frames/{frame}"),
        earlier_frame: earlier.to_owned(),
        pose: Some(v1::Pose {
            position_m: Some(v1::Vector3 { x: pose.x_m(), y: pose.y_m(), z: 0.0 }),
            orientation: Some(v1::Quaternion {
                x: 0.0,
                y: 0.0,
                z: (pose.heading_rad() / 2.0).sin(),
                w: (pose.heading_rad() / 2.0).cos(),
            }),
        }),
        covariance,
    }
}

/// With what a robot measures itself, its map has the truth's size: closures alone cannot show the wheels' scale.
#[tokio::test(flavor = "multi_thread")]
async fn closures_that_a_robot_measures_make_its_map_true() {
    use v1::export_poses_request::{Body, Format, Frame};
    const SESSION: &str = "maps/drive/sessions/robot";
    let drive = drive_round(5, "twice");
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    let options = SessionOptions { camera: Some(camera()), ..words_options("drive", "robot") };
    let mut session = client.open_session(options).await.unwrap();
    let mut measured = Vec::new();
    for (number, input) in drive.words().enumerate() {
        session.send(input).await.unwrap();
        let Some(FrameOutcome::Answer(answer)) = session.next().await.unwrap() else { panic!("refused") };
        let Some(closure) = answer.r#match.clone().filter(|_| answer.reason() == v1::Reason::LoopClosure)
        else {
            continue;
        };
        let earlier = closure.frame.unwrap();
        let pose = drive.truth(earlier.sequence as usize - 1).inverse().compose(&drive.truth(number));
        let request =
            measurement(SESSION, (answer.sequence, &format!("{SESSION}/frames/{}", earlier.sequence)), &pose);
        let before = state_hash(&client, "drive").await;
        let corrected = client.add_relative_pose(request.clone()).await.unwrap().unwrap();
        let after = state_hash(&client, "drive").await;
        assert_ne!(after, before);
        // Sent again, as after a lost answer, it changes nothing.
        assert_eq!(client.add_relative_pose(request).await.unwrap().unwrap(), corrected);
        assert_eq!(state_hash(&client, "drive").await, after);
        measured.push((number, earlier.sequence));
    }
    assert!(measured.len() >= 10, "{} measured", measured.len());
    // Frames some metres apart, which no recognition joins, show how large the map is.
    for later in (6..drive.frames.len()).step_by(6) {
        let pose = drive.truth(later - 6).inverse().compose(&drive.truth(later));
        let earlier = format!("{SESSION}/frames/{}", later - 5);
        let result =
            client.add_relative_pose(measurement(SESSION, (later as u64 + 1, &earlier), &pose)).await;
        assert!(result.is_ok(), "{result:?} at {later}");
    }

    let text = exported(&client, SESSION, Format::Tum, Frame::Map, Body::Base).await;
    let rmse_m = drive.rmse_m(&from_tum(&text).unwrap());
    println!("{} measured, {rmse_m} m", measured.len());
    assert!(rmse_m < 0.3, "{rmse_m} m");
    let hash = state_hash(&client, "drive").await;
    drop(session);
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(state_hash(&client, "drive").await, hash);
    let again = exported(&client, SESSION, Format::Tum, Frame::Map, Body::Base).await;
    assert!(drive.rmse_m(&from_tum(&again).unwrap()) < 0.3);

    // A copy brings the measurements along.
    let mut copy = Vec::new();
    client.export_map("drive", &mut copy).await.unwrap();
    let file = directory.path().join("drive.snapshot");
    std::fs::write(&file, copy).unwrap();
    let reader = tokio::fs::File::open(&file).await.unwrap();
    let job = client.import_map("copy", reader).await.unwrap();
    assert_eq!(followed(&client, &job).await.last().unwrap().state(), v1::job::State::Succeeded);
    assert_eq!(state_hash(&client, "copy").await, hash);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn measurements_that_say_nothing_are_refused() {
    const SESSION: &str = "maps/drive/sessions/robot";
    let drive = drive_round(3, "once");
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    for map in ["drive", "other"] {
        client.create_map(map_request(map, &model.name)).await.unwrap();
    }
    let inputs: Vec<FrameInput> = drive.inputs().take(6).collect();
    let blind = FrameInput { odometry: None, sequence: 7, stamp_ns: i64::MAX, ..inputs[5].clone() };
    let session = client.open_session(session_options("drive", "robot")).await.unwrap();
    stream(session, inputs.into_iter().chain([blind])).await;
    let first = format!("{SESSION}/frames/1");
    let good = measurement(SESSION, (5, &first), &PlanarPose::new(2.0, 0.0, 0.0));
    let hash = state_hash(&client, "drive").await;
    type Spoil = fn(&mut v1::AddRelativePoseRequest);
    let cases: [(&str, Spoil, Code, &str); 14] = [
        ("no frame", |r| r.frame.clear(), Code::InvalidArgument, "frames/"),
        ("no such frame", |r| r.frame = format!("{SESSION}/frames/99"), Code::NotFound, "no frame 99"),
        (
            "no such session",
            |r| r.frame = "maps/drive/sessions/no/frames/1".to_owned(),
            Code::NotFound,
            "session no",
        ),
        (
            "no such map",
            |r| {
                r.frame = "maps/no/sessions/a/frames/2".to_owned();
                r.earlier_frame = "maps/no/sessions/a/frames/1".to_owned();
            },
            Code::NotFound,
            "no",
        ),
        (
            "another map",
            |r| r.earlier_frame = "maps/other/sessions/robot/frames/1".to_owned(),
            Code::InvalidArgument,
            "one map",
        ),
        (
            "the same frame",
            |r| r.frame = format!("{SESSION}/frames/1"),
            Code::FailedPrecondition,
            "did not come in before",
        ),
        (
            "without odometry",
            |r| r.frame = format!("{SESSION}/frames/7"),
            Code::FailedPrecondition,
            "sent with odometry",
        ),
        ("no pose", |r| r.pose = None, Code::InvalidArgument, "nothing was measured"),
        (
            "no orientation",
            |r| r.pose.as_mut().unwrap().orientation = None,
            Code::InvalidArgument,
            "both position and orientation",
        ),
        ("no covariance", |r| r.covariance.clear(), Code::InvalidArgument, "send 36"),
        ("NaN", |r| r.covariance[0] = f64::NAN, Code::InvalidArgument, "not finite"),
        ("negative", |r| r.covariance[0] = -1.0, Code::InvalidArgument, "eigenvalue"),
        (
            "no rotation",
            |r| r.pose.as_mut().unwrap().orientation.as_mut().unwrap().w = 3.0,
            Code::InvalidArgument,
            "unit quaternion",
        ),
        (
            "far",
            |r| r.pose.as_mut().unwrap().position_m.as_mut().unwrap().x = 1e9,
            Code::InvalidArgument,
            "send metres",
        ),
    ];
    for (case, spoil, code, fragment) in cases {
        let mut request = good.clone();
        spoil(&mut request);
        let (said, message) = refused(client.add_relative_pose(request).await);
        assert_status(case, (said, &message), code, fragment);
        assert_eq!(state_hash(&client, "drive").await, hash, "{case}");
    }
    client.add_relative_pose(good).await.unwrap();
    assert_ne!(state_hash(&client, "drive").await, hash);
    server.stop().await;
}
