//! A simulated robot maps a building over gRPC; what comes back, and what is exported, is judged against the truth.

mod corrected;
mod measured;

use posegraph::g2o::G2o;
use posegraph::trajectory::{from_tum, to_kitti, to_tum};
use posegraph::{EdgeKind, PlanarPose, Pose as _};
use waypost_client::{Client, Code, FrameInput, FrameOutcome, SessionOptions, v1};
use waypost_sim::robot::WheelErrors;
use waypost_sim::worlds::NamedWorld;

use crate::harness::{
    Built, CommandLine, Drive, Server, as_words, assert_status, camera_ahead, evo_rmse_m, exported, followed,
    get, import_model, json_object, map_request, model_file, odometry, path, planar, refused, run_to_its_end,
    session_options, state_hash, stream, words_options,
};

/// Round a ring of corridors with wheels that are five percent and two degrees a metre off.
fn drive_round(seed: u64, route: &str) -> Drive {
    let wheels = WheelErrors { scale: 0.05, drift_rad_per_m: 2_f64.to_radians(), ..WheelErrors::NONE };
    Drive::new(NamedWorld::Loop, seed, route, wheels)
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
    assert_eq!(Some(state_hash(&client, "drive").await), map.state_hash);
    let again = exported(&client, SESSION, Format::Tum, Frame::Map, Body::Base).await;
    for (again, before) in from_tum(&again).unwrap().iter().zip(&on_the_map) {
        assert_eq!(again.stamp_ns, before.stamp_ns);
        assert!((again.pose.translation.vector - before.pose.translation.vector).norm() < 0.05);
    }
    server.stop().await;
}

/// Where a place is made without odometry, the map is in two parts until a loop closes.
#[tokio::test(flavor = "multi_thread")]
async fn odometry_may_be_missing_for_a_while() {
    const BLIND: std::ops::Range<u64> = 20..28;
    let drive = drive_round(3, "once");
    let blind = |input: FrameInput| {
        if BLIND.contains(&input.sequence) { FrameInput { odometry: None, ..input } } else { input }
    };
    let inputs: Vec<FrameInput> = drive.words().map(blind).collect();
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    // Parts of places that were made before, and of those made later.
    let parts = async || {
        let places = client.places("drive").await.unwrap();
        let made_by = |place: &v1::Place| place.frames.first().map_or(0, |frame| frame.sequence);
        let (before, later): (Vec<_>, Vec<_>) = places.iter().partition(|place| made_by(place) < BLIND.start);
        [before, later].map(|places| {
            let parts = places.iter().map(|place| place.pose.as_ref().unwrap().part);
            parts.collect::<std::collections::BTreeSet<u32>>()
        })
    };
    let options = || SessionOptions { camera: Some(camera()), ..words_options("drive", "robot") };
    let (begin, end) = inputs.split_at(60);
    stream(client.open_session(options()).await.unwrap(), begin.to_vec()).await;
    let [before, later] = parts().await;
    assert_eq!(before, [0].into());
    assert!(later.len() == 1 && !later.contains(&0), "{later:?}");
    stream(client.open_session(options()).await.unwrap(), end.to_vec()).await;
    assert!(!client.loop_closures("drive").await.unwrap().is_empty());
    assert_eq!(parts().await, [[0].into(), [0].into()]);
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
    let options = SessionOptions { camera: Some(camera()), ..words_options("drive", "wheels") };
    stream(client.open_session(options).await.unwrap(), drive.words()).await;
    let before = client.places("drive").await.unwrap();
    assert!(before.iter().all(|place| place.pose.is_some()));

    let other = drive_round(4, "once");
    let blind = |input| FrameInput { odometry: None, ..input };
    let inputs: Vec<FrameInput> = drive.words().map(blind).collect();
    let elsewhere = other.words().take(8).map(|input| FrameInput {
        odometry: None,
        sequence: input.sequence + 1_000,
        stamp_ns: input.stamp_ns + 3_600_000_000_000,
        ..input
    });
    let session = client.open_session(words_options("drive", "eyes")).await.unwrap();
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
    let options = SessionOptions { camera: Some(camera()), ..words_options("drive", "robot") };
    stream(client.open_session(options).await.unwrap(), drive.words()).await;
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
    crate::harness::answers(&client, "drive", "robot", (1..=3).map(as_words)).await;
    let session = "maps/drive/sessions/robot";
    let ask = async |name: &str, format: Format, frame: Frame, body: Body| {
        let request = v1::ExportPosesRequest {
            name: name.to_owned(),
            format: format.into(),
            frame: frame.into(),
            body: body.into(),
            every: 0,
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
    let thinned = v1::ExportPosesRequest {
        name: "maps/drive".to_owned(),
        format: Format::G2o.into(),
        every: 2,
        ..Default::default()
    };
    let (code, message) = refused(client.export_poses(thinned, &mut Vec::new()).await);
    assert_status("a thinned graph", (code, &message), Code::InvalidArgument, "cannot be thinned");
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
    let shown = waypost.text(&["map", "show", "drive"]);
    assert!(shown.contains("place spacing        0.4 m\n"), "{shown}");
    assert!(shown.contains("place spacing        10.0 degrees\n"), "{shown}");
    let (_, stderr) = waypost.fails(&["map", "graph", "drive", "--out", &graph]);
    assert!(stderr.contains("--force"), "{stderr}");
}

#[test]
fn the_demo_drives_through_a_building() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let demo = |arguments: &[&str]| {
        let mut command = Built::command("waypost");
        // Not in the repository: what ships is found from anywhere.
        command.current_dir(directory.path());
        command.args(["demo", "--keep-data", path(&data), "--json"]).args(arguments);
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
        (&["--world", "garden"][..], "possible values: office, corridors"),
        (&["--world", "loop", "--route", "thrice"], "there are once, twice"),
    ] {
        let refused = demo(arguments);
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && said.contains(fragment), "{said}");
    }
}
