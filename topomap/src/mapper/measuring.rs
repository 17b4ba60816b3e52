//! What robots measure by themselves.

use super::errors::MeasureError;
use super::state::Mapper;

use crate::log::{FrameEvent, Link, LinkKind, MeasuredEvent};
use crate::metric::RelativePose;

/// Where a robot was at a frame, seen from where a robot was at an earlier one.
#[derive(Clone, Copy, Debug)]
pub struct Measurement<'a> {
    /// The frame.
    pub later: &'a FrameEvent,
    /// The one before it in its session, if there is one.
    pub before: Option<&'a FrameEvent>,
    /// The earlier frame, of any session.
    pub earlier: &'a FrameEvent,
    /// base_link at `later` in base_link at `earlier`.
    pub pose: RelativePose,
}

impl Mapper {
    /// Decides what follows from a measurement: a link that measures, and, while the robot is still
    /// there, where its wheels go on from.
    ///
    /// A frame that is at another place than the earlier one links the two. One that was recognised
    /// to be at the same place says by what its wheels did on the way there how that place lies to
    /// the one before.
    ///
    /// # Errors
    /// [`MeasureError`] if nothing follows from it; nothing changes either way.
    pub fn measure(&self, measurement: &Measurement<'_>) -> Result<MeasuredEvent, MeasureError> {
        let Measurement { later, before, earlier, pose } = *measurement;
        if earlier.frame >= later.frame {
            return Err(MeasureError::NotEarlier);
        }
        for (which, frame) in [("earlier", earlier.frame), ("later", later.frame)] {
            if self.map().withdrawal_of(frame).is_some() {
                return Err(MeasureError::Withdrawn { which });
            }
        }
        let (Some(place), Some(seen_from)) = (earlier.decision.place, earlier.at) else {
            return Err(MeasureError::NoMetres { which: "earlier" });
        };
        let (Some(at_place), Some(recognised_at), Some(odometry)) =
            (later.decision.place, later.at, &later.odometry)
        else {
            return Err(MeasureError::NoMetres { which: "later" });
        };
        let at = seen_from.then(&pose);
        let way_from =
            |from, way: RelativePose| Link { from, to: place, kind: LinkKind::Closed(way.then(&at.back())) };
        let link = if at_place != place {
            Some(way_from(at_place, recognised_at))
        } else {
            before.filter(|before| before.decision.place != Some(place)).and_then(|before| {
                let driven = self.settings().odometry_noise.between(before.odometry.as_ref()?, odometry);
                Some(way_from(before.decision.place?, before.at?.then(&driven)))
            })
        };
        let is_last = self
            .map()
            .session(later.session)
            .is_some_and(|session| session.last_sequence == Some(later.sequence));
        let is_there = is_last && at_place == place;
        // As of frames: wheels go on from where the robot surely was.
        let sigma_m = at.position_sigma_m();
        let spacing_m = self.settings().place_spacing.distance_m;
        let goes_on_from = (is_there && sigma_m <= spacing_m).then(|| odometry.clone());
        match (link, &goes_on_from) {
            (None, None) if is_there => return Err(MeasureError::TooUnsure { sigma_m, spacing_m }),
            (None, None) => return Err(MeasureError::TooLate),
            (Some(_), _) | (None, Some(_)) => {}
        }
        Ok(MeasuredEvent {
            position: self.map().events(),
            session: later.session,
            frame: later.frame,
            earlier: earlier.frame,
            place,
            at,
            link,
            goes_on_from,
        })
    }

    /// Whether the map has taken in the very same before: a robot that heard no answer sends it
    /// again.
    #[must_use]
    pub fn has_measured(&self, event: &MeasuredEvent) -> bool {
        let anchor = self.map().session(event.session).and_then(|session| session.anchor.as_ref());
        let goes_on = |odometry| {
            let known = anchor.map(|anchor| (anchor.place, &anchor.odometry, anchor.at));
            known == Some((event.place, odometry, event.at))
        };
        event.link.is_none_or(|link| self.map().links().contains(&link))
            && event.goes_on_from.as_ref().is_none_or(goes_on)
    }
}
