//! Databases of RTAB-Map that are made here by its published schemas, whole and spoilt, and real ones where they are at hand.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use proptest::prelude::*;
use rusqlite::Connection;
use waypost_bags::Lens;
use waypost_bags::rtabmap::{ClosureKind, NoCamera, Omitted, RtabError, RtabMap};

use crate::writing::rtabmap_file::{Drive, Node, calibration, on_the_floor, rtabmap};
use crate::writing::{Folder, png};

pub(crate) const INTRINSICS: [f64; 4] = [50.0, 51.0, 4.0, 3.0];
/// Of the images that are made here.
pub(crate) const SIZE_PX: (u32, u32) = (8, 6);

/// Two drives: nodes 1 to 4 and 5 to 8, with a closure between them, and one nearby.
pub(crate) fn drive(minor: u32) -> Drive {
    let nodes = (1..=8).map(|id| Node {
        id,
        map_id: (id - 1) / 4,
        stamp_s: 1000.0 + id as f64,
        pose: on_the_floor(id as f32, 0.0, 0.1),
        image: Some(png(id as u8)),
        depth: Some(vec![7; 20]),
        calibration: calibration(minor, INTRINSICS, SIZE_PX),
        ..Node::default()
    });
    Drive {
        nodes: nodes.collect(),
        links: vec![(1, 2, 0), (2, 3, 0), (3, 4, 0), (5, 6, 0), (6, 2, 1), (8, 4, 2), (3, -5, 8)],
        optimized: (1..=8).map(|id| (id, on_the_floor(id as f32, 0.5, 0.0))).collect(),
        ..Drive::default()
    }
}

fn written(folder: &Folder, version: &str, drive: &Drive) -> PathBuf {
    let path = folder.path().join("rtabmap.db");
    rtabmap(&path, version, drive);
    path
}

fn refused(path: &Path) -> RtabError {
    RtabMap::open(path).unwrap_err()
}

/// The images of a session, as node ids and numbers.
fn images(map: &RtabMap, session: usize, after: u64) -> Vec<(u64, i64)> {
    let mut seen = Vec::new();
    let read = map.read_images(&map.sessions()[session], after, &mut |number, node, image| {
        assert!(image::load_from_memory(&image).is_ok());
        seen.push((number, node.id));
        ControlFlow::Continue(())
    });
    read.unwrap();
    seen
}

#[test]
fn every_schema_from_17_to_23_is_read_alike() {
    for version in ["0.17.0", "0.17.6", "0.18.0", "0.18.3", "0.19.3", "0.20.0", "0.21.4", "0.22.1", "0.23.0"]
    {
        let folder = Folder::new();
        let minor = version.split('.').nth(1).unwrap().parse().unwrap();
        let map = RtabMap::open(&written(&folder, version, &drive(minor))).unwrap();
        assert_eq!((map.version(), map.sessions().len()), (version, 2));
        assert_eq!(images(&map, 1, 0), [(1, 5), (2, 6), (3, 7), (4, 8)]);
        assert_eq!(images(&map, 0, 3), [(4, 4)]);
        let session = &map.sessions()[1];
        assert_eq!((session.map_id, session.nodes[0].stamp_ns), (1, 1_005_000_000_000));
        let pose = session.nodes[1].pose.unwrap();
        assert!(
            (pose.position_m[0] - 6.0).abs() < 1e-6 && (pose.orientation[2] - 0.05_f64.sin()).abs() < 1e-6
        );
        let camera = session.camera.clone().unwrap();
        let Lens::Pinhole(lens) = &camera.lens else { panic!("{camera:?}") };
        assert_eq!([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px], INTRINSICS);
        assert!((camera.base_to_camera.unwrap().position_m[2] - 0.3).abs() < 1e-6);
        let closures: Vec<_> =
            map.closures().iter().map(|found| (found.later, found.earlier, found.kind)).collect();
        assert_eq!(closures, [(6, 2, ClosureKind::Global), (8, 4, ClosureKind::Nearby)]);
        assert_eq!((map.link_counts().neighbors, map.link_counts().landmarks), (4, 1));
        assert_eq!((map.optimized().len(), map.optimized()[&8].position_m[1]), (8, 0.5));
        assert_eq!(map.contents().unused, [("depth images", 8)], "{version}");
    }
}

