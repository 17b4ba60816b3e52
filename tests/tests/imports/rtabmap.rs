//! Maps of RTAB-Map, of databases that are made here by its published schemas, and real ones where they are at hand.

#[path = "../../../bags/tests/bags/writing/rtabmap_file.rs"]
#[expect(unreachable_pub, reason = "the writer of another crate's tests")]
mod rtabmap_file;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use waypost_sim::drive::{FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX};
use waypost_sim::robot::WheelErrors;
use waypost_sim::worlds::NamedWorld;

use self::rtabmap_file::{Drive, Node, Rows, calibration, on_the_floor, rtabmap};
use crate::harness::{
    Built, CommandLine, images, json_object, odometry, path, planar, run_to_its_end, workspace,
};

/// The photos of the first way and of the way back over the same floor: nodes 1 to 53 of map_id 0, nodes 100 to 152 of
/// map_id 3.
const FIRST: std::ops::Range<usize> = 0..53;
const BACK: std::ops::Range<usize> = 99..152;

/// The photos are of 640 x 360 pixels; how their camera saw is not known, and this is near.
fn photo_calibration(minor: u32) -> Vec<u8> {
    calibration(minor, [500.0, 500.0, 320.0, 180.0], (640, 360))
}

fn photo(index: usize, map_id: i64, minor: u32) -> Node {
    Node {
        id: index as i64 + 1,
        map_id,
        stamp_s: 1000.0 + index as f64,
        pose: on_the_floor((index - index / 99 * 99) as f32, 0.0, 0.0),
        image: Some(images()[index].clone()),
        depth: Some(vec![1; 9]),
        calibration: photo_calibration(minor),
        ..Node::default()
    }
}

/// Closures of the sequence that are true, as (later, earlier) node.
fn true_closures() -> Vec<(i64, i64)> {
    let table = std::fs::read_to_string(workspace().join("demo/sequence/loops.csv")).unwrap();
    let pairs = table.lines().skip(1).filter_map(|line| line.split_once(','));
    pairs
        .map(|(query, matched)| (query.parse::<i64>().unwrap() + 1, matched.parse::<i64>().unwrap() + 1))
        .collect()
}

/// Both ways, with the true closures of the first half of the way back, and a wrong one.
fn walk(minor: u32) -> Drive {
    let nodes = FIRST.map(|index| photo(index, 0, minor)).chain(BACK.map(|index| photo(index, 3, minor)));
    let half = true_closures().into_iter().filter(|(later, _)| *later < 126);
    let links = half.map(|(later, earlier)| (later, earlier, 1)).chain([(151, 2, 2), (7, 6, 0)]);
    Drive { nodes: nodes.collect(), links: links.collect(), ..Drive::default() }
}

/// A folder with a database of a version.
struct Written(tempfile::TempDir);

impl Written {
    fn new(version: &str, drive: &Drive) -> Self {
        let folder = tempfile::tempdir().unwrap();
        rtabmap(&folder.path().join("walk.db"), version, drive);
        Self(folder)
    }

    fn path(&self) -> PathBuf {
        self.0.path().join("walk.db")
    }
}

fn import(waypost: &CommandLine, database: &Path) -> Value {
    waypost.json(&["import", path(database), "--map", "drive"])
}

fn nodes(report: &Value, list: &str) -> Vec<(i64, i64)> {
    let pairs = report["closures"][list].as_array().unwrap().iter();
    pairs.map(|pair| (pair["node"].as_i64().unwrap(), pair["matched_node"].as_i64().unwrap())).collect()
}

fn of_sessions(report: &Value, field: &str) -> Value {
    report["sessions"].as_array().unwrap().iter().map(|session| session[field].clone()).collect()
}

