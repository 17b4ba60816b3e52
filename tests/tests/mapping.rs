//! A simulated robot maps a building over gRPC; what comes back, and what is exported, is judged against the truth.

use topomap::g2o::G2o;
use topomap::relaxation::{EdgeKind, PlanarPose, Pose as _};
use topomap::trajectory::{from_tum, to_kitti, to_tum};
use waypost_client::{Client, Code, FrameInput, FrameOutcome, SessionOptions, v1};
use waypost_sim::robot::WheelErrors;
use waypost_sim::worlds::NamedWorld;

use crate::harness::{
    Building, Built, CommandLine, Drive, Server, assert_status, camera_ahead, evo_rmse_m, exported, followed,
    frame, get, import_model, json_object, map_request, model_file, odometry, path, planar, refused,
    run_to_its_end, session_options, state_hash, stream, workspace,
};

/// Round a ring of corridors with wheels that are five percent and two degrees a metre off.
fn drive_round(seed: u64, route: &str) -> Drive {
    let wheels = WheelErrors { scale: 0.05, drift_rad_per_m: 2_f64.to_radians(), ..WheelErrors::NONE };
    Drive::new(Building::new(NamedWorld::Loop, seed, route), wheels, seed)
}

fn camera() -> v1::Camera {
    let base_to_camera = v1::Pose {
        position_m: Some(v1::Vector3 { x: 0.1, y: 0.0, z: 0.5 }),
        orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    };
    v1::Camera { base_to_camera: Some(base_to_camera), ..camera_ahead() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_maps_a_building_and_the_map_undoes_what_its_wheels_drift() {
    use v1::export_poses_request::{Body, Format, Frame};
    const SESSION: &str = "maps/drive/sessions/robot";
    let drive = drive_round(3, "twice");
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    let options = SessionOptions { camera: Some(camera()), ..session_options("drive", "robot") };
    let outcomes = stream(client.open_session(options).await.unwrap(), drive.inputs()).await;
    let mut closures = 0;
    for (outcome, frame) in outcomes.iter().zip(&drive.frames) {
        let FrameOutcome::Answer(answer) = outcome else { panic!("{outcome:?}") };
        closures += usize::from(answer.reason() == v1::Reason::LoopClosure);
        let Some(pose) = &answer.map_pose else { panic!("{answer:?}") };
        let odometry = planar(&odometry(&frame.odometry).pose.unwrap());
        let corrected = planar(pose.map_to_odom.as_ref().unwrap()).compose(&odometry);
        let robot = planar(pose.robot.as_ref().unwrap());
        let apart = corrected.inverse().compose(&robot);
        assert!(apart.x_m().hypot(apart.y_m()) < 1e-9 && apart.heading_rad().abs() < 1e-9);
        assert_eq!(pose.part, 0);
    }
    assert!(closures >= 10, "{closures} closures in {} frames", drive.frames.len());

    let text = exported(&client, SESSION, Format::Tum, Frame::Map, Body::Base).await;
    let (on_the_map, by_wheels) = (
        from_tum(&text).unwrap(),
        from_tum(&exported(&client, SESSION, Format::Tum, Frame::Odom, Body::Base).await).unwrap(),
    );
    assert_eq!((on_the_map.len(), by_wheels.len()), (drive.frames.len(), drive.frames.len()));
    let (map_m, wheels_m) = (drive.rmse_m(&on_the_map), drive.rmse_m(&by_wheels));
    println!("closures {closures}, {map_m} {wheels_m}");
    assert!(map_m < 1.0 && map_m < wheels_m / 5.0, "{map_m} m on the map, {wheels_m} m by wheels");

    // The camera is ahead of base_link and above it.
    let seen = from_tum(&exported(&client, SESSION, Format::Tum, Frame::Map, Body::Camera).await).unwrap();
    for (camera, base) in seen.iter().zip(&on_the_map) {
        let mounted = base.pose.inv_mul(&camera.pose).translation;
        assert!((mounted.x - 0.1).abs() < 1e-9 && mounted.y.abs() < 1e-9 && (mounted.z - 0.5).abs() < 1e-9);
    }
    let kitti = exported(&client, SESSION, Format::Kitti, Frame::Map, Body::Base).await;
    let first: Vec<f64> = std::str::from_utf8(&kitti)
        .unwrap()
        .lines()
        .next()
        .unwrap()
        .split(' ')
        .map(|number| number.parse().unwrap())
        .collect();
    assert_eq!(first, [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let graph = exported(&client, "maps/drive", Format::G2o, Frame::Unspecified, Body::Unspecified).await;
    let G2o::Planar(named) = G2o::read(&graph).unwrap() else { panic!("a graph in space") };
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(named.ids().len() as u64, map.places);
    assert!(named.graph().edges().len() as u64 <= map.links);
    assert!(
        named
            .graph()
            .edges()
            .iter()
            .all(|edge| edge.kind() == EdgeKind::Odometry || edge.from() != edge.to())
    );

    // REST tells the same.
    for (path, same) in [
        ("/v1/maps/drive/sessions/robot/trajectory", &text),
        ("/v1/maps/drive/sessions/robot/trajectory?format=kitti", &kitti),
        ("/v1/maps/drive/graph.g2o", &graph),
    ] {
        assert!(get(&server, path).await.body == *same, "{path}");
    }
    let places = client.places("drive").await.unwrap();
    assert!(places.iter().all(|place| place.pose.is_some()), "a place without a pose");

    // And so does the map when it is opened anew, as near as relaxation ends.
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(state_hash(&client, "drive").await, map.state_hash);
    let again = exported(&client, SESSION, Format::Tum, Frame::Map, Body::Base).await;
    for (again, before) in from_tum(&again).unwrap().iter().zip(&on_the_map) {
        assert_eq!(again.stamp_ns, before.stamp_ns);
        assert!((again.pose.translation.vector - before.pose.translation.vector).norm() < 0.05);
    }
    server.stop().await;
}

/// How the robot at a frame lies to the robot at an earlier one, as a stereo camera would measure it.
fn measurement(session: &str, (frame, earlier): (u64, &str), pose: &PlanarPose) -> v1::MeasureClosureRequest {
    let mut covariance = vec![0.0; 36];
    (0..6).for_each(|axis| covariance[7 * axis] = 1e-4);
    v1::MeasureClosureRequest {
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
    let options = SessionOptions { camera: Some(camera()), ..session_options("drive", "robot") };
    let mut session = client.open_session(options).await.unwrap();
    let mut measured = Vec::new();
    for (number, input) in drive.inputs().enumerate() {
        session.send(input).await.unwrap();
        let Some(FrameOutcome::Answer(answer)) = session.next().await.unwrap() else { panic!("refused") };
        let Some(closure) = answer.closure.clone().filter(|_| answer.reason() == v1::Reason::LoopClosure)
        else {
            continue;
        };
        let earlier = closure.frame.unwrap();
        let pose = drive.truth(earlier.sequence as usize - 1).inverse().compose(&drive.truth(number));
        let request =
            measurement(SESSION, (answer.sequence, &format!("{SESSION}/frames/{}", earlier.sequence)), &pose);
        let before = state_hash(&client, "drive").await;
        let corrected = client.measure_closure(request.clone()).await.unwrap().unwrap();
        let after = state_hash(&client, "drive").await;
        assert_ne!(after, before);
        // Sent again, as after a lost answer, it changes nothing.
        assert_eq!(client.measure_closure(request).await.unwrap().unwrap(), corrected);
        assert_eq!(state_hash(&client, "drive").await, after);
        measured.push((number, earlier.sequence));
    }
    assert!(measured.len() >= 10, "{} measured", measured.len());
    // Frames some metres apart, which no recognition joins, show how large the map is.
    for later in (6..drive.frames.len()).step_by(6) {
        let pose = drive.truth(later - 6).inverse().compose(&drive.truth(later));
        let earlier = format!("{SESSION}/frames/{}", later - 5);
        let result = client.measure_closure(measurement(SESSION, (later as u64 + 1, &earlier), &pose)).await;
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
    type Spoil = fn(&mut v1::MeasureClosureRequest);
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
        let (said, message) = refused(client.measure_closure(request).await);
        assert_status(case, (said, &message), code, fragment);
        assert_eq!(state_hash(&client, "drive").await, hash, "{case}");
    }
    client.measure_closure(good).await.unwrap();
    assert_ne!(state_hash(&client, "drive").await, hash);
    server.stop().await;
}

/// A robot without odometry in a map that has it: places that it makes lie nowhere, those of others stay where they are.
#[tokio::test(flavor = "multi_thread")]
async fn a_session_without_odometry_leaves_the_metres_of_others_alone() {
    let drive = drive_round(3, "once");
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    let options = SessionOptions { camera: Some(camera()), ..session_options("drive", "wheels") };
    stream(client.open_session(options).await.unwrap(), drive.inputs()).await;
    let before = client.places("drive").await.unwrap();
    assert!(before.iter().all(|place| place.pose.is_some()));

    let other = drive_round(4, "once");
    let blind = |input| FrameInput { odometry: None, ..input };
    let inputs: Vec<FrameInput> = drive.inputs().map(blind).collect();
    let elsewhere = other.inputs().take(8).map(|input| FrameInput {
        odometry: None,
        sequence: input.sequence + 1_000,
        stamp_ns: input.stamp_ns + 3_600_000_000_000,
        ..input
    });
    let session = client.open_session(session_options("drive", "eyes")).await.unwrap();
    let outcomes = stream(session, inputs.into_iter().chain(elsewhere)).await;
    let answers: Vec<_> = outcomes
        .into_iter()
        .map(|outcome| match outcome {
            FrameOutcome::Answer(answer) => answer,
            FrameOutcome::Refusal(refusal) => panic!("{refusal:?}"),
        })
        .collect();
    let closures = answers.iter().filter(|answer| answer.reason() == v1::Reason::LoopClosure).count();
    assert!(closures >= 20, "{closures} closures of {}", answers.len());
    assert!(answers.iter().all(|answer| answer.map_pose.is_none()), "a pose that nobody measured");
    let after = client.places("drive").await.unwrap();
    assert!(after.len() > before.len());
    for (before, after) in before.iter().zip(&after) {
        assert_eq!(before.pose, after.pose, "{}", before.name);
    }
    server.stop().await;
}

/// Reads the files with the tool that everybody judges trajectories by, if it is there: `pip install evo`.
#[tokio::test(flavor = "multi_thread")]
async fn evo_reads_what_is_exported() {
    use v1::export_poses_request::{Body, Format, Frame};
    const SESSION: &str = "maps/drive/sessions/robot";
    let drive = drive_round(3, "twice");
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    let options = SessionOptions { camera: Some(camera()), ..session_options("drive", "robot") };
    stream(client.open_session(options).await.unwrap(), drive.inputs()).await;
    let truth = drive.true_poses();
    for (format, name, truth) in
        [(Format::Tum, "tum", to_tum(&truth)), (Format::Kitti, "kitti", to_kitti(&truth))]
    {
        let text = exported(&client, SESSION, format, Frame::Map, Body::Base).await;
        let Some(rmse_m) = evo_rmse_m(name, &truth, &text) else { break };
        let own = drive.rmse_m(
            &from_tum(&exported(&client, SESSION, Format::Tum, Frame::Map, Body::Base).await).unwrap(),
        );
        assert!((rmse_m - own).abs() < 1e-4, "{rmse_m} against {own}");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn poses_that_nobody_measured_are_refused_with_the_way_out() {
    use v1::export_poses_request::{Body, Format, Frame};
    let (server, client) = Server::with_map().await;
    crate::harness::answers(&client, "drive", "robot", (1..=3).map(frame)).await;
    let session = "maps/drive/sessions/robot";
    let ask = async |name: &str, format: Format, frame: Frame, body: Body| {
        let request = v1::ExportPosesRequest {
            name: name.to_owned(),
            format: format.into(),
            frame: frame.into(),
            body: body.into(),
        };
        refused(client.export_poses(request, &mut Vec::new()).await)
    };
    for (case, (code, message), expected, fragment) in [
        (
            "map",
            ask(session, Format::Tum, Frame::Map, Body::Base).await,
            Code::FailedPrecondition,
            "odometry",
        ),
        (
            "odom",
            ask(session, Format::Kitti, Frame::Odom, Body::Base).await,
            Code::FailedPrecondition,
            "odometry",
        ),
        (
            "camera",
            ask(session, Format::Tum, Frame::Odom, Body::Camera).await,
            Code::FailedPrecondition,
            "base_to_camera",
        ),
        (
            "graph",
            ask("maps/drive", Format::G2o, Frame::Map, Body::Base).await,
            Code::FailedPrecondition,
            "odometry",
        ),
        (
            "format",
            ask(session, Format::Unspecified, Frame::Map, Body::Base).await,
            Code::InvalidArgument,
            "TUM",
        ),
        (
            "session",
            ask("maps/drive/sessions/no", Format::Tum, Frame::Map, Body::Base).await,
            Code::NotFound,
            "no",
        ),
        (
            "a map's name",
            ask("maps/drive", Format::Tum, Frame::Map, Body::Base).await,
            Code::InvalidArgument,
            "maps/drive",
        ),
        ("no map", ask("maps/nowhere", Format::G2o, Frame::Map, Body::Base).await, Code::NotFound, "nowhere"),
    ] {
        assert_status(case, (code, &message), expected, fragment);
    }
    server.stop().await;
}

#[test]
fn the_command_line_writes_trajectories_and_graphs() {
    let waypost = CommandLine::new();
    let drive = drive_round(4, "once");
    waypost.text(&["model", "import", path(&model_file()), "--name", "shipped"]);
    waypost.text(&["map", "create", "drive", "--model", "shipped", "--place-spacing-m", "0.4"]);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let inputs: Vec<FrameInput> = drive.inputs().take(12).collect();
    let endpoint = waypost.endpoint();
    runtime.block_on(async {
        let client = Client::connect(&endpoint).await.unwrap();
        stream(client.open_session(session_options("drive", "robot")).await.unwrap(), inputs).await;
    });
    let directory = tempfile::tempdir().unwrap();
    let file = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let (tum, graph) = (file("robot.tum"), file("drive.g2o"));
    let told = waypost.text(&["map", "trajectory", "drive", "robot", "--out", &tum]);
    assert!(told.starts_with("12 lines"), "{told}");
    assert_eq!(from_tum(&std::fs::read(&tum).unwrap()).unwrap().len(), 12);
    waypost.text(&["map", "graph", "drive", "--out", &graph]);
    assert!(matches!(G2o::read(&std::fs::read(&graph).unwrap()), Ok(G2o::Planar(_))));
    assert!(waypost.text(&["map", "show", "drive"]).contains("0.4 m, 10.0 degrees"));
    let (_, stderr) = waypost.fails(&["map", "graph", "drive", "--out", &graph]);
    assert!(stderr.contains("--force"), "{stderr}");
}

#[test]
fn the_demo_drives_through_a_building() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let demo = |arguments: &[&str]| {
        let mut command = Built::command("waypost");
        command.args([
            "demo",
            "--data",
            path(&workspace().join("demo")),
            "--keep-data",
            path(&data),
            "--json",
        ]);
        command.args(arguments);
        run_to_its_end(command)
    };
    let driven = demo(&["--world", "loop", "--route", "once", "--seed", "2"]);
    assert!(driven.status.success(), "{}", String::from_utf8_lossy(&driven.stderr));
    let report = json_object(&String::from_utf8(driven.stdout).unwrap());
    let number = |field: &str| report[field].as_f64().unwrap();
    assert!(number("driven_m") > 45.0 && number("frames") > 90.0, "{report}");
    assert!(
        number("map_error_m") < 1.0 && number("map_error_m") < number("wheels_error_m") / 4.0,
        "{report}"
    );
    let closures = report["closures"].as_array().unwrap();
    assert!(
        !closures.is_empty() && closures.iter().all(|seen| seen["apart_m"].as_f64().unwrap() < 1.0),
        "{report}"
    );
    let picture = std::fs::read_to_string(report["picture"].as_str().unwrap()).unwrap();
    let drawn = roxmltree::Document::parse(&picture).unwrap();
    let words: Vec<&str> = drawn.descendants().filter_map(|node| node.text()).collect();
    assert!(["truth", "wheels alone", "map"].iter().all(|layer| words.contains(layer)), "{words:?}");
    for (arguments, fragment) in [
        (&["--world", "garden"][..], "there are office, corridors"),
        (&["--world", "loop", "--route", "thrice"], "there are once, twice"),
    ] {
        let refused = demo(arguments);
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && said.contains(fragment), "{said}");
    }
}
