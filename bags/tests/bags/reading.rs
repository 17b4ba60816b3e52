//! Every kind of bag gives the same frames.

use std::ops::ControlFlow;
use std::path::Path;

use waypost_bags::{Bag, Choice, Clock, Frame, Joined, Lens, Wanted};

use crate::writing::mcap_file::mcap;
use crate::writing::messages::{Order, pose_stamped, raw_image};
use crate::writing::ros1_file::{Chunks, ros1_bag};
use crate::writing::sqlite_file::{Stored, sqlite};
use crate::writing::{Folder, Message, drive, png};

pub fn open(path: &Path) -> Bag {
    Bag::open(path, &mut |_, _| {}).unwrap_or_else(|error| panic!("{error}"))
}

pub fn frames(bag: &Bag, choice: &Choice, after: u64) -> Vec<Frame> {
    joined(bag, choice, after).0
}

pub fn joined(bag: &Bag, choice: &Choice, after: u64) -> (Vec<Frame>, Joined) {
    let mut frames = Vec::new();
    let joined = bag.read_frames(choice, after, &mut |_, _| {}, &mut |frame| {
        frames.push(frame);
        ControlFlow::Continue(())
    });
    let joined = joined.unwrap();
    if choice.odometry.is_some() {
        assert_eq!(joined.with_pose + joined.without_pose.all(), frames.len() as u64);
    }
    (frames, joined)
}

/// What [`drive`] holds, whatever it was written as.
fn check_drive(path: &Path) {
    let bag = open(path);
    let counts: Vec<(&str, u64)> =
        bag.topics().iter().map(|topic| (topic.name.as_str(), topic.count)).collect();
    let expected =
        [("/camera/camera_info", 1), ("/camera/image/compressed", 4), ("/odom", 8), ("/tf_static", 1)];
    assert_eq!(counts, expected, "{}", path.display());
    let images = &bag.topics()[1];
    assert!((images.rate_hz().unwrap() - 10.0).abs() < 1e-9);
    assert_eq!((images.form.as_deref(), images.size_px), (Some("png"), Some((8, 6))));
    let choice = bag.choose(&Wanted::default()).unwrap();
    assert_eq!((choice.frame_count(), choice.notes.as_slice()), (4, [].as_slice()));
    let camera = choice.camera.as_ref().unwrap();
    assert!(matches!(&camera.lens, Lens::Pinhole(lens) if lens.distortion.len() == 5), "{camera:?}");
    let mount = camera.base_to_camera.unwrap();
    assert!(
        (mount.position_m[0] - 0.2).abs() < 1e-12 && (mount.orientation[3] - 1.0).abs() < 1e-12,
        "{mount:?}"
    );
    let frames = frames(&bag, &choice, 0);
    for (frame, tick) in frames.iter().zip([0_u8, 2, 4, 6]) {
        assert_eq!(frame.image, png(tick));
        assert_eq!(frame.stamp_ns, 1_000_000_000 + i64::from(tick) * 50_000_000);
        // Odometry is half a tick before: between this tick's and the next.
        let x_m = frame.pose.unwrap().position_m[0];
        assert!((x_m - (f64::from(tick) + 0.5)).abs() < 1e-9, "{x_m} at {tick}");
    }
    assert_eq!(frames.len(), 4);
}

#[test]
fn mcap_is_read_whatever_its_compression_and_byte_order() {
    let folder = Folder::new();
    for compression in [None, Some(mcap::Compression::Lz4), Some(mcap::Compression::Zstd)] {
        for order in [Order::Little, Order::Big] {
            check_drive(&folder.file("drive.mcap", &mcap(&drive(), compression, order)));
        }
    }
    let whole = zstd::encode_all(mcap(&drive(), None, Order::Little).as_slice(), 3).unwrap();
    check_drive(&folder.file("drive.mcap.zstd", &whole));
}

#[test]
fn ros1_bags_are_read_without_their_index() {
    let folder = Folder::new();
    for chunks in [Chunks::None, Chunks::Bz2, Chunks::Lz4] {
        check_drive(&folder.file("drive.bag", &ros1_bag(&drive(), chunks)));
    }
}

