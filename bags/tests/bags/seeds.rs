//! What the fuzzer begins with: see `tests/fuzz`.

use std::path::PathBuf;

use crate::writing::mcap_file::mcap;
use crate::writing::messages::{
    Fields, Order, camera_info, cdr, compressed_image, odometry, pose_stamped, raw_image, transforms,
};
use crate::writing::ros1_file::{Chunks, ros1_bag};
use crate::writing::sqlite_file::{Stored, sqlite};
use crate::writing::{Folder, drive, png};

fn keep(target: &str, name: &str, kind: u8, content: &[u8]) {
    let root: PathBuf =
        [env!("CARGO_MANIFEST_DIR"), "..", "tests", "fuzz", "corpus", target].iter().collect();
    std::fs::create_dir_all(&root).unwrap();
    std::fs::write(root.join(format!("taken-{name}")), [&[kind], content].concat()).unwrap();
}

/// Kinds are numbered as the targets `bag` and `ros_message` have them.
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
