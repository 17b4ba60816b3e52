//! A simulated robot with wheels and a camera ahead: where it drives, what it sends, and where it truly was.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex};

use posegraph::trajectory::StampedPose;
use posegraph::{PlanarPose, Pose as _};
use waypost_client::v1::export_poses_request::{Body, Format, Frame};
use waypost_client::{Client, FrameContent, FrameInput, v1};
use waypost_sim::drive::{Building, FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX, SPEED_M_S, WHEN_MOVED};
use waypost_sim::render::{Mount, Shot};
use waypost_sim::robot::{OdometryReading, WheelErrors};
use waypost_sim::scene::Scene;
use waypost_sim::simulation::{CameraFrame, Recording};
use waypost_sim::worlds::NamedWorld;

use super::in_words;

/// Buildings that were painted, and what was seen in them: many tests drive the same ways.
static SCENES: LazyLock<Mutex<Scenes>> = LazyLock::new(Mutex::default);
static IMAGES: LazyLock<Mutex<Images>> = LazyLock::new(Mutex::default);

/// By building, and its seed.
type Scenes = HashMap<(NamedWorld, u64), Arc<Scene>>;

/// PNGs by building, its seed and how the shot is written, in which is all that an image depends on beside the building.
type Images = HashMap<(NamedWorld, u64, String), Vec<u8>>;

/// A way through a building.
pub(crate) fn building(world: NamedWorld, seed: u64, route: &str) -> Building {
    let paint = || Arc::new(Scene::new(world.plan(seed)));
    let scene = SCENES.lock().unwrap().entry((world, seed)).or_insert_with(paint).clone();
    let building = Building::new(scene, &world.route(route).unwrap()).unwrap();
    Building { rig: world.camera_rig(), ..building }
}

/// The way, driven with an image every 50 cm or 10 degrees.
pub(crate) fn driven(building: &Building, wheels: WheelErrors, seed: u64) -> Recording {
    let mut robot = building.robot(wheels, seed, WHEN_MOVED).unwrap();
    robot.drive_along(&building.route, SPEED_M_S).unwrap()
}

/// A drive along a building's way.
pub(crate) struct Drive {
    world: NamedWorld,
    seed: u64,
    building: Building,
    pub(crate) frames: Vec<CameraFrame>,
}

impl Drive {
    /// `seed` is that of the building and of the robot's noise.
    pub(crate) fn new(world: NamedWorld, seed: u64, route: &str, wheels: WheelErrors) -> Self {
        let building = building(world, seed, route);
        let frames = driven(&building, wheels, seed).frames().cloned().collect();
        Self { world, seed, building, frames }
    }

