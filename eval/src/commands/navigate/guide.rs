//! What a server does for a robot that it leads, in process.

use std::sync::Arc;

use anyhow::{Context, Result};
use fabmap::appearance::PlaceId;
use fabmap::model::Model;
use posegraph::{PlanarPose, Pose as _};
use topomap::in_memory;
use topomap::mapper::{FrameInput, Localizer};
use topomap::metric::Odometry;
use waypost_navigation::metric::planning::plan;
use waypost_navigation::metric::{
    Goal, Guidance, Look, Lookout, MapPosition, NavigationSettings, Navigator, PlanError, Seen, WheelReport,
};
use waypost_vision::GreyImage;
use waypost_vision::features::Extractor;
use waypost_vision::structure::{RobotCamera, Tracker};
use waypost_vision::verification::Verifier;

use super::teaching::Taught;
use crate::commands::map::drive::robot_camera;
use crate::error::refused;
use crate::observing::{CurrentView, Observed};
use crate::timing::FrameWatch;

/// Map and navigator.
pub(super) struct Guide<'a> {
    taught: &'a Taught,
    model: &'a Model,
    extractor: Extractor,
    verifier: Verifier,
    tracker: Tracker,
    camera: RobotCamera,
    lookout: Lookout,
    navigator: Navigator,
    settings: NavigationSettings,
    looks: u64,
    /// Length of the first plan, in metres.
    pub(super) planned_m: Option<f64>,
}