#[test]
fn databases_are_read_plain_and_compressed_by_message_or_file() {
    let folder = Folder::new();
    for (name, stored) in [("plain.db3", Stored::Plain), ("by_message.db3", Stored::Zstd)] {
        sqlite(&folder.path().join(name), &drive(), stored);
        check_drive(&folder.path().join(name));
    }
    let plain = std::fs::read(folder.path().join("plain.db3")).unwrap();
    check_drive(&folder.file("by_file.db3.zstd", &zstd::encode_all(plain.as_slice(), 3).unwrap()));
}

#[test]
fn a_folder_is_read_by_its_metadata_or_by_its_names() {
    let folder = Folder::new();
    let (first, second) = (drive()[..7].to_vec(), drive()[7..].to_vec());
    // The later half has the name that sorts first.
    folder.file("b.mcap", &mcap(&first, None, Order::Little));
    folder.file("a.mcap", &mcap(&second, None, Order::Little));
    let metadata = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  \
                    relative_file_paths:\n    - b.mcap\n    - a.mcap\n  compression_mode: \"\"\n";
    folder.file("metadata.yaml", metadata.as_bytes());
    assert!(Bag::is_bag(folder.path()));
    check_drive(folder.path());
    let by_names = Folder::new();
    by_names.file("drive_0.mcap", &mcap(&first, None, Order::Little));
    by_names.file("drive_1.mcap", &mcap(&second, None, Order::Little));
    check_drive(by_names.path());
}

#[test]
fn reading_goes_on_where_it_stopped() {
    let folder = Folder::new();
    let bag = open(&folder.file("drive.mcap", &mcap(&drive(), None, Order::Little)));
    let choice = bag.choose(&Wanted::default()).unwrap();
    let all = frames(&bag, &choice, 0);
    assert_eq!(frames(&bag, &choice, 2), all[2..]);
    assert_eq!(frames(&bag, &choice, 4), []);
    let mut first = Vec::new();
    let stop = &mut |frame| {
        first.push(frame);
        ControlFlow::Break(())
    };
    bag.read_frames(&choice, 0, &mut |_, _| {}, stop).unwrap();
    assert_eq!(first, all[..1]);
}

#[test]
fn raw_images_and_poses_by_name_are_used() {
    let raw = |tick: u64| Message {
        topic: "/front/image_raw",
        type_name: "sensor_msgs/Image",
        log_ns: 100 + tick,
        fields: raw_image(100 + tick, "bgr8", (2, 1), 6, &[3, 2, 1, 6, 5, 4]),
    };
    let pose = |tick: u64| Message {
        topic: "/pose",
        type_name: "geometry_msgs/PoseStamped",
        log_ns: 100 + tick,
        fields: pose_stamped(100 + tick, tick as f64),
    };
    let folder = Folder::new();
    let messages = [raw(0), pose(0), raw(1), pose(1)];
    let bag = open(&folder.file("drive.mcap", &mcap(&messages, None, Order::Big)));
    let wanted = Wanted { odometry_topic: Some("/pose".to_owned()), ..Wanted::default() };
    let frames = frames(&bag, &bag.choose(&wanted).unwrap(), 0);
    assert_eq!(frames.len(), 2);
    for (tick, frame) in frames.iter().enumerate() {
        let pixels = image::load_from_memory(&frame.image).unwrap().into_rgb8().into_raw();
        assert_eq!(pixels, [1, 2, 3, 4, 5, 6]);
        assert_eq!(frame.pose.unwrap().position_m[0].to_bits(), (tick as f64).to_bits());
    }
}

#[test]
fn times_of_recording_count_where_they_are_asked_for() {
    let folder = Folder::new();
    let bag = open(&folder.file("drive.mcap", &mcap(&drive(), None, Order::Little)));
    let choice = bag.choose(&Wanted { clock: Clock::Log, ..Wanted::default() }).unwrap();
    let stamps: Vec<i64> = frames(&bag, &choice, 0).iter().map(|frame| frame.stamp_ns).collect();
    assert_eq!(stamps, [1_000_000_001, 1_100_000_001, 1_200_000_001, 1_300_000_001]);
}