#[test]
fn drives_become_sessions_and_closures_are_held_against_each_other() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let database = Written::new("0.23.1", &walk(23));
    let report = import(&waypost, &database.path());
    assert_eq!(
        of_sessions(&report, "session"),
        json!(["maps/drive/sessions/walk-0", "maps/drive/sessions/walk-3"])
    );
    assert_eq!(
        (of_sessions(&report, "answered"), of_sessions(&report, "refused")),
        (json!([53, 53]), json!([0, 0]))
    );
    assert_eq!(of_sessions(&report, "camera"), json!([true, true]));

    // A frame is its node: note, stamp and odometry.
    let frames = waypost.json(&["session", "frames", "drive", "walk-3"]);
    let tenth = &frames["frames"][9];
    assert_eq!(
        (tenth["note"].as_str(), tenth["stamp_ns"].as_i64()),
        (Some("node 109"), Some(1_108_000_000_000))
    );
    assert_eq!(tenth["odometry"]["pose"]["position_m"]["x"], 9.0);
    assert!(
        waypost.text(&["explain", "drive", "walk-3", "node 109"]).contains("frame"),
        "not found by its node"
    );

    // Nearly all that is true is found, the wrong one is not, and what RTAB-Map did not see is told.
    let (found, only) = (nodes(&report, "theirs_found"), nodes(&report, "theirs_only"));
    let theirs = true_closures().into_iter().filter(|(later, _)| *later < 126).count() + 1;
    assert_eq!(found.len() + only.len(), theirs);
    assert!(found.len() * 10 >= theirs * 8, "{found:?} but not {only:?}");
    assert!(only.contains(&(151, 2)), "{only:?}");
    let (ours_found, ours_only) = (nodes(&report, "ours_found"), nodes(&report, "ours_only"));
    assert!(ours_found.len() >= 8 && ours_found.iter().all(|(later, _)| *later <= 130), "{ours_found:?}");
    assert!(ours_only.len() >= 5 && ours_only.iter().all(|(later, _)| *later > 126), "{ours_only:?}");
    assert_eq!(report["closures"]["within_nodes"], 5);
    assert_eq!(report["trajectories"], Value::Array(Vec::new()));
    let remarks = report["remarks"].as_array().unwrap();
    assert_eq!(remarks, &["not taken over: 106 depth images"]);

    // The same closures by a stricter rule: only those of the very same nodes are the same.
    let strict = waypost.json(&["import", path(&database.path()), "--map", "drive", "--within", "0"]);
    assert_eq!(of_sessions(&strict, "answered"), json!([0, 0]));
    assert!(nodes(&strict, "theirs_found").len() < found.len());
    let text = waypost.text(&["import", path(&database.path()), "--map", "drive"]);
    assert!(text.contains("walk-3 is complete") && text.contains("151–2 nearby"), "{text}");
}

#[test]
fn an_import_goes_on_where_it_stopped_and_is_taken_out_session_by_session() {
    let waypost = CommandLine::new();
    waypost.prepare();
    // What RTAB-Map had written when it was in the middle of the second way.
    let mut early = walk(21);
    early.nodes.truncate(FIRST.len() + 7);
    let report = import(&waypost, &Written::new("0.21.4", &early).path());
    assert_eq!(of_sessions(&report, "answered"), json!([53, 7]));
    let database = Written::new("0.21.4", &walk(21));
    let report = import(&waypost, &database.path());
    assert_eq!(of_sessions(&report, "answered"), json!([0, 46]));
    assert_eq!(of_sessions(&report, "resumed_after_sequence"), json!([53, 7]));
    let at_once = CommandLine::new();
    at_once.prepare();
    let whole = import(&at_once, &database.path());
    let shown = |waypost: &CommandLine| waypost.json(&["map", "show", "drive"])["state_hash"].clone();
    assert_eq!(report["closures"], whole["closures"]);
    assert_eq!(shown(&waypost), shown(&at_once), "in two goes it is another map");

    // Another database does not go on in those sessions.
    let mut other = walk(21);
    other.nodes[52].stamp_s += 0.5;
    other.nodes[53].stamp_s += 0.5;
    let other = Written::new("0.21.4", &other);
    let (code, told) = waypost.fails(&["import", path(&other.path()), "--map", "drive"]);
    assert!(code == 1 && told.contains("begun with another database") && told.contains("node 53"), "{told}");

    waypost.text(&["session", "rm", "drive", "walk-3", "--yes"]);
    let again = import(&waypost, &database.path());
    assert_eq!(of_sessions(&again, "answered"), json!([0, 53]));
    assert_eq!(again["closures"], whole["closures"]);
}

