//! The drive and the model that ship with the repository.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use waypost_client::{FrameContent, FrameInput};

/// Between frames: the stamps are made up.
pub(crate) const SECOND_NS: i64 = 1_000_000_000;

static IMAGES: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let folder = workspace().join("demo/sequence/images");
    let files = std::fs::read_dir(&folder).expect("the shipped drive").map(|file| file.unwrap().path());
    let mut files: Vec<PathBuf> =
        files.filter(|file| file.extension().is_some_and(|end| end == "jpg")).collect();
    files.sort();
    let images: Vec<Vec<u8>> = files.iter().map(|file| std::fs::read(file).unwrap()).collect();
    assert!(images.len() >= 100, "{} holds {} images only", folder.display(), images.len());
    images
});

/// Root of the repository.
pub(crate) fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the package lies in the workspace")
}

/// The shipped model.
pub(crate) fn model_file() -> PathBuf {
    workspace().join("demo/model.waypost")
}

/// The images of the shipped drive, in order.
pub(crate) fn images() -> &'static [Vec<u8>] {
    &IMAGES
}

/// How many frames the drive has.
pub(crate) fn frame_count() -> u64 {
    images().len() as u64
}

/// The frame numbered `sequence`, from 1, of the shipped drive.
pub(crate) fn frame(sequence: u64) -> FrameInput {
    let image = images()[usize::try_from(sequence).unwrap() - 1].clone();
    let stamp_ns = SECOND_NS * i64::try_from(sequence).unwrap();
    FrameInput {
        sequence,
        stamp_ns,
        content: FrameContent::Image(image),
        odometry: None,
        note: String::new(),
    }
}

/// The first frame of the shipped drive that is at a place seen before, by its truth.
pub(crate) fn first_return() -> u64 {
    let truth = std::fs::read_to_string(workspace().join("demo/sequence/loops.csv")).unwrap();
    let queries = truth.lines().skip(1).map(|line| line.split(',').next().unwrap().parse::<u64>().unwrap());
    // Indices count from 0, sequence numbers from 1.
    queries.min().expect("the truth names loops") + 1
}
