//! What a server does for a robot that it leads, in process.

use fabmap::model::Model;
use topomap::mapper::{FrameInput, Localizer};
use topomap::navigation::planning::plan;
use topomap::navigation::{
    Goal, Guidance, Look, Lookout, NavigationSettings, Navigator, PlanError, Seen, WheelReport,
};
use topomap::odometry::Odometry;
use waypost_sim::render::Shot;
use waypost_vision::features::Extractor;
use waypost_vision::verification::{Pinhole, Verifier};

use super::teaching::Taught;
use crate::commands::map::MapError;
use crate::commands::map::drive::{FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX, camera_rig, image_of};
use crate::commands::map::mapping::{CurrentView, observe};
use crate::error::EvalError;
use crate::timing::FrameWatch;

/// Map and navigator.
pub(super) struct Guide<'a> {
    taught: &'a Taught,
    model: &'a Model,
    extractor: Extractor,
    verifier: Verifier,
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
    ) -> Result<Self, EvalError> {
        let verifier = Verifier::new(taught.mapped.mapper.settings().verification, 0);
        let mut navigator = Navigator::new(settings)?;
        navigator.go_to(Goal::Place(taught.goal));
        let (lookout, looks, planned_m) = (Lookout::new(), 0, None);
        Ok(Self { taught, model, extractor, verifier, lookout, navigator, settings, looks, planned_m })
    }

    /// A frame has come in.
    pub(super) fn see(
        &mut self,
        stamp_ns: i64,
        odometry: Odometry,
        shot: &Shot,
    ) -> Result<(Look, Seen), EvalError> {
        let image = image_of(&self.taught.drive.scene, &camera_rig()?, shot)?;
        let mut watch = FrameWatch::start();
        let (observation, current) = observe(&image, self.model, self.extractor, &mut watch)?;
        let mapped = &self.taught.mapped;
        let views = CurrentView {
            current: &current,
            log: &mapped.log,
            earlier: &mapped.features,
            verifier: self.verifier,
            camera: Pinhole::of_field_of_view(FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX),
        };
        let (session, sequence) = (Localizer::SESSION, self.looks);
        let input = FrameInput { session, sequence, stamp_ns, odometry: Some(odometry), observation };
        let episode = (self.navigator.episode(), &self.settings.localization);
        let look = self
            .lookout
            .look(&mapped.mapper, episode, input, (&mapped.log, &views), &mut ())
            .map_err(|reason| EvalError::Frame { index: sequence as usize, reason })?;
        self.looks += 1;
        let seen = self.navigator.see(&look);
        self.plan()?;
        Ok((look, seen))
    }

    /// Odometry has come in.
    pub(super) fn drive(&mut self, report: &WheelReport, now_ns: i64) -> Result<Guidance, EvalError> {
        let guidance = self.navigator.drive(report, now_ns);
        self.plan()?;
        Ok(guidance)
    }

    fn plan(&mut self) -> Result<(), EvalError> {
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
            Err(reason @ (PlanError::UnknownPlace { .. } | PlanError::NotFinite)) => {
                return Err(reason.into());
            }
        }
        Ok(())
    }
}

/// The odometry as a robot sends it.
pub(super) fn sent(reading: &waypost_sim::robot::OdometryReading) -> Result<Odometry, MapError> {
    let (position_m, orientation) = reading.position_and_orientation();
    Odometry::new(position_m, orientation, Some(&reading.covariance_6x6())).map_err(MapError::Odometry)
}
