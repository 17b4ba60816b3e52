//! What robots that are led along the map ask of it; it stays as it is.

use waypost_navigation::metric::planning::{self, Goal, MapPosition, PlanError, Route};
use waypost_navigation::metric::settings::PlanningSettings;

use super::MapWriter;
use super::requests::{LookRequest, Looked, PlanFrom};
use super::views::{SeenFeatures, compared, steering_verifier};
use crate::error::ServiceError;

impl MapWriter {
    pub(super) fn look(&self, request: LookRequest) -> Result<Looked, ServiceError> {
        let LookRequest { mut lookout, mut tracker, episode, settings, input, features, intrinsics } =
            request;
        let current = features.map(|features| {
            SeenFeatures::tracked(features, Some(&intrinsics), input.odometry.as_ref(), &mut tracker)
        });
        let verifier = steering_verifier(self.mapper.settings());
        let recognized = lookout.recognize(&self.mapper, episode, input, &mut ())?;
        let (proposed, comparisons) = compared(recognized, self, current.as_ref(), &verifier)?;
        let decided = proposed.decide(&comparisons)?;
        let focal_length_widths = comparisons.focal_length_widths;
        let look = lookout.look(&self.mapper, &settings, episode, &decided, focal_length_widths);
        Ok(Looked { lookout, tracker, look })
    }

    /// Whether there is such a goal, wherever the robot is.
    pub(super) fn check_goal(&self, goal: Goal, settings: &PlanningSettings) -> Result<(), PlanError> {
        planning::goal_place(self.mapper.poses(), goal, settings).map(drop)
    }

    pub(super) fn plan(
        &self,
        from: PlanFrom,
        goal: Goal,
        settings: &PlanningSettings,
    ) -> Result<Route, PlanError> {
        let poses = self.mapper.poses();
        let from = match from {
            PlanFrom::Robot(position) => position,
            PlanFrom::Place(place) => match (poses.part(place), poses.pose(place)) {
                (Some(part), Some(&pose)) => MapPosition { part, pose },
                (_, _) => return Err(PlanError::UnknownPlace { place }),
            },
        };
        planning::plan(self.mapper.map(), poses, &from, goal, settings)
    }
}
