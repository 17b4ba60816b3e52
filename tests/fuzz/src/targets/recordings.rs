//! What ROS robots send and record.

use std::ops::ControlFlow;
use std::sync::LazyLock;

use waypost_bags::{Bag, Kind, Pose, Wanted, live};

use crate::Fed;

/// By the first byte of an input: what kind of file the rest is.
const NAMES: [&str; 5] = ["drive.mcap", "drive.bag", "drive.db3", "drive.mcap.zstd", "drive.db3.zstd"];

/// Images of a bag may be as large as this for each byte of it: three readings of what is there, decompressed.
const MOST_IMAGE_BYTES_A_BYTE: usize = 1000;

/// A bag, with its kind in front.
pub(super) fn bag(bytes: &[u8]) -> Fed {
    static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| tempfile::tempdir().unwrap());
    let Some((kind, bytes)) = bytes.split_first() else { return Fed::Refused };
    let path = FOLDER.path().join(NAMES[usize::from(*kind) % NAMES.len()]);
    std::fs::write(&path, bytes).unwrap();
    let Ok(bag) = Bag::open(&path, &mut |_, _| {}) else { return Fed::Refused };
    let mut images = 0;
    for odometry_topic in [None, Some("/odom".to_owned())] {
        let Ok(choice) = bag.choose(&Wanted { odometry_topic, ..Wanted::default() }) else { continue };
        let read = bag.read_frames(&choice, 0, &mut |_, _| {}, &mut |frame| {
            images += frame.image.len();
            ControlFlow::Continue(())
        });
        read.expect("a bag that did not change is read again as it was read before");
    }
    assert!(images <= MOST_IMAGE_BYTES_A_BYTE * (bytes.len() + 1000), "{images} out of {}", bytes.len());
    Fed::Taken
}

pub(super) fn is_finite_pose(pose: &Pose) -> bool {
    pose.position_m.into_iter().chain(pose.orientation).all(f64::is_finite)
}

/// A message over DDS, with its kind in front.
pub(super) fn ros_message(bytes: &[u8]) -> Fed {
    let Some((kind, data)) = bytes.split_first() else { return Fed::Refused };
    let taken = match kind % 7 {
        0 => live::image(Kind::CompressedImage, data).is_ok(),
        1 => live::image(Kind::Image, data).is_ok(),
        2 => live::camera_info(data).is_ok_and(|info| {
            info.declared_on("/camera/image_raw").is_ok() | info.declared_on("/camera/image_rect").is_ok()
        }),
        3 => live::pose(Kind::Odometry, data).is_ok_and(|stamped| is_finite(&stamped)),
        4 => live::pose(Kind::PoseStamped, data).is_ok_and(|stamped| is_finite(&stamped)),
        5 => {
            let mut mountings = live::Mountings::default();
            let added = mountings.add(data).is_ok();
            drop(mountings.camera_in("base_link", "camera_optical"));
            added
        }
        _ => live::text(data).is_ok(),
    };
    if taken { Fed::Taken } else { Fed::Refused }
}

fn is_finite(stamped: &live::LivePose) -> bool {
    assert!(is_finite_pose(&stamped.pose), "{stamped:?}");
    true
}