impl<'a> Guide<'a> {
    pub(super) fn new(
        taught: &'a Taught,
        (model, extractor): (&'a Model, Extractor),
        settings: NavigationSettings,
        facing_rad: Option<f64>,
    ) -> Result<Self> {
        let verifier = Verifier::new(taught.mapped.mapper.settings().verification, 0);
        let mut navigator = Navigator::new(settings).map_err(refused)?;
        let goal = Goal::Place(taught.goal);
        match (facing_rad, taught.mapped.mapper.poses().pose(taught.goal)) {
            (Some(facing_rad), Some(pose)) => {
                navigator.go_to_facing(goal, pose.heading_rad() + facing_rad)?;
            }
            (Some(_) | None, Some(_) | None) => navigator.go_to(goal),
        }
        let lookout = Lookout::new();
        let camera = robot_camera(&taught.building.rig);
        let tracker = Tracker::new(taught.mapped.mapper.settings().odometry_noise);
        Ok(Self {
            taught,
            model,
            extractor,
            verifier,
            tracker,
            camera,
            lookout,
            navigator,
            settings,
            looks: 0,
            planned_m: None,
        })
    }

    /// A frame has come in.
    pub(super) fn see(
        &mut self,
        stamp_ns: i64,
        odometry: Odometry,
        image: &GreyImage,
    ) -> Result<(Look, Seen)> {
        let mut watch = FrameWatch::start();
        let observed = Observed::in_image(image, self.model, self.extractor, &mut watch)?;
        let mapped = &self.taught.mapped;
        let features = Arc::new(observed.features);
        let features = self.tracker.track(features, Some(&self.camera), Some(&odometry));
        let views = CurrentView {
            current: &features,
            log: &mapped.log,
            earlier: &mapped.features,
            verifier: self.verifier,
            camera: Some(self.camera),
        };
        let input = FrameInput {
            session: Localizer::SESSION,
            sequence: self.looks,
            stamp_ns,
            odometry: Some(odometry),
            observation: observed.observation,
        };
        let frame = || format!("frame {}", self.looks);
        let episode = self.navigator.episode();
        let recognized =
            self.lookout.recognize(&mapped.mapper, episode, input, &mut ()).with_context(frame)?;
        let (proposed, comparisons) = in_memory::compared(recognized, &mapped.log.0, &views);
        let decided = proposed.decide(&comparisons).with_context(frame)?;
        let settings = &self.settings.localization;
        let focal_length_widths = comparisons.focal_length_widths;
        let look = self.lookout.look(&mapped.mapper, settings, episode, &decided, focal_length_widths);
        self.looks += 1;
        let seen = self.navigator.see(&look);
        self.plan()?;
        Ok((look, seen))
    }

    /// Odometry has come in.
    pub(super) fn drive(&mut self, report: &WheelReport) -> Result<Guidance> {
        let guidance = self.navigator.drive(report);
        self.plan()?;
        Ok(guidance)
    }

    /// Where the robot is believed to be, in the frame of the place that is believed to be nearest.
    pub(super) fn believed(&self) -> Option<(PlaceId, PlanarPose)> {
        let MapPosition { part, pose } = self.navigator.localization()?.at;
        let poses = self.taught.mapped.mapper.poses();
        let of_part = PlaceId::all().zip(poses.poses()).filter(|&(place, _)| poses.part(place) == Some(part));
        let apart = of_part.map(|(place, origin)| (place, origin.inverse().compose(&pose)));
        apart.min_by(|(_, a), (_, b)| a.x_m().hypot(a.y_m()).total_cmp(&b.x_m().hypot(b.y_m())))
    }

    fn plan(&mut self) -> Result<()> {
        let Some(wanted) = self.navigator.wanted_route() else { return Ok(()) };
        let mapper = &self.taught.mapped.mapper;
        match plan(mapper.map(), mapper.poses(), &wanted.from, wanted.goal, &self.settings.planning) {
            Ok(route) => {
                self.planned_m.get_or_insert(route.length_m);
                self.navigator.follow(&route);
            }
            // The robot believes to be where no way begins: it stands there until the trial's time is over.
            Err(PlanError::TooFar { .. } | PlanError::OneWay { .. } | PlanError::OtherPart { .. }) => {
                self.navigator.cancel();
            }
            Err(
                reason @ (PlanError::UnknownPlace { .. }
                | PlanError::UnknownPart { .. }
                | PlanError::NoMetres
                | PlanError::Unmeasured { .. }
                | PlanError::GoalTooFar { .. }
                | PlanError::NotFinite),
            ) => return Err(reason.into()),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use fabmap::descriptor::Descriptors;
    use topomap::evidence::{ClosureNoise, VerificationSettings, ViewMotion};
    use waypost_sim::light::Light;
    use waypost_sim::pose::Pose;
    use waypost_sim::render::Shot;
    use waypost_sim::scene::Scene;
    use waypost_sim::worlds::NamedWorld;
    use waypost_vision::feature_record::FeatureRecord;
    use waypost_vision::verification::View;

    use super::*;
    use crate::commands::map::drive::grey;
    use crate::commands::map::training::MapTraining;
    use waypost_sim::drive::{IMAGE_SIZE_PX, camera_rig};

    /// What is seen from a pose, as features without words.
    fn features(scene: &Scene, pose: Pose) -> FeatureRecord {
        let shot = Shot { pose, speed: [0.0; 2], people: Vec::new(), light: Light::default(), seed: 1 };
        let image = grey(&scene.render(&camera_rig(), &shot)).unwrap();
        let features = Extractor::new(MapTraining::default().features).extract(&image).unwrap();
        let descriptors: Descriptors = features.descriptors;
        let words = vec![fabmap::WordId::default(); features.keypoints.len()];
        FeatureRecord::new(IMAGE_SIZE_PX, features.keypoints, words, Some(descriptors)).unwrap()
    }

    /// The shift of the image gives the turn, and its sign: both ways, by two angles; within a seventh, since a turn stretches
    /// the image as well. What is nearer is larger.
    #[test]
    fn a_robot_that_has_turned_left_is_seen_to_have_turned_left() {
        let scene = Scene::new(NamedWorld::Loop.plan(1));
        let (verifier, noise) =
            (Verifier::new(VerificationSettings::default(), 0), ClosureNoise::of_spacing(0.5));
        let camera = robot_camera(&camera_rig());
        let focal_length_widths = Some(camera.pinhole.focal_length_widths(IMAGE_SIZE_PX.0));
        let before = Pose::new(4.0, 1.0, 0.0);
        let earlier = features(&scene, before);
        let compared = |pose: Pose| {
            let current = features(&scene, pose);
            let view = |features| View { features, camera: Some(camera) };
            verifier.compare(view(&earlier), view(&current))
        };
        for degrees in [-8.0, -4.73, 4.73, 8.0_f64] {
            let view = compared(Pose { heading_rad: degrees * PI / 180.0, ..before });
            let measured =
                noise.measure(&view, focal_length_widths).unwrap().pose().heading_rad().to_degrees();
            assert!((measured - degrees).abs() < 0.15 * degrees.abs(), "{measured}, not {degrees} degrees");
        }
        let Some(ViewMotion::Similarity(ahead)) = compared(Pose { x_m: 4.4, ..before }).motion else {
            panic!("no motion")
        };
        assert!(ahead.ln_scale > 0.02, "{ahead:?}");
    }
}
