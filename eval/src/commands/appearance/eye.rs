//! What the robot sees: panoramas of a simulated building, as rays with descriptors.

use std::f64::consts::PI;
use std::sync::Arc;

use anyhow::Result;
use clap::ValueEnum;
use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use waypost_navigation::appearance::epipolar::SearchSettings;
use waypost_navigation::appearance::graph::AppearanceGraph;
use waypost_sim::camera::Camera;
use waypost_sim::floor_plan::FloorPlan;
use waypost_sim::light::Light;
use waypost_sim::pose::Pose;
use waypost_sim::render::{CameraRig, Mount, Sensor, Shot};
use waypost_sim::scene::Scene;
use waypost_vision::features::{Extractor, Feature, FeatureSettings};
use waypost_vision::image::GreyImage;
use waypost_vision::panorama::{self, PanoramicCamera, PanoramicView, Projection};

/// How fine a robot sees, up and down by 38 degrees.
#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Acuity {
    /// As one drives a hundred times: 512x128 with 300 features.
    Coarse,
    /// As one measures: 1024x256 with 500 features.
    Fine,
}

impl Acuity {
    /// Columns and rows.
    pub(crate) fn size_px(self) -> (u32, u32) {
        match self {
            Self::Coarse => (512, 128),
            Self::Fine => (1024, 256),
        }
    }

    /// Most features of a panorama.
    fn features(self) -> u32 {
        match self {
            Self::Coarse => 300,
            Self::Fine => 500,
        }
    }
}

/// Metres between a robot's middle and walls or furniture where images of a map are taken.
pub(crate) const CLEARANCE_M: f64 = 0.3;

/// A panoramic camera on a robot, and what is made of its images.
#[derive(Clone, Debug)]
pub(crate) struct Eye {
    /// The camera in the simulation.
    pub rig: CameraRig,
    /// How planar motion is searched.
    pub search: SearchSettings,
    extractor: Extractor,
    camera: PanoramicCamera,
}

impl Eye {
    /// RootSIFT on a cylindrical panorama.
    pub(crate) fn new(acuity: Acuity) -> Result<Self> {
        let size_px = acuity.size_px();
        let rig = CameraRig::new(Camera::cylindrical(size_px)?, Mount::default(), Sensor::default())?;
        let settings = FeatureSettings::new(Feature::RootSift, acuity.features(), size_px.0);
        Ok(Self {
            rig,
            search: SearchSettings::default(),
            extractor: Extractor::new(settings.unwrap_or_default()),
            camera: PanoramicCamera::new(Projection::Cylindrical, size_px)?,
        })
    }

    /// What is seen at a shot.
    pub(crate) fn see(&self, scene: &Scene, shot: &Shot) -> Result<PanoramicView> {
        let image = scene.render(&self.rig, shot);
        let image = GreyImage::new(image.width_px(), image.height_px(), image.pixels().to_vec())?;
        let features = panorama::extract(&self.extractor, &image)?;
        Ok(PanoramicView::new(&features, &self.camera))
    }

    /// What is seen from each of some poses, nobody about; `seed` is that of the noise.
    pub(crate) fn see_all(&self, scene: &Scene, poses: &[Pose], seed: u64) -> Result<Vec<PanoramicView>> {
        let shots =
            (0..).zip(poses).map(|(number, &pose)| still(pose, seed.wrapping_mul(1_000_003) + number));
        shots.collect::<Vec<Shot>>().into_par_iter().map(|shot| self.see(scene, &shot)).collect()
    }
}

/// A robot that stands still, nobody about.
pub(crate) fn still(pose: Pose, seed: u64) -> Shot {
    Shot { pose, speed: [0.0; 2], people: Vec::new(), light: Light::default(), seed }
}

/// A building with the images of its map.
#[derive(Debug)]
pub(crate) struct TaughtMap {
    /// The building.
    pub scene: Arc<Scene>,
    /// Where the images were taken.
    pub poses: Vec<Pose>,
    /// What they show.
    pub views: Vec<PanoramicView>,
    /// How they are linked, each having been compared with all others.
    pub graph: AppearanceGraph,
}

