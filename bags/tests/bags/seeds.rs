//! What the fuzzer begins with: see `tests/fuzz`.

use std::path::PathBuf;

use rusqlite::Connection;

use crate::rtabmap::{INTRINSICS, SIZE_PX, drive as rtab_drive};
use crate::writing::mcap_file::mcap;
use crate::writing::messages::{
    Fields, Order, camera_info, cdr, compressed_image, odometry, pose_stamped, raw_image, transforms,
};
use crate::writing::ros1_file::{Chunks, ros1_bag};
use crate::writing::rtabmap_file::{calibration, on_the_floor, packed, rtabmap};
use crate::writing::sqlite_file::{Stored, sqlite};
use crate::writing::{Folder, drive, png};

fn keep(target: &str, name: &str, kind: u8, content: &[u8]) {
    let root: PathBuf =
        [env!("CARGO_MANIFEST_DIR"), "..", "tests", "fuzz", "corpus", target].iter().collect();
    std::fs::create_dir_all(&root).unwrap();
    std::fs::write(root.join(format!("taken-{name}")), [&[kind], content].concat()).unwrap();
}

/// Kinds are numbered as the targets `bag`, `ros_message` and `rtabmap` have them.
#[test]
#[ignore = "writes the seeds for the fuzzer"]
fn keep_seeds() {
    let mut drive = drive();
    // Without the last half: small is fast.
    drive.truncate(drive.len() / 2);
    let folder = Folder::new();
    let path = folder.path().join("drive.db3");
    sqlite(&path, &drive, Stored::Plain);
    keep("bag", "plain.mcap", 0, &mcap(&drive, None, Order::Little));
    keep("bag", "big-endian.mcap", 0, &mcap(&drive, None, Order::Big));
    keep("bag", "zstd.mcap", 0, &mcap(&drive, Some(mcap::Compression::Zstd), Order::Little));
    keep("bag", "lz4.mcap", 0, &mcap(&drive, Some(mcap::Compression::Lz4), Order::Little));
    keep("bag", "plain.bag", 1, &ros1_bag(&drive, Chunks::None));
    keep("bag", "bz2.bag", 1, &ros1_bag(&drive, Chunks::Bz2));
    keep("bag", "lz4.bag", 1, &ros1_bag(&drive, Chunks::Lz4));
    keep("bag", "plain.db3", 2, &std::fs::read(path).unwrap());

    let stamp_ns = 1_000_000_000;
    let message = |name, kind, fields: Fields| keep("ros_message", name, kind, &cdr(&fields, Order::Little));
    message("compressed", 0, compressed_image(stamp_ns, "png", &png(7)));
    message("raw-rgb", 1, raw_image(stamp_ns, "rgb8", (4, 3), 12, &[7; 36]));
    message("raw-grey", 1, raw_image(stamp_ns, "mono8", (4, 3), 4, &[7; 12]));
    message("raw-bayer", 1, raw_image(stamp_ns, "bayer_rggb8", (4, 4), 4, &[7; 16]));
    message("info", 2, camera_info(stamp_ns, (8, 6), "plumb_bob", &[0.1, 0.0, 0.0, 0.0, 0.0]));
    message("info-fisheye", 2, camera_info(stamp_ns, (8, 6), "equidistant", &[0.1, 0.0, 0.0, 0.0]));
    message("odometry", 3, odometry(stamp_ns, "base_link", 1.0));
    message("pose", 4, pose_stamped(stamp_ns, 1.0));
    let mounted = [
        ("base_link", "camera", [0.2, 0.0, 0.3], [0.0, 0.0, 0.0, 1.0]),
        ("camera", "camera_optical", [0.0; 3], [-0.5, 0.5, -0.5, 0.5]),
    ];
    message("transforms", 5, transforms(&mounted));
    keep("ros_message", "text", 6, &[0, 1, 0, 0, 2, 0, 0, 0, b'a', 0]);
    let big = cdr(&odometry(stamp_ns, "base_link", 1.0), Order::Big);
    keep("ros_message", "odometry-big-endian", 3, &big);
}

/// Kinds as above.
#[test]
#[ignore = "writes the seeds for the fuzzer"]
fn keep_seeds_of_rtabmap() {
    let folder = Folder::new();
    for version in ["0.17.0", "0.23.0"] {
        let path = folder.path().join(version);
        let minor = version.split('.').nth(1).unwrap().parse().unwrap();
        rtabmap(&path, version, &rtab_drive(minor));
        // Small is fast.
        Connection::open(&path).unwrap().execute_batch("PRAGMA page_size = 512; VACUUM").unwrap();
        let name = if minor == 17 { "old.db" } else { "plain.db" };
        keep("rtabmap", name, 0, &std::fs::read(path).unwrap());
        keep("rtabmap", &format!("calibration-{minor}"), 1, &calibration(minor, INTRINSICS, SIZE_PX));
    }
    let ids: Vec<u8> = (1..=8).flat_map(i32::to_le_bytes).collect();
    keep("rtabmap", "ids", 2, &packed(&ids, 8, 4));
    let rows = (1..=8).flat_map(|id| on_the_floor(id as f32, 0.5, 0.0));
    let poses: Vec<u8> = rows.flat_map(f32::to_le_bytes).collect();
    keep("rtabmap", "poses", 3, &packed(&poses, 96, 5));
    keep("rtabmap", "image", 4, &png(9));
    let pose: Vec<u8> = on_the_floor(2.0, 1.0, 0.1).iter().flat_map(|value| value.to_le_bytes()).collect();
    keep("rtabmap", "pose", 5, &pose);
}
