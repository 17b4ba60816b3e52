//! A recording on the disk.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
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
    /// Opens a folder with poses of a robot whose x axis is ahead, z up: `odometry_tum.txt`, or else
    /// `groundtruth_tum.txt`, which are poses of a camera.
    pub(super) fn of_robot(folder: &Path) -> Result<Self> {
        let of_wheels = "odometry_tum.txt";
        if folder.join(of_wheels).exists() {
            return Self::open(folder, of_wheels);
        }
        let of_camera = Self::open(folder, "groundtruth_tum.txt")?;
        let robots = |stamped: &StampedPose| StampedPose { pose: of_robot(stamped), ..*stamped };
        Ok(Self { poses: of_camera.poses.iter().map(robots).collect(), ..of_camera })
    }

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

/// The pose of a robot whose x axis is where its camera looks, z up.
pub(super) fn of_robot(stamped: &StampedPose) -> Isometry3<f64> {
    let optical_in_robot = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(optical_in_robot));
    let turn = Isometry3::from_parts(Translation3::identity(), turn);
    turn * stamped.pose * turn.inverse()
}
