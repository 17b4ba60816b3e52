//! `waypost-eval recorded`: real recordings with odometry, mapped as a robot would, and held against what odometry or
//! the true poses say.

mod distances;
mod heard;
mod recording;
mod walks;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde::Serialize;
use waypost_vision::features::{Feature, FeatureSettings};

use self::distances::DistancesReport;
use self::heard::HeardWheels;
use self::walks::WalksReport;
use crate::choices::features;
use crate::error::refused;

/// Map real recordings with odometry: folders with images/ and odometry_tum.txt (or groundtruth_tum.txt, poses of the
/// camera), a session each, into one map. With
/// --calibration, measure how far pairs of frames are apart in place of that.
#[derive(Args)]
pub(crate) struct RecordedOptions {
    /// The recordings, in the order in which they are mapped.
    #[arg(value_name = "DIR", required = true)]
    folders: Vec<PathBuf>,
    /// The model file.
    #[arg(long, value_name = "FILE", required_unless_present = "calibration")]
    model: Option<PathBuf>,
    /// Which frames of each recording are sent with odometry: all, none, first:N, from:N, without:A-B (A to B - 1), or
    /// frozen-from:N, where wheels say from frame N on that the robot stands. Judged is by the odometry of all.
    #[arg(long, value_name = "WHICH", default_value = "all", conflicts_with = "calibration")]
    odometry: HeardWheels,
    /// A calibration as KITTI writes it, of a camera that looks ahead. Ten frames in a row are mapped with their true
    /// poses (groundtruth_tum.txt, in the camera's axes: x right, y down, z ahead) for odometry, and frames 2 to 8 m
    /// on are measured from the last of them.
    #[arg(long, value_name = "FILE", conflicts_with = "model")]
    calibration: Option<PathBuf>,
    /// The local feature, with --calibration.
    #[arg(long, default_value = Feature::Orb.name(), value_parser = features(), requires = "calibration")]
    feature: Feature,
    /// Most features of an image, with --calibration.
    #[arg(long, value_name = "N", default_value_t = 500, requires = "calibration")]
    max_features: u32,
}

/// What came out.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum RecordedReport {
    Walks(WalksReport),
    Distances(DistancesReport),
}

/// Maps, or measures.
pub(crate) fn run(options: &RecordedOptions) -> Result<RecordedReport> {
    match (&options.calibration, &options.model) {
        (Some(calibration), _) => {
            let width = FeatureSettings::default().image_width();
            let features = FeatureSettings::new(options.feature, options.max_features, width);
            let features = features.map_err(refused)?;
            distances::run(&options.folders, calibration, features).map(RecordedReport::Distances)
        }
        (None, Some(model)) => {
            walks::run(&options.folders, model, options.odometry).map(RecordedReport::Walks)
        }
        (None, None) => Err(refused("give --model, or --calibration")),
    }
}
