//! What the robots of a soak see, made before it begins.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use rayon::prelude::*;
use waypost_client::{FrameContent, FrameInput, v1};
use waypost_sim::drive::{Building, SPEED_M_S, WHEN_MOVED};
use waypost_sim::render::Mount;
use waypost_sim::robot::{OdometryReading, WheelErrors};
use waypost_sim::simulation::CameraFrame;
use waypost_sim::worlds::NamedWorld;

use crate::commands::appearance::eye::Acuity;
use crate::commands::load::{contents, panoramas};
use crate::files;

/// Images of the drive: once around the building, and a piece on.
const WORLD: NamedWorld = NamedWorld::Loop;
const ROUTE: &str = "once";

/// Panoramas, all over a small building, in metres apart.
const PANORAMAS: usize = 24;
const PANORAMAS_APART_M: f64 = 0.8;

const SECOND_NS: i64 = 1_000_000_000;

/// Frames of all kinds.
#[derive(Debug)]
pub(super) struct Material {
    pub(super) building: Arc<Building>,
    /// Of the simulated robot ahead.
    pub(super) camera: v1::Camera,
    /// Images with odometry.
    pub(super) drive: Vec<FrameInput>,
    pub(super) panoramic_camera: v1::Camera,
    pub(super) panoramas: Vec<FrameInput>,
    /// Words alone, of what the model was trained on.
    pub(super) words: Vec<FrameInput>,
    pub(super) words_hash: String,
}

impl Material {
    pub(super) fn new(model_file: &Path, seed: u64) -> Result<Self> {
        let (model, _extractor) = files::read_model(model_file)?;
        let contents = model.sampling_set().iter().map(contents::histogram);
        let words: Vec<FrameInput> = numbered(contents);
        ensure!(!words.is_empty(), "{}: the model remembers no training image", model_file.display());
        let route = WORLD.route(ROUTE).context("the simulated building has lost its route")?;
        let building = Building::named(WORLD, seed, &route)?;
        let recording = building
            .robot(WheelErrors::drawn(seed), seed, WHEN_MOVED)?
            .drive_along(&building.route, SPEED_M_S)?;
        let frames: Vec<&CameraFrame> = recording.frames().collect();
        let drive = frames.into_par_iter().map(|frame| seen(&building, frame)).collect::<Result<_>>()?;
        let (panoramas, panoramic_camera) =
            panoramas::images((NamedWorld::Foyer, seed), Acuity::Coarse, (PANORAMAS, PANORAMAS_APART_M))?;
        Ok(Self {
            camera: camera(&building),
            building: Arc::new(building),
            drive,
            panoramic_camera,
            panoramas: numbered(panoramas.into_iter().map(FrameContent::Image)),
            words,
            words_hash: model.words_hash().to_string(),
        })
    }
}

/// Frames without odometry, a second apart.
fn numbered(contents: impl Iterator<Item = FrameContent>) -> Vec<FrameInput> {
    let frame = |(sequence, content)| FrameInput::new(sequence, SECOND_NS * sequence as i64, content);
    (1..).zip(contents).map(frame).collect()
}

/// What a robot sends of an image that it takes; stamps begin above 0.
pub(super) fn seen(building: &Building, frame: &CameraFrame) -> Result<FrameInput> {
    let image = building.image(&frame.shot).to_jpeg()?;
    let input = FrameInput::new(frame.number + 1, frame.stamp_ns + 1, FrameContent::Image(image));
    Ok(FrameInput { odometry: Some(odometry(&frame.odometry)), ..input })
}

/// What the wheels say.
pub(super) fn odometry(reading: &OdometryReading) -> v1::Odometry {
    let (position_m, orientation) = reading.position_and_orientation();
    let pose = Some(pose(position_m, orientation));
    v1::Odometry { pose, covariance: reading.covariance_6x6().to_vec() }
}

fn pose([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> v1::Pose {
    v1::Pose {
        position_m: Some(v1::Vector3 { x, y, z }),
        orientation: Some(v1::Quaternion { x: i, y: j, z: k, w }),
    }
}

fn camera(building: &Building) -> v1::Camera {
    let Mount { forward_m, height_m, yaw_rad } = *building.rig.mount();
    let camera = building.rig.camera();
    let (sin, cos) = (yaw_rad / 2.0).sin_cos();
    let field_of_view = v1::FieldOfView { horizontal_rad: camera.field_of_view_rad() };
    v1::Camera {
        model: Some(v1::camera::Model::FieldOfView(field_of_view)),
        image_width_px: Some(camera.width_px()),
        image_height_px: Some(camera.height_px()),
        base_to_camera: Some(pose([forward_m, 0.0, height_m], [0.0, 0.0, sin, cos])),
    }
}