    /// What the robot sends.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = FrameInput> + '_ {
        self.inputs_of(&self.frames)
    }

    /// What a robot sends that makes its words itself: cheaper for tests, which see the same drives again and again.
    pub(crate) fn words(&self) -> impl Iterator<Item = FrameInput> + '_ {
        self.inputs().map(in_words)
    }

    /// What it sends of some frames of the drive, whole images.
    pub(crate) fn inputs_of<'a>(
        &'a self,
        frames: &'a [CameraFrame],
    ) -> impl Iterator<Item = FrameInput> + 'a {
        frames.iter().map(|frame| frame_input(frame, self.image(&frame.shot)))
    }

    fn image(&self, shot: &Shot) -> Vec<u8> {
        let seen = (self.world, self.seed, format!("{shot:?}"));
        if let Some(image) = IMAGES.lock().unwrap().get(&seen) {
            return image.clone();
        }
        let image = self.building.image(shot).to_png().unwrap();
        IMAGES.lock().unwrap().insert(seen, image.clone());
        image
    }

    /// What its session declares of the camera.
    pub(crate) fn camera(&self) -> v1::Camera {
        let rig = &self.building.rig;
        let Mount { forward_m, height_m, yaw_rad } = *rig.mount();
        let horizontal_rad = rig.camera().field_of_view_rad();
        let base_to_camera = v1::Pose {
            position_m: Some(v1::Vector3 { x: forward_m, y: 0.0, z: height_m }),
            orientation: Some(v1::Quaternion {
                x: 0.0,
                y: 0.0,
                z: (yaw_rad / 2.0).sin(),
                w: (yaw_rad / 2.0).cos(),
            }),
        };
        let field_of_view = v1::FieldOfView { horizontal_rad };
        let model = Some(v1::camera::Model::FieldOfView(field_of_view));
        v1::Camera { model, base_to_camera: Some(base_to_camera), ..camera_ahead() }
    }

    /// The true pose at a frame, in the frame of the first.
    pub(crate) fn truth(&self, frame: usize) -> PlanarPose {
        let at = |frame: usize| {
            let pose = &self.frames[frame].shot.pose;
            PlanarPose::new(pose.x_m, pose.y_m, pose.heading_rad)
        };
        at(0).inverse().compose(&at(frame))
    }

    /// The true poses of all frames.
    pub(crate) fn true_poses(&self) -> Vec<StampedPose> {
        let stamped = |frame: usize| StampedPose {
            stamp_ns: self.frames[frame].stamp_ns + 1,
            pose: self.truth(frame).on_the_ground(),
        };
        (0..self.frames.len()).map(stamped).collect()
    }

    /// Root mean square of how far poses are from the truth.
    pub(crate) fn rmse_m(&self, poses: &[StampedPose]) -> f64 {
        let squares = poses.iter().map(|stamped| {
            let frame = self.frames.iter().position(|frame| frame.stamp_ns + 1 == stamped.stamp_ns).unwrap();
            let (truth, position) = (self.truth(frame), stamped.pose.translation.vector);
            (truth.x_m() - position.x).powi(2) + (truth.y_m() - position.y).powi(2)
        });
        (squares.sum::<f64>() / poses.len() as f64).sqrt()
    }
}

/// What a session declares of the camera; nothing of where it is mounted.
pub(crate) fn camera_ahead() -> v1::Camera {
    v1::Camera {
        model: Some(v1::camera::Model::FieldOfView(v1::FieldOfView { horizontal_rad: FIELD_OF_VIEW_RAD })),
        image_width_px: Some(IMAGE_SIZE_PX.0),
        image_height_px: Some(IMAGE_SIZE_PX.1),
        base_to_camera: None,
    }
}

/// A frame as it goes to the server; stamps begin above 0.
pub(crate) fn frame_input(frame: &CameraFrame, image: Vec<u8>) -> FrameInput {
    FrameInput {
        sequence: frame.number + 1,
        stamp_ns: frame.stamp_ns + 1,
        content: FrameContent::Image(image),
        odometry: Some(odometry(&frame.odometry)),
        note: String::new(),
    }
}

/// What the wheels say.
pub(crate) fn odometry(reading: &OdometryReading) -> v1::Odometry {
    let ([x, y, z], [i, j, k, w]) = reading.position_and_orientation();
    v1::Odometry {
        pose: Some(v1::Pose {
            position_m: Some(v1::Vector3 { x, y, z }),
            orientation: Some(v1::Quaternion { x: i, y: j, z: k, w }),
        }),
        covariance: reading.covariance_6x6().to_vec(),
    }
}

/// A pose on the ground.
pub(crate) fn planar(pose: &v1::Pose) -> PlanarPose {
    let (position, orientation) = (pose.position_m.unwrap(), pose.orientation.unwrap());
    PlanarPose::new(position.x, position.y, 2.0 * orientation.z.atan2(orientation.w))
}

/// The file of a session's poses, or of a map's graph.
pub(crate) async fn exported(
    client: &Client,
    name: &str,
    format: Format,
    frame: Frame,
    body: Body,
) -> Vec<u8> {
    let request = v1::ExportPosesRequest {
        name: name.to_owned(),
        format: format.into(),
        frame: frame.into(),
        body: body.into(),
        every: 0,
    };
    let mut text = Vec::new();
    client.export_poses(request, &mut text).await.unwrap();
    text
}