/// The last node is the same in both: what tells them apart is which nodes have images.
#[test]
fn a_database_goes_on_where_its_own_frames_are_and_not_where_they_lack() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let mut whole = walk(21);
    (whole.nodes, whole.links) = (whole.nodes[..12].to_vec(), Vec::new());
    let mut holed = whole.clone();
    holed.nodes[6].image = None;
    let (whole_file, holed_file) = (Written::new("0.21.4", &whole), Written::new("0.21.4", &holed));
    let into = |database: &Written, session: &str| {
        let database = database.path();
        ["import", path(&database), "--map", "drive", "--session", session].map(str::to_owned)
    };
    let run = |arguments: [String; 6]| {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        waypost.json(&arguments)
    };
    let refused = |arguments: [String; 6]| {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let (code, told) = waypost.fails(&arguments);
        assert_eq!(code, 1, "{told}");
        told
    };
    assert_eq!(of_sessions(&run(into(&holed_file, "holed")), "answered"), json!([11]));
    let told = refused(into(&whole_file, "holed"));
    assert!(
        told.contains("holed-0 was begun with another database: it has no frame 7, which is node 7 at"),
        "{told}"
    );
    assert_eq!(of_sessions(&run(into(&holed_file, "holed")), "answered"), json!([0]));
    assert_eq!(of_sessions(&run(into(&whole_file, "whole")), "answered"), json!([12]));
    let told = refused(into(&holed_file, "whole"));
    assert!(
        told.contains("its frame 7 is node 7 at") && told.contains("here is none of that number"),
        "{told}"
    );

    // One whose image the server refuses is lacking for that, and the rest goes on.
    let mut cut = whole.clone();
    if let Some(image) = &mut cut.nodes[6].image {
        image.truncate(image.len() / 8);
    }
    let cut_file = Written::new("0.21.4", &cut);
    let arguments = into(&cut_file, "cut");
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let ended = waypost.run(&arguments);
    let told = String::from_utf8(ended.stderr).unwrap();
    assert!(ended.status.code() == Some(5) && told.contains("node 7: refused"), "{told}");
    assert_eq!(of_sessions(&run(into(&cut_file, "cut")), "answered"), json!([0]));
}

#[test]
fn what_is_missing_is_said_before_anything_is_sent() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let mut drive = walk(18);
    drive.nodes.truncate(6);
    drive.nodes.iter_mut().for_each(|node| node.calibration = Vec::new());
    drive.nodes[2].image = None;
    drive.nodes[3].pose = [0.0; 12];
    let database = Written::new("0.18.3", &drive);
    let import = ["import", path(&database.path()), "--map", "drive"].map(str::to_owned);
    let import: Vec<&str> = import.iter().map(String::as_str).collect();
    let (code, told) = waypost.fails(&import);
    assert!(code == 1 && told.contains("no calibration") && told.contains("--camera none"), "{told}");
    assert!(told.contains("1 of 6 nodes are left out: it has no image"), "{told}");
    assert!(told.contains("1 of 5 frames are without odometry"), "{told}");
    assert_eq!(waypost.json(&["session", "ls", "drive"])["sessions"].as_array().unwrap().len(), 0);
    let (_, told) = waypost.fails(&[&import[..], &["--camera", "500,500,20,20"]].concat());
    assert!(told.contains("far from that of the first image"), "{told}");

    let report = waypost.json(&[&import[..], &["--camera", "none", "--session", "blind"]].concat());
    assert_eq!(
        (of_sessions(&report, "answered"), of_sessions(&report, "camera")),
        (json!([5]), json!([false]))
    );
    let (code, told) = waypost.fails(&["stream", path(&database.path()), "--map", "drive"]);
    assert!(code == 1 && told.contains("waypost import"), "{told}");
    let (code, told) =
        waypost.fails(&["import", path(&database.path()), "--map", "nowhere", "--camera", "none"]);
    assert!(code == 4 && told.contains("nowhere"), "{told}");
}

#[test]
fn a_database_is_inspected_without_a_server() {
    let database = Written::new("0.22.0", &walk(22));
    let inspect = |arguments: &[&str]| {
        let mut command = Built::command("waypost");
        command.args(["inspect", path(&database.path())]).args(arguments);
        let ended = run_to_its_end(command);
        (ended.status.success(), String::from_utf8([ended.stdout, ended.stderr].concat()).unwrap())
    };
    let (_, text) = inspect(&[]);
    assert!(text.contains("made by RTAB-Map 0.22.0; `waypost import` takes 106 frames"), "{text}");
    let (_, json) = inspect(&["--json"]);
    let inspected = json_object(&json);
    assert_eq!(
        (&inspected["sessions"][1]["map_id"], &inspected["sessions"][1]["frames"]),
        (&3.into(), &53.into())
    );
    assert_eq!(inspected["sessions"][0]["length_m"], 52.0);
    assert_eq!(
        (&inspected["links"]["nearby_closures"], &inspected["links"]["neighbors"]),
        (&1.into(), &1.into())
    );
    let (done, told) = inspect(&["--image-topic", "/camera"]);
    assert!(!done && told.contains("--image-topic is for bags"), "{told}");
}

