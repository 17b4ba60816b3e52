//! Random bytes, and bags with some bytes changed: whatever they hold, they are read or refused.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::LazyLock;

use proptest::prelude::*;
use waypost_bags::{Bag, Wanted};

use crate::writing::mcap_file::mcap;
use crate::writing::messages::Order;
use crate::writing::ros1_file::{Chunks, ros1_bag};
use crate::writing::sqlite_file::{Stored, sqlite};
use crate::writing::{Folder, drive};

/// Valid bags by the names of files.
static BAGS: LazyLock<Vec<(&str, Vec<u8>)>> = LazyLock::new(|| {
    let folder = Folder::new();
    sqlite(&folder.path().join("drive.db3"), &drive(), Stored::Zstd);
    vec![
        ("drive.mcap", mcap(&drive(), None, Order::Little)),
        ("drive.mcap", mcap(&drive(), None, Order::Big)),
        ("drive.mcap", mcap(&drive(), Some(mcap::Compression::Zstd), Order::Little)),
        ("drive.mcap", mcap(&drive(), Some(mcap::Compression::Lz4), Order::Little)),
        ("drive.bag", ros1_bag(&drive(), Chunks::None)),
        ("drive.bag", ros1_bag(&drive(), Chunks::Bz2)),
        ("drive.bag", ros1_bag(&drive(), Chunks::Lz4)),
        ("drive.db3", std::fs::read(folder.path().join("drive.db3")).unwrap()),
    ]
});

/// Reads all that can be read; a panic fails the test. Returns how many bytes of images came out.
fn read(path: &Path) -> usize {
    let Ok(bag) = Bag::open(path, &mut |_, _| {}) else { return 0 };
    let wanted = [None, Some("/odom".to_owned()), Some("/tf_static".to_owned())];
    let mut bytes = 0;
    for odometry_topic in wanted {
        let Ok(choice) = bag.choose(&Wanted { odometry_topic, ..Wanted::default() }) else { continue };
        let read = bag.read_frames(&choice, 0, &mut |_, _| {}, &mut |frame| {
            bytes += frame.image.len();
            ControlFlow::Continue(())
        });
        // A bag that did not change is read again as it was read before.
        read.unwrap();
    }
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn bags_with_other_bytes_are_read_or_refused(
        which in 0_usize..8,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        kept in any::<prop::sample::Index>(),
        is_cut in any::<bool>(),
    ) {
        let (name, mut file) = BAGS[which].clone();
        let size = file.len();
        for (place, byte) in changes {
            file[place.index(size)] = byte;
        }
        if is_cut {
            file.truncate(kept.index(size));
        }
        let bytes = read(&Folder::new().file(name, &file));
        // Three readings of what is there, decompressed.
        prop_assert!(bytes < 100 * size, "{bytes} bytes of images out of {size}");
    }

    #[test]
    fn noise_is_refused(
        name in prop::sample::select(vec!["drive.mcap", "drive.bag", "drive.db3", "drive.mcap.zstd", "drive.db3.zstd"]),
        noise in prop::collection::vec(any::<u8>(), 0..2000),
    ) {
        let folder = Folder::new();
        prop_assert_eq!(read(&folder.file(name, &noise)), 0);
        let head = if name == "drive.bag" { b"#ROSBAG V2.0\n".as_slice() } else { b"\x89MCAP0\r\n" };
        prop_assert_eq!(read(&folder.file(name, &[head, &noise].concat())), 0);
    }
}
