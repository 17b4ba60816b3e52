//! Logs of earlier versions, with metres, still fold.

use std::f64::consts::FRAC_PI_2;

use crate::words::WORDS;
use fabmap::PlaceId;
use fabmap::codec::{Reader, Writer};
use posegraph::{PlanarPose, Pose};
use topomap::log::{LinkKind, MapEvent};
use topomap::mapper::Mapper;
use topomap::settings::{GuardMeasure, MapperSettings};

use crate::rounds::{Robot, apart_m, model};

/// A short drive with a loop that version 3 logged, and one with a measurement that version 4 did,
/// events one after the other.
#[test]
fn logs_of_versions_3_and_4_still_fold() {
    folds(include_bytes!("fixtures/log-v3.bin"), "cf9ff376492bc7e7");
    folds(include_bytes!("fixtures/log-v4.bin"), "ea3d85494fcbc250");
}

/// `state_hash`: what the program of then made of it.
fn folds(bytes: &[u8], state_hash: &str) {
    let mut reader = Reader::new(bytes);
    // As the maps that they are of count.
    let guard_measure = GuardMeasure::Frames;
    let settings = MapperSettings { guard_frames: 4, guard_measure, ..MapperSettings::default() };
    let mut mapper = Mapper::new(&model(), settings).unwrap();
    while reader.remaining() > 0 {
        let event = MapEvent::from_bytes(reader.bytes().unwrap(), WORDS as usize).unwrap();
        mapper.apply(&event).unwrap();
    }
    assert_eq!(mapper.state_hash().to_string()[..16], *state_hash);
    let kinds =
        |kind: fn(&LinkKind) -> bool| mapper.map().links().iter().filter(|link| kind(&link.kind)).count();
    assert_eq!(kinds(|kind| matches!(kind, LinkKind::Driven(_))), mapper.map().places().len() - 1);
    assert!(kinds(|kind| matches!(kind, LinkKind::Closed(_))) > 0);
    let pose = mapper.map_pose(mapper.map().session(0).unwrap()).unwrap();
    assert!(pose.part == PlaceId::new(0) && apart_m(&pose.robot, &PlanarPose::identity()) < 0.6, "{pose:?}");
}

#[test]
#[ignore = "writes the fixture of a new format version"]
fn write_fixture() {
    let mut robot = Robot::new(MapperSettings { guard_frames: 4, ..MapperSettings::default() }, [0.01, 0.01]);
    robot.see();
    for _ in 0..4 {
        for _ in 0..3 {
            robot.go(0.6, 0.0);
            robot.see();
        }
        for _ in 0..6 {
            robot.go(0.0, FRAC_PI_2 / 6.0);
            robot.see();
        }
    }
    let last = robot.log.len() as u64 - 1;
    robot.measure(last, 1, &PlanarPose::identity()).unwrap();
    let mut writer = Writer::default();
    robot.log.iter().for_each(|event| writer.bytes(&event.to_bytes()));
    std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/log-v4.bin"), writer.into_bytes())
        .unwrap();
}
