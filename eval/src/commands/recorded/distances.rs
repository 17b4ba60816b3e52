//! How far apart two frames are measured to be, by features that got their depths on the way to the first.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use fabmap::observation::WordId;
use nalgebra::Isometry3;
use posegraph::{PlanarPose, Pose};
use rayon::prelude::*;
use serde::Serialize;
use topomap::evidence::{Placement, VerificationSettings};
use topomap::metric::{Odometry, OdometryNoise};
use topomap::settings::MapperSettings;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{Extractor, FeatureSettings, Features};
use waypost_vision::structure::{RobotCamera, Tracker};
use waypost_vision::verification::{Pinhole, Verifier, View};

use super::recording::{Recording, of_robot};
use crate::commands::map::closures::CHI_SQUARED_95;
use crate::error::fault;
use crate::files;
use crate::timing::quantile;

/// Frames that are mapped before one is measured from the last of them.
const MAPPED_FRAMES: usize = 10;

/// How far apart pairs are that are measured, in metres.
const APART_M: std::ops::RangeInclusive<f64> = 2.0..=8.0;

/// What came out.
#[derive(Serialize)]
pub(crate) struct DistancesReport {
    /// Features of the frames.
    pub features: String,
    /// Pairs of frames of that distance.
    pub pairs: usize,
    /// Those of them that were measured, by as many features as a closure needs.
    pub measured: usize,
    /// |measured / true - 1| of the distance, median and 95 %.
    pub distance_error_share: [f64; 2],
    /// Between the directions to the later frame, in degrees, median and 95 %.
    pub direction_error_deg: [f64; 2],
    /// Of the heading, in degrees, median and 95 %.
    pub heading_error_deg: [f64; 2],
    /// Share of those whose truth lies within what they call 95 % likely.
    pub within_own_95: f64,
}

/// A pair that was measured.
#[derive(Clone, Copy)]
struct Measured {
    distance_error_share: f64,
    direction_error_deg: f64,
    heading_error_deg: f64,
    is_within_own_95: bool,
}

pub(super) fn run(
    folders: &[PathBuf],
    calibration: &Path,
    features: FeatureSettings,
) -> Result<DistancesReport> {
    let camera = RobotCamera::ahead(pinhole(calibration)?);
    let mut pairs = 0;
    let mut measured = Vec::new();
    for folder in folders {
        let recording = Recording::open(folder, "groundtruth_tum.txt")?;
        let seen = seen(&recording, Extractor::new(features))?;
        let poses: Vec<Isometry3<f64>> = recording.poses.iter().map(of_robot).collect();
        for (mapped, _) in poses.iter().enumerate().skip(MAPPED_FRAMES - 1) {
            let first = mapped + 1 - MAPPED_FRAMES;
            let place = tracked(&seen[first..=mapped], &poses[first..=mapped], &camera)?;
            for later in mapped + 1..poses.len() {
                let truth = poses[mapped].inverse() * poses[later];
                if !APART_M.contains(&truth.translation.vector.norm()) {
                    continue;
                }
                pairs += 1;
                measured.extend(measure(&place, &seen[later], camera, &truth));
            }
        }
    }
    ensure!(pairs > 0, "no two frames are 2 to 8 m apart; give a recording of a camera that moves");
    Ok(DistancesReport::of(features, pairs, &measured))
}

/// The first camera of a calibration file: the first row of twelve numbers, a 3 x 4 matrix.
fn pinhole(path: &Path) -> Result<Pinhole> {
    let text = String::from_utf8_lossy(&files::read(path)?).into_owned();
    let numbers: Vec<f64> = text
        .lines()
        .next()
        .unwrap_or_default()
        .split_whitespace()
        .filter_map(|word| word.parse().ok())
        .collect();
    let &[fx, _, cx, _, _, fy, cy, ..] = numbers.as_slice() else {
        anyhow::bail!(
            "{} line 1 is no projection; write 12 numbers, the rows of a 3 x 4 matrix",
            path.display()
        );
    };
    Ok(Pinhole::ideal([fx, fy], [cx, cy]))
}

