//! What robots that are led along the map ask of it; it stays as it is.

use topomap::navigation::planning::{self, Goal, MapPosition, PlanError, Route};
use topomap::navigation::settings::PlanningSettings;
use topomap::navigation::{Look, Lookout};

use super::requests::{LookRequest, PlanFrom};
use super::views::{CurrentView, SeenFeatures, steering_verifier};
use super::{Archive, MapWriter};
use crate::error::ServiceError;

impl MapWriter {
    pub(super) fn look(&self, request: LookRequest) -> Result<(Lookout, Look), ServiceError> {
        let LookRequest { mut lookout, episode, settings, input, features, intrinsics } = request;
        let current = features.map(|features| SeenFeatures::new(features, Some(&intrinsics)));
        let verifier = steering_verifier(self.mapper.settings());
        let (archive, views) =
            (Archive { writer: self }, CurrentView { writer: self, current, verifier: &verifier });
        let look = lookout.look(&self.mapper, (episode, &settings), input, (&archive, &views), &mut ())?;
        Ok((lookout, look))
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