/// A simulated robot, whose truth stands for a perfect optimisation by RTAB-Map: the map undoes what odometry drifts.
#[test]
fn the_map_is_nearer_to_optimised_poses_than_odometry_is() {
    let wheels = WheelErrors { scale: 0.05, drift_rad_per_m: 2_f64.to_radians(), ..WheelErrors::NONE };
    let driven = crate::harness::Drive::new(NamedWorld::Loop, 3, "twice", wheels);
    let (width, height) = IMAGE_SIZE_PX;
    let focal_px = f64::from(width) / 2.0 / (FIELD_OF_VIEW_RAD / 2.0).tan();
    let intrinsics = [focal_px, focal_px, f64::from(width) / 2.0, f64::from(height) / 2.0];
    let rows = |x_m: f64, y_m: f64, heading_rad: f64| -> Rows {
        on_the_floor(x_m as f32, y_m as f32, heading_rad as f32)
    };
    let inputs = driven.inputs().zip(&driven.frames).zip(1..);
    let nodes = inputs.map(|((input, frame), id)| {
        let by_wheels = planar(&odometry(&frame.odometry).pose.unwrap());
        let waypost_client::FrameContent::Image(image) = input.content else { panic!("no image") };
        Node {
            id,
            stamp_s: 1.0 + frame.stamp_ns as f64 * 1e-9,
            pose: rows(by_wheels.x_m(), by_wheels.y_m(), by_wheels.heading_rad()),
            image: Some(image),
            calibration: calibration(20, intrinsics, IMAGE_SIZE_PX),
            ..Node::default()
        }
    });
    let truth = (0..driven.frames.len()).map(|frame| driven.truth(frame)).zip(1..);
    let optimized = truth.map(|(pose, id)| (id, rows(pose.x_m(), pose.y_m(), pose.heading_rad())));
    let database = Written::new(
        "0.20.8",
        &Drive { nodes: nodes.collect(), optimized: optimized.collect(), ..Drive::default() },
    );
    let waypost = CommandLine::new();
    waypost.prepare();
    let report = import(&waypost, &database.path());
    let trajectory = &report["trajectories"][0];
    let rmse_m = |of: &str| trajectory[of]["rmse_m"].as_f64().unwrap();
    assert!(trajectory["length_m"].as_f64().unwrap() > 50.0, "{trajectory}");
    assert!(rmse_m("map") < 0.6 * rmse_m("odometry"), "{trajectory}");
    assert!(nodes_len(&report) >= 10, "{report}");
    println!("{trajectory}");
}

/// How many closures the map has that RTAB-Map has not.
fn nodes_len(report: &Value) -> usize {
    nodes(report, "ours_only").len()
}

#[test]
fn real_databases_are_imported() {
    let beside_the_repository = || workspace().join("../shared/data");
    let data = std::env::var_os("WAYPOST_DATA").map_or_else(beside_the_repository, PathBuf::from);
    let folder = data.join("imports/rtabmap");
    if !folder.is_dir() {
        eprintln!("skipped: there is no {}", folder.display());
        return;
    }
    let waypost = CommandLine::new();
    waypost.prepare();
    for (name, unused) in
        [("v0.17.3_1node.db", "1 laser scans"), ("v0.21.1_1node_310words.db", "310 visual words")]
    {
        let session = name.split('.').nth(1).unwrap();
        let report =
            waypost.json(&["import", path(&folder.join(name)), "--map", "drive", "--session", session]);
        assert_eq!(
            (of_sessions(&report, "answered"), of_sessions(&report, "camera")),
            (json!([1]), json!([true]))
        );
        assert!(report["remarks"][0].as_str().unwrap().contains(unused), "{report}");
    }
    for name in ["v0.19.3_empty.db", "v0.22.1_empty.db"] {
        let (code, told) = waypost.fails(&["import", path(&folder.join(name)), "--map", "drive"]);
        assert!(code == 1 && told.contains("has no nodes"), "{told}");
    }
}
