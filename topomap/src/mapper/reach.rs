//! Which places wheels say that a robot cannot be at.

use fabmap::appearance::PlaceId;

use super::frame::FrameInput;
use super::state::Mapper;
use crate::metric::WheelReach;

/// A place that a robot has driven away from, further than its wheels can be wrong by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutOfReach {
    /// How far off the place is at least, in metres.
    pub least_m: f64,
    /// How far off it may seem and still be the one where the robot is, in metres.
    pub allowed_m: f64,
}

/// Place spacings between two frames of one place, the second as far from its place as the first.
const SPACINGS: f64 = 3.0;

impl Mapper {
    /// Whether a session cannot be at `place` with its next frame, which it has driven away from on
    /// new ground alone: no error that its wheels may have makes that way a loop. What lies
    /// further back than a drift may have bent into a circle is not told, nor what lies behind a
    /// closure.
    #[must_use]
    pub fn out_of_reach(&self, input: &FrameInput, place: PlaceId) -> Option<OutOfReach> {
        let noise = &self.settings().odometry_noise;
        let stay = self.map().session(input.session)?.stay.as_ref()?;
        let last = self.driven_from(stay, input.odometry.as_ref())?;
        let longest_m = WheelReach::longest_m(noise);
        let mut driven = self.poses().ways().on_new_ground(input.session, place, stay.place, longest_m)?;
        driven.push(last);
        let spacing_m = self.settings().place_spacing.distance_m;
        let WheelReach { least_m, error_m } = WheelReach::of(&driven, noise, spacing_m);
        let allowed_m = error_m + SPACINGS * spacing_m;
        (least_m > allowed_m).then_some(OutOfReach { least_m, allowed_m })
    }
}
