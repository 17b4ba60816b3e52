//! A building that is seen all around, and a map of what is seen.

use std::sync::Arc;

use waypost_client::{Client, FrameContent, FrameInput, SessionOptions, v1};
use waypost_sim::camera::Panorama;
use waypost_sim::drive::panorama_rig;
use waypost_sim::light::Light;
use waypost_sim::pose::Pose;
use waypost_sim::render::{CameraRig, Shot};
use waypost_sim::scene::Scene;
use waypost_sim::worlds::NamedWorld;

use super::{answers_of, map_request, session_options};

/// Columns and rows of its panoramas.
pub(crate) use waypost_sim::drive::PANORAMA_SIZE_PX as PANORAMA_PX;

/// The paper's office, and a robot's panoramic camera in it.
pub(crate) struct Panoramas {
    pub(crate) scene: Arc<Scene>,
    pub(crate) rig: CameraRig,
}

/// A place that was taught, and where its panorama was really taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TaughtPlace {
    pub(crate) place: u32,
    pub(crate) pose: Pose,
}

impl Panoramas {
    pub(crate) fn new() -> Self {
        Self {
            scene: Arc::new(Scene::new(NamedWorld::BooijOffice.plan(1))),
            rig: panorama_rig(Panorama::Cylindrical),
        }
    }

    /// What a robot declares.
    pub(crate) fn camera(&self) -> v1::Camera {
        let (width_px, height_px) = PANORAMA_PX;
        let up = std::f64::consts::PI * f64::from(height_px) / f64::from(width_px);
        let projection = v1::panorama::Projection::Cylindrical.into();
        v1::Camera {
            model: Some(v1::camera::Model::Panorama(v1::Panorama {
                projection,
                vertical_rad: Some(2.0 * up.atan()),
            })),
            image_width_px: Some(width_px),
            image_height_px: Some(height_px),
            base_to_camera: None,
        }
    }

    /// What is seen from a pose, nobody about.
    pub(crate) fn taken_at(&self, pose: Pose, seed: u64) -> Vec<u8> {
        self.image(&Shot { pose, speed: [0.0; 2], people: Vec::new(), light: Light::default(), seed })
    }

    pub(crate) fn image(&self, shot: &Shot) -> Vec<u8> {
        self.scene.render(&self.rig, shot).to_jpeg().unwrap()
    }

    /// Teaches a map that is navigated by appearance by a panorama every half metre along lines, without odometry.
    pub(crate) async fn teach(
        &self,
        client: &Client,
        (map, model): (&str, &str),
        lines: &[&[[f64; 2]]],
    ) -> Vec<TaughtPlace> {
        client.create_map(by_looks_request(map, model)).await.unwrap();
        let poses = taught_at(lines);
        let frames = (1..).zip(&poses).map(|(sequence, &pose)| FrameInput {
            sequence,
            stamp_ns: 1_000_000_000 * sequence as i64,
            content: FrameContent::Image(self.taken_at(pose, sequence)),
            odometry: None,
            note: String::new(),
        });
        let frames: Vec<FrameInput> = frames.collect();
        let options = SessionOptions { camera: Some(self.camera()), ..session_options(map, "teacher") };
        let answers = answers_of(client, options, frames).await;
        let mut taught: Vec<TaughtPlace> = Vec::new();
        for (answer, pose) in answers.iter().zip(poses) {
            // The place's image is that of the frame which made it.
            if let Some(place) = answer.place_number.filter(|place| *place as usize == taught.len()) {
                taught.push(TaughtPlace { place, pose });
            }
        }
        taught
    }
}

/// A map `looks` that is navigated by appearance, of a few places in one hall.
pub(crate) async fn taught_hall(client: &Client, model: &str) -> Vec<TaughtPlace> {
    Panoramas::new().teach(client, ("looks", model), &[&[[9.2, 2.0], [9.2, 5.0]]]).await
}

/// A map that is navigated by appearance.
pub(crate) fn by_looks_request(map: &str, model: &str) -> v1::CreateMapRequest {
    let settings = v1::MapSettings {
        navigation_strategy: v1::map_settings::NavigationStrategy::Appearance.into(),
        ..v1::MapSettings::default()
    };
    v1::CreateMapRequest { settings: Some(settings), ..map_request(map, model) }
}

/// Where panoramas are taken to teach lines.
pub(crate) fn taught_at(lines: &[&[[f64; 2]]]) -> Vec<Pose> {
    lines.iter().flat_map(|line| along(line)).collect()
}

/// A pose every half metre along a line, looking along it.
fn along(corners: &[[f64; 2]]) -> Vec<Pose> {
    const SPACING_M: f64 = 0.5;
    let mut poses = Vec::new();
    for pair in corners.windows(2) {
        let ([x, y], [x_way, y_way]) = (pair[0], [0, 1].map(|axis| pair[1][axis] - pair[0][axis]));
        let steps = (x_way.hypot(y_way) / SPACING_M).round().max(1.0);
        for step in 0..steps as u32 {
            let share = f64::from(step) / steps;
            poses.push(Pose::new(x + share * x_way, y + share * y_way, y_way.atan2(x_way)));
        }
    }
    poses
}
