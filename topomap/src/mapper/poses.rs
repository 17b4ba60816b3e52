//! Where the robot is in metres, and what that says for the next frame.

use fabmap::appearance::PlaceId;
use fabmap::place_filter::MotionPrior;

use super::frame::FrameInHand;
use super::link_prior::spread_over_links;
use super::odometry_prior::predict;
use super::state::Mapper;
use crate::evidence::{ClosureNoise, TwoView};
use crate::map::{Anchor, Session, Stay};
use crate::metric::{Odometry, RelativePose};
use crate::settings::MapperSettings;
use posegraph::{PlanarPose, Pose};

/// Where a robot is on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPose {
    /// The lowest place of the part of the map that it is in, in whose frame the poses are: 0 where
    /// that is the map's.
    pub part: PlaceId,
    /// base_link in the frame of the part.
    pub robot: PlanarPose,
    /// The session's odom frame in it: what turns odometry into poses on the map (REP-105).
    pub odom: PlanarPose,
}

/// Where in its place's frame the robot is, and who says so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Located {
    /// The place is created where the robot is.
    AtOrigin,
    /// The closure measured it.
    ByClosure(RelativePose),
    /// The closure says that it is there, and no more.
    Somewhere(RelativePose),
    /// Wheels have, since a place that the robot was at; that of the map's own poses is no new
    /// measurement.
    ByWheels(RelativePose),
}

impl Located {
    pub(super) fn at(&self) -> RelativePose {
        match self {
            Self::AtOrigin => RelativePose::none(),
            Self::ByClosure(at) | Self::Somewhere(at) | Self::ByWheels(at) => *at,
        }
    }
}

impl Mapper {
    /// Where a session's robot was at its last frame with odometry: by its wheels since the last
    /// one at a place.
    #[must_use]
    pub fn map_pose(&self, session: &Session) -> Option<MapPose> {
        let Stay { place, odometry, at, .. } = session.stay.as_ref()?;
        let there = self.poses().pose(*place)?.compose(at.as_ref()?.pose());
        let odometry = PlanarPose::seen_from_above(odometry.as_ref()?.pose());
        let odom = there.compose(&odometry.inverse());
        let (_, now) = session.last_odometry.as_ref()?;
        let robot = odom.compose(&PlanarPose::seen_from_above(now.pose()));
        Some(MapPose { part: self.poses().part(*place)?, robot, odom })
    }

    /// What is expected before the frame is looked at: by odometry where there is some, or else by
    /// links.
    pub(super) fn motion_prior(&self, session: &Session, odometry: Option<&Odometry>) -> MotionPrior {
        let believed = &session.belief.places;
        // Places that wheels have led to and from; none of a map that was made without odometry.
        let metric = believed.iter().any(|&(place, _)| self.poses().is_joined(place));
        let Some(now) = odometry.filter(|_| metric && !session.past.is_empty()) else {
            return spread_over_links(&session.belief, |place| self.map().linked(place));
        };
        let steps = session.past.iter().take(self.settings().prior_frames);
        let steps =
            steps.map(|past| (&past.belief, self.settings().odometry_noise.between(&past.odometry, now)));
        predict(steps, self.poses(), &self.settings().place_spacing)
    }

    /// The pose here in the frame of the place where the session last was.
    pub(super) fn driven_from(&self, stay: &Stay, odometry: Option<&Odometry>) -> Option<RelativePose> {
        let before = stay.odometry.as_ref()?;
        let now = odometry?;
        let at = stay.at.unwrap_or_else(RelativePose::none);
        let MapperSettings { odometry_noise, place_spacing, .. } = self.settings();
        Some(at.then(&odometry_noise.of_step(before, now, place_spacing)))
    }

    /// The pose here in the frame of the place where the session last surely was.
    pub(super) fn driven_from_anchor(
        &self,
        session: &Session,
        odometry: Option<&Odometry>,
    ) -> Option<(PlaceId, RelativePose)> {
        let Anchor { place, odometry: before, at } = session.anchor.as_ref()?;
        Some((*place, at.then(&self.settings().odometry_noise.between(before, odometry?))))
    }

    /// Whether a robot is so near to where a place is that it is still there.
    pub(super) fn is_at(&self, (part, robot): &(PlaceId, PlanarPose), place: PlaceId) -> bool {
        let pose = self.poses().pose(place).filter(|_| self.poses().part(place) == Some(*part));
        pose.is_some_and(|pose| self.settings().place_spacing.holds(&pose.inverse().compose(robot)))
    }
}

impl FrameInHand<'_> {
    /// Where the robot is by its wheels, since the place where it last was, and the part of the map
    /// that it is in.
    pub(super) fn pose_of_robot(&self) -> Option<(PlaceId, PlanarPose)> {
        let stay = self.session.stay.as_ref().filter(|stay| stay.at.is_some())?;
        let driven = self.mapper.driven_from(stay, self.input.odometry.as_ref())?;
        let poses = self.mapper.poses();
        Some((poses.part(stay.place)?, poses.pose(stay.place)?.compose(driven.pose())))
    }

    /// Where in a place's frame the robot is by its wheels, since the place where it last was.
    pub(super) fn located_by_wheels(&self, place: PlaceId) -> Option<Located> {
        let stay = self.session.stay.as_ref()?;
        let driven = self.mapper.driven_from(stay, self.input.odometry.as_ref())?;
        if stay.place == place {
            return Some(Located::ByWheels(driven));
        }
        let poses = self.mapper.poses();
        let same_part = poses.part(stay.place) == poses.part(place);
        let between = poses.pose(place)?.inverse().compose(poses.pose(stay.place)?);
        let between = RelativePose::new(between, nalgebra::Matrix3::zeros()).ok();
        between.filter(|_| same_part).map(|between| Located::ByWheels(between.then(&driven)))
    }

    /// Where in its place's frame the robot is by a closure onto a frame that was taken at `at`.
    pub(super) fn located_by_closure(
        &self,
        view: Option<&TwoView>,
        at: Option<RelativePose>,
        focal_length_widths: Option<f64>,
    ) -> Located {
        let noise = ClosureNoise::of_spacing(self.mapper.settings().place_spacing.distance_m);
        match view.and_then(|view| noise.measure(view, focal_length_widths)) {
            Some(measured) => Located::ByClosure(at.unwrap_or_else(RelativePose::none).then(&measured)),
            // Where wheels put the robot may be metres away: they are what the closure corrects.
            None => Located::Somewhere(noise.somewhere()),
        }
    }
}
