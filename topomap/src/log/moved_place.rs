//! A place of one log as a place of another.

use fabmap::appearance::PlaceId;

use crate::metric::RelativePose;

/// What a place of one log has become in another log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MovedPlace {
    /// The place that it is now.
    pub(crate) place: PlaceId,
    /// The frame of the place that it was in the frame of the one that it is; `None` if they are
    /// one.
    pub(crate) at: Option<RelativePose>,
}

impl MovedPlace {
    /// Where a robot is in the frame of the new place, by where it was in that of the old.
    pub(crate) fn seen(&self, at: &RelativePose) -> RelativePose {
        self.at.map_or(*at, |of_place| of_place.then(at))
    }

    /// A way between two old places as one between the new.
    pub(crate) fn way_to(&self, to: &MovedPlace, measured: &RelativePose) -> RelativePose {
        let ahead = self.seen(measured);
        to.at.map_or(ahead, |at| ahead.then(&at.back()))
    }
}