#[test]
fn nodes_that_are_no_frames_are_counted_by_their_reasons() {
    let folder = Folder::new();
    let mut drive = drive(21);
    drive.nodes[1].image = None;
    drive.nodes[2].image = Some(b"neither of them".to_vec());
    drive.nodes[3].stamp_s = 1000.5;
    drive.nodes[4].stamp_s = 0.0;
    drive.nodes[5].pose = [0.0; 12];
    drive.nodes[6].calibration = calibration(21, [60.0, 51.0, 4.0, 3.0], SIZE_PX);
    drive.nodes[7].calibration =
        [drive.nodes[7].calibration.clone(), drive.nodes[7].calibration.clone()].concat();
    drive.nodes[0].scan = Some(vec![1; 30]);
    let map = RtabMap::open(&written(&folder, "0.21.1", &drive)).unwrap();
    let omitted: Vec<(Omitted, u64)> =
        map.contents().omitted.iter().map(|(reason, count)| (*reason, *count)).collect();
    let expected =
        [Omitted::NoImage, Omitted::Format, Omitted::SeveralCameras, Omitted::NoStamp, Omitted::NotRising];
    assert_eq!(omitted, expected.map(|reason| (reason, 1)));
    assert_eq!((map.contents().nodes, map.contents().frames, map.contents().without_pose), (8, 3, 1));
    assert_eq!(images(&map, 1, 0), [(2, 6), (3, 7)]);
    assert_eq!(map.sessions()[1].other_calibrations, 1);
    assert_eq!(map.contents().unused, [("depth images", 8), ("laser scans", 1)]);
}

#[test]
fn calibrations_that_are_missing_or_of_other_images_are_said_and_the_rest_is_read() {
    let folder = Folder::new();
    let mut drive = drive(21);
    drive.nodes[0].calibration = Vec::new();
    drive.nodes[4].calibration = calibration(21, INTRINSICS, (64, 64));
    let map = RtabMap::open(&written(&folder, "0.21.1", &drive)).unwrap();
    let cameras: Vec<_> = map.sessions().iter().map(|session| session.camera.clone()).collect();
    let size = NoCamera::Size { calibrated_px: (64, 64), image_px: SIZE_PX };
    assert_eq!(cameras, [Err(NoCamera::Missing), Err(size)]);
}

#[test]
fn what_is_no_database_of_a_drive_is_refused_with_what_helps() {
    let folder = Folder::new();
    let told = |path: &Path| refused(path).to_string();
    let none = told(&folder.path().join("none.db"));
    assert!(none.contains("cannot read") && none.contains("No such file"), "{none}");
    let text = told(&folder.file("text.db", b"# no database, and longer than sixteen bytes"));
    assert!(text.contains("is no database") && text.contains("~/.ros/rtabmap.db"), "{text}");
    for (table, helps) in
        [("topics(id); CREATE TABLE messages(id)", "waypost stream"), ("maps(id)", "that RTAB-Map wrote")]
    {
        let path = folder.path().join(format!("{}.db", helps.len()));
        Connection::open(&path).unwrap().execute_batch(&format!("CREATE TABLE {table}")).unwrap();
        let other = told(&path);
        assert!(other.contains("database of another program") && other.contains(helps), "{other}");
    }
}

#[test]
fn other_schemas_are_refused_with_what_helps() {
    for (version, helps) in [("0.16.2", "rtabmap-reprocess OLD.db"), ("0.24.0", "--Db/TargetVersion 0.22")] {
        let folder = Folder::new();
        let told = refused(&written(&folder, version, &drive(23))).to_string();
        assert!(told.contains(version) && told.contains("0.17 to 0.23") && told.contains(helps), "{told}");
    }
}

#[test]
fn databases_without_anything_to_recognise_are_refused() {
    let folder = Folder::new();
    let none = refused(&written(&folder, "0.21.1", &Drive::default()));
    assert!(matches!(none, RtabError::NoNodes(_)), "{none}");
    let folder = Folder::new();
    let mut drive = drive(21);
    drive.nodes.iter_mut().for_each(|node| node.image = None);
    let told = refused(&written(&folder, "0.21.1", &drive)).to_string();
    assert!(told.contains("8 nodes and not one image") && told.contains("Mem/BinDataKept"), "{told}");
}