impl TaughtMap {
    /// Images all over a building, looking anywhere, about `spacing_m` apart.
    pub(crate) fn new(eye: &Eye, plan: FloorPlan, spacing_m: f64, seed: u64) -> Result<Self> {
        let poses = scattered(&plan, spacing_m, seed);
        Self::at(eye, plan, poses, seed)
    }

    /// Images from given poses.
    pub(crate) fn at(eye: &Eye, plan: FloorPlan, poses: Vec<Pose>, seed: u64) -> Result<Self> {
        let scene = Arc::new(Scene::new(plan));
        let views = eye.see_all(&scene, &poses, seed)?;
        let graph = compared_with_all(eye, &views);
        Ok(Self { scene, poses, views, graph })
    }

    /// The image that was taken nearest to a point.
    pub(crate) fn nearest(&self, point: Vector2<f64>) -> usize {
        let gap = |pose: &Pose| (pose.position() - point).norm();
        let nearest = self.poses.iter().enumerate().min_by(|(_, a), (_, b)| gap(a).total_cmp(&gap(b)));
        nearest.map_or(0, |(image, _)| image)
    }
}

/// The graph of views of which every one is compared with every other.
pub(crate) fn compared_with_all(eye: &Eye, views: &[PanoramicView]) -> AppearanceGraph {
    let rows: Vec<Vec<f64>> = (0..views.len())
        .into_par_iter()
        .map(|image| {
            let similarity = |other: &PanoramicView| {
                let overlap = views[image].compare(other, &eye.search).overlap;
                overlap.map_or(0.0, |overlap| overlap.similarity())
            };
            views[..image].iter().map(similarity).collect()
        })
        .collect();
    let mut graph = AppearanceGraph::default();
    for (image, row) in (0..).zip(rows) {
        graph.add_image();
        (0..).zip(row).for_each(|(other, similarity)| graph.link(image, other, similarity));
    }
    graph
}

/// Free places all over a plan that are at least `spacing_m` apart, until no more are found; headings anyhow.
pub(crate) fn scattered(plan: &FloorPlan, spacing_m: f64, seed: u64) -> Vec<Pose> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let [min, max] = plan.bounds();
    let size = max - min;
    let tries = (60.0 * size.x * size.y / (spacing_m * spacing_m)) as usize;
    let mut poses: Vec<Pose> = Vec::new();
    for _ in 0..tries {
        let [x, y, turn] = [random.random::<f64>(), random.random(), random.random()];
        let point = min + Vector2::new(x * size.x, y * size.y);
        let is_apart = poses.iter().all(|pose| (pose.position() - point).norm() >= spacing_m);
        if is_apart && plan.clearance_m(point) >= CLEARANCE_M {
            poses.push(Pose::new(point.x, point.y, PI * (2.0 * turn - 1.0)));
        }
    }
    poses
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    /// What the simulation draws at a pixel is what the panorama takes it for.
    #[test]
    fn both_cameras_agree() {
        let size_px = (640, 160);
        let cylinder = (Camera::cylindrical(size_px).unwrap(), Projection::Cylindrical);
        let sphere = (Camera::equirectangular(size_px).unwrap(), Projection::Equirectangular);
        for (drawn, projection) in [cylinder, sphere] {
            let taken = PanoramicCamera::new(projection, size_px).unwrap();
            for number in 0..200_u32 {
                let [angle, height] = [0.1 * f64::from(number), f64::from(number % 13) * 0.2 - 1.2];
                let point = Vector3::new(2.0 * angle.cos(), 2.0 * angle.sin(), height);
                let at = drawn.project(&point).unwrap();
                assert!((taken.ray(at) - point.normalize()).norm() < 1e-9, "{projection:?} {point}");
            }
        }
    }
}
