//! RTAB-Map's databases.

use std::ops::ControlFlow;
use std::path::Path;

use rusqlite::Connection;
use waypost_bags::rtabmap::RtabMap;

use super::recordings::is_finite_pose;
use crate::Fed;

/// By the first byte of an input: the whole database, or what a good one has in one place.
const PLACES: [Option<&str>; 6] = [
    None,
    Some("UPDATE Data SET calibration = ?1 WHERE id = 1"),
    Some("UPDATE Admin SET opt_ids = ?1"),
    Some("UPDATE Admin SET opt_poses = ?1"),
    Some("UPDATE Data SET image = ?1 WHERE id = 1"),
    Some("UPDATE Node SET pose = ?1 WHERE id = 1"),
];

/// With its kind in front.
const GOOD_DATABASE: &[u8] = include_bytes!("../../corpus/rtabmap/taken-plain.db");

/// A database of RTAB-Map, or a part of one, with its kind in front.
pub(super) fn database(bytes: &[u8]) -> Fed {
    let Some((kind, content)) = bytes.split_first() else { return Fed::Refused };
    // A folder of its own: SQLite looks for what an earlier one left beside it.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.db");
    match PLACES[usize::from(*kind) % PLACES.len()] {
        None => std::fs::write(&path, content).unwrap(),
        Some(update) => changed(&path, update, content),
    }
    let map = match RtabMap::open(&path) {
        Ok(map) => map,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return Fed::Refused;
        }
    };
    assert!(map.optimized().values().all(is_finite_pose));
    for session in map.sessions() {
        assert!(session.nodes.windows(2).all(|nodes| nodes[0].id < nodes[1].id));
        assert!(session.nodes.iter().filter_map(|node| node.pose.as_ref()).all(is_finite_pose));
        let mut images = 0;
        let read = map.read_images(session, 0, &mut |_, _, image| {
            assert!(image.len() <= bytes.len() + GOOD_DATABASE.len());
            images += 1;
            ControlFlow::Continue(())
        });
        read.expect("a database that did not change is read again as it was read before");
        assert_eq!(images, session.frames().count());
    }
    Fed::Taken
}

/// Writes the good database with another content of one place.
fn changed(path: &Path, update: &str, content: &[u8]) {
    std::fs::write(path, &GOOD_DATABASE[1..]).unwrap();
    let database = Connection::open(path).unwrap();
    database.execute_batch("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF").unwrap();
    database.execute(update, [content]).unwrap();
}