#[test]
fn what_is_cut_off_or_damaged_is_refused_whole() {
    let folder = Folder::new();
    let path = written(&folder, "0.21.1", &drive(21));
    let whole = std::fs::read(&path).unwrap();
    for kept in [whole.len() - 1, whole.len() / 2, 40, 20] {
        let told = refused(&folder.file("cut.db", &whole[..kept])).to_string();
        assert!(told.contains("cut off") && told.contains("Copy it anew"), "{kept}: {told}");
    }
    let mut poses = drive(21);
    poses.optimized.pop();
    let folder = Folder::new();
    let path = written(&folder, "0.21.1", &poses);
    Connection::open(&path)
        .unwrap()
        .execute_batch("UPDATE Admin SET opt_ids = substr(opt_ids, 1, 9)")
        .unwrap();
    let told = refused(&path).to_string();
    assert!(told.contains("damaged") && told.contains("rtabmap-recovery"), "{told}");
}

#[test]
fn a_database_that_changes_is_not_read_on() {
    let folder = Folder::new();
    let path = written(&folder, "0.21.1", &drive(21));
    let map = RtabMap::open(&path).unwrap();
    Connection::open(&path).unwrap().execute_batch("UPDATE Data SET image = NULL WHERE id = 2").unwrap();
    let read = map.read_images(&map.sessions()[0], 0, &mut |_, _, _| ControlFlow::Continue(()));
    assert!(matches!(read, Err(RtabError::Changed { .. })));
}

fn sample(name: &str) -> Option<PathBuf> {
    let beside_the_repository = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
    let data = std::env::var_os("WAYPOST_DATA").map_or_else(beside_the_repository, PathBuf::from);
    let path = data.join("imports/rtabmap").join(name);
    if path.is_file() {
        return Some(path);
    }
    eprintln!("skipped: there is no {}", path.display());
    None
}

#[test]
fn real_databases_are_read() {
    for (name, version, image_px, fx_px, unused) in [
        ("v0.17.3_1node.db", "0.17.3", (640, 480), 554.382_7, "laser scans"),
        ("v0.21.1_1node_310words.db", "0.21.1", (1280, 720), 639.254_5, "visual words"),
    ] {
        let Some(path) = sample(name) else { return };
        let map = RtabMap::open(&path).unwrap();
        assert_eq!((map.version(), map.contents().frames, map.optimized().len()), (version, 1, 1));
        let [session] = map.sessions() else { panic!("{map:?}") };
        assert_eq!(session.nodes[0].image, Ok(image_px));
        assert!(session.nodes[0].pose.is_some());
        let camera = session.camera.clone().unwrap();
        let Lens::Pinhole(lens) = &camera.lens else { panic!("{camera:?}") };
        assert!((lens.fx_px - fx_px).abs() < 1e-3 && lens.distortion.is_empty(), "{lens:?}");
        // Both look ahead.
        assert!(camera.base_to_camera.unwrap().orientation[3].abs() > 0.999, "{camera:?}");
        assert_eq!(images(&map, 0, 0), [(1, 1)]);
        assert!(map.contents().unused.iter().any(|(what, count)| *what == unused && *count > 0));
    }
}

#[test]
fn real_databases_without_a_drive_are_refused() {
    for name in ["v0.19.3_empty.db", "v0.22.1_empty.db"] {
        let Some(path) = sample(name) else { return };
        assert!(matches!(refused(&path), RtabError::NoNodes(_)));
    }
}

static DATABASES: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let of = |version: &str, minor| {
        let folder = Folder::new();
        std::fs::read(written(&folder, version, &drive(minor))).unwrap()
    };
    vec![of("0.17.0", 17), of("0.23.0", 23)]
});

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// Whatever is in a file, it is read or refused.
    #[test]
    fn databases_with_other_bytes_are_read_or_refused(
        which in 0_usize..2,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let mut file = DATABASES[which].clone();
        let size = file.len();
        for (place, byte) in changes {
            file[place.index(size)] = byte;
        }
        let folder = Folder::new();
        if let Ok(map) = RtabMap::open(&folder.file("rtabmap.db", &file)) {
            let mut bytes = 0;
            for session in map.sessions() {
                let read = map.read_images(session, 0, &mut |_, _, image| {
                    bytes += image.len();
                    ControlFlow::Continue(())
                });
                prop_assert!(read.is_ok());
            }
            prop_assert!(bytes <= size, "{bytes} bytes of images out of {size}");
        }
    }
}
