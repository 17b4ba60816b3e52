//! Drives are decided as they were when the golden files were written, bit for bit.

use std::f64::consts::FRAC_PI_2;
use std::path::PathBuf;

use fabmap::observation::Observation;
use posegraph::PlanarPose;
use topomap::mapper::{FrameInput, Localizer, Mapper};
use topomap::settings::{MapperSettings, PlaceRule};

use crate::rounds::{CameraModel, Robot, round};
use crate::transcript::{check, of_frames, of_log, of_query};
use crate::{building, drives, look_alikes, rounds};

/// Decides all frames of a drive, and writes down what was decided.
type Drive = fn() -> String;

/// Golden file and the drive whose decisions it has.
const DRIVES: [(&str, Drive); 7] = [
    ("metric", by_metres),
    ("metric-each-frame", by_metres_each_frame),
    ("merging", merged),
    ("words", by_words),
    ("words-each-frame", by_words_each_frame),
    ("verification", verified),
    ("localizing", localized),
];

fn file(name: &str) -> PathBuf {
    PathBuf::from(format!("{}/tests/golden/{name}.txt", env!("CARGO_MANIFEST_DIR")))
}

#[test]
fn drives_are_decided_as_before() {
    for (name, drive) in DRIVES {
        check(&file(name), &drive());
    }
}

#[test]
#[ignore = "writes what is decided now as what is to be decided"]
fn write_golden() {
    for (name, drive) in DRIVES {
        std::fs::write(file(name), drive()).unwrap();
    }
}

/// Rounds with wheels that drift, a dark frame, one without odometry, cameras that are not known,
/// what the robot measures by itself, and a second session.
fn drive_by_metres(settings: MapperSettings) -> Robot {
    let mut robot = Robot::new(settings, [0.05, 2_f64.to_radians()]);
    robot.see();
    round(&mut robot);
    robot.go(0.4, 0.0);
    let dark = FrameInput { observation: Observation::default(), ..robot.input() };
    robot.take(dark, CameraModel::Known);
    round(&mut robot);
    for _ in 0..5 {
        robot.go(0.4, 0.05);
        let without = FrameInput { odometry: None, ..robot.input() };
        robot.take(without, CameraModel::Unknown);
        robot.go(0.1, 0.0);
        let turned = robot.input();
        robot.take(turned, CameraModel::Unknown);
    }
    let last = robot.see().frame;
    robot.measure(last, 5, &PlanarPose::new(0.02, 0.01, 0.0)).unwrap();
    robot.pose = PlanarPose::new(2.0, -2.0, FRAC_PI_2);
    robot.begin();
    for _ in 0..6 {
        robot.see();
        robot.go(0.4, 0.0);
    }
    for _ in 0..6 {
        robot.go(0.0, -FRAC_PI_2 / 6.0);
        robot.see();
    }
    round(&mut robot);
    robot
}

fn by_metres() -> String {
    let robot = drive_by_metres(MapperSettings::default());
    let later = MapperSettings { guard_frames: 4, ..MapperSettings::default() };
    of_log(&rounds::model(), MapperSettings::default(), &robot.log)
        + &of_log(&rounds::model(), later, &drive_by_metres(later).log)
}

fn by_metres_each_frame() -> String {
    let settings = MapperSettings { place_rule: PlaceRule::EachFrame, ..MapperSettings::default() };
    let mut robot = Robot::new(settings, [0.01, 0.0]);
    for _ in 0..60 {
        robot.see();
        robot.go(0.2, 0.05);
    }
    of_log(&rounds::model(), settings, &robot.log)
}

fn merged() -> String {
    let (source, target) = (building::second(building::unique), building::first(building::unique));
    let joined = target.joined_by(&source, &building::plan(&source, &target));
    of_log(&building::model(), MapperSettings::default(), &joined.log)
}

const WAY: [(u32, u64); 30] = [
    (0, 3),
    (0, 3),
    (0, 4),
    (0, 5),
    (0, 6),
    (0, 7),
    (0, 8),
    (0, 3),
    (0, 4),
    (0, 5),
    (1, 3),
    (1, 9),
    (1, 10),
    (1, 4),
    (0, 6),
    (0, 11),
    (1, 12),
    (1, 4),
    (1, 4),
    (1, 4),
    (1, 4),
    (1, 5),
    (0, 12),
    (0, 3),
    (0, 3),
    (0, 3),
    (0, 3),
    (1, 8),
    (1, 7),
    (1, 6),
];

fn drive_by_words(settings: MapperSettings) -> String {
    let mut mapper = Mapper::new(&drives::model(), settings).unwrap();
    let mut log = Vec::new();
    drives::drive(&mut mapper, &mut log, &WAY, 5);
    let mut text = of_log(&drives::model(), settings, &log);
    for place in [3, 8, 12, 99] {
        text += &of_query(&drives::query(&mapper, &log, place));
    }
    text
}

fn by_words() -> String {
    drive_by_words(drives::settings())
}

fn by_words_each_frame() -> String {
    let settings = MapperSettings { place_rule: PlaceRule::EachFrame, ..drives::settings() };
    let log = drives::drive_and_stand(settings);
    drive_by_words(settings) + &of_log(&drives::model(), settings, &log)
}

fn verified() -> String {
    let world = look_alikes::World::driven();
    let mut text = of_log(&look_alikes::model(), look_alikes::settings(), &world.log);
    for place in [1, 4, 9] {
        text += &of_query(&world.query(place));
    }
    text + &of_frames(&world.localized(&[2, 3, 3, 4, 9, 5, 6]))
}

fn localized() -> String {
    let mut robot = drive_by_metres(MapperSettings::default());
    let mut localizer = Localizer::new();
    let mut events = Vec::new();
    for _ in 0..40 {
        robot.go(0.3, 0.04);
        let input = FrameInput { session: Localizer::SESSION, ..robot.input() };
        let event = robot.localize(&localizer, input);
        localizer.follow(&event, &robot.mapper);
        events.push(event);
    }
    of_frames(&events)
}
