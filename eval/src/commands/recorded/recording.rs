//! A recording on the disk.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posegraph::trajectory::{StampedPose, from_tum};

use crate::dataset::image_files;
use crate::files;

/// Images and a pose for each.
pub(super) struct Recording {
    /// Name of its folder.
    pub(super) name: String,
    pub(super) images: Vec<PathBuf>,
    pub(super) poses: Vec<StampedPose>,
}

impl Recording {
    /// Opens a folder with `images/` and a trajectory that has one pose an image, in their order.
    pub(super) fn open(folder: &Path, trajectory: &str) -> Result<Self> {
        let images = image_files(folder)?;
        let path = folder.join(trajectory);
        let poses = from_tum(&files::read(&path)?).with_context(|| path.display().to_string())?;
        ensure!(
            images.len() == poses.len(),
            "{} has {} poses for {} images; write one line for each image, in their order",
            path.display(),
            poses.len(),
            images.len()
        );
        let name = folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        Ok(Self { name, images, poses })
    }
}