/// The features of all images.
fn seen(recording: &Recording, extractor: Extractor) -> Result<Vec<Arc<FeatureRecord>>> {
    let record = |path: &PathBuf| -> Result<Arc<FeatureRecord>> {
        let (image, features) = extractor.extract_encoded(&files::read(path)?)?;
        let Features { keypoints, descriptors } = features;
        let words = vec![WordId::new(0); keypoints.len()];
        let size_px = (image.width(), image.height());
        let record = FeatureRecord::new(size_px, keypoints, words, Some(descriptors));
        Ok(Arc::new(record.map_err(fault)?))
    };
    let records = recording.images.par_iter();
    records.map(|path| record(path).with_context(|| path.display().to_string())).collect()
}

/// The last of some frames, with the depths that the way gave it.
fn tracked(
    seen: &[Arc<FeatureRecord>],
    poses: &[Isometry3<f64>],
    camera: &RobotCamera,
) -> Result<Arc<FeatureRecord>> {
    let mut tracker = Tracker::new(OdometryNoise::default());
    let mut last = seen[0].clone();
    for (features, pose) in seen.iter().zip(poses) {
        let [i, j, k, w] = pose.rotation.coords.into();
        let odometry = Odometry::new(pose.translation.vector.into(), [i, j, k, w], None)?;
        last = tracker.track(features.clone(), Some(camera), Some(&odometry));
    }
    Ok(last)
}

/// How far off the later frame is measured from the mapped one; `None` if that is not measured, or
/// by fewer features than a closure needs.
fn measure(
    place: &FeatureRecord,
    later: &FeatureRecord,
    camera: RobotCamera,
    truth: &Isometry3<f64>,
) -> Option<Measured> {
    let verifier = Verifier::new(MapperSettings::default().verification, 0);
    let view = |features| View { features, camera: Some(camera) };
    let Placement::At { pose, inliers } = verifier.compare(view(place), view(later)).placement else {
        return None;
    };
    if inliers < VerificationSettings::MIN_PLACED_INLIERS {
        return None;
    }
    let true_heading_rad = truth.rotation.euler_angles().2;
    let true_pose = PlanarPose::new(truth.translation.vector.x, truth.translation.vector.y, true_heading_rad);
    let off = PlanarPose::error(pose.pose(), &PlanarPose::identity(), &true_pose);
    let [x_m, y_m] = [pose.pose().x_m(), pose.pose().y_m()];
    let apart_m = x_m.hypot(y_m);
    let true_m = true_pose.x_m().hypot(true_pose.y_m());
    let cosine = (x_m * true_pose.x_m() + y_m * true_pose.y_m()) / (apart_m * true_m);
    Some(Measured {
        distance_error_share: (apart_m / true_m - 1.0).abs(),
        direction_error_deg: cosine.clamp(-1.0, 1.0).acos().to_degrees(),
        heading_error_deg: off.z.abs().to_degrees(),
        is_within_own_95: off.dot(&(pose.information() * off)) <= CHI_SQUARED_95,
    })
}

impl DistancesReport {
    fn of(features: FeatureSettings, pairs: usize, measured: &[Measured]) -> Self {
        let spread = |error: fn(&Measured) -> f64| {
            let errors: Vec<f64> = measured.iter().map(error).collect();
            [0.5, 0.95].map(|share| quantile(errors.clone(), share).unwrap_or(f64::NAN))
        };
        let within = measured.iter().filter(|measured| measured.is_within_own_95).count();
        Self {
            features: features.to_string(),
            pairs,
            measured: measured.len(),
            distance_error_share: spread(|measured| measured.distance_error_share),
            direction_error_deg: spread(|measured| measured.direction_error_deg),
            heading_error_deg: spread(|measured| measured.heading_error_deg),
            within_own_95: within as f64 / measured.len().max(1) as f64,
        }
    }
}
