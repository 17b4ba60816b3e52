//! What people say of loop closures.

mod visit;

pub use visit::{Heard, Visit};

use fabmap::appearance::PlaceId;

use super::errors::{CorrectError, FoldError};
use super::state::Mapper;
use crate::evidence::{ClosureNoise, TwoView};
use crate::ids::{FrameId, SessionId};
use crate::log::{
    Confirmation, Correction, CorrectionEvent, FrameEvent, Link, LinkKind, MeasuredEvent, Reason, Undoing,
};
use crate::metric::RelativePose;

/// Who says something, and when.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Said {
    /// Who says it; empty if nobody asked for a name.
    pub by: String,
    /// When, in nanoseconds since 1970.
    pub said_ns: i64,
}

/// Two frames that somebody takes for one place.
#[derive(Clone, Copy, Debug)]
pub struct SamePlace<'a> {
    /// The later frame.
    pub later: &'a FrameEvent,
    /// The earlier one.
    pub earlier: &'a FrameEvent,
    /// What the two views have in common; `None` if features of one of them are not kept.
    pub view: Option<TwoView>,
    /// Focal length of the later frame's camera, in image widths, if it is known.
    pub focal_length_widths: Option<f64>,
}

impl Mapper {
    /// Begins to take a loop closure back: what rested on it is in the frames of its session before
    /// and after, which the caller hands to what this returns. `measured` is what robots measured
    /// at frames of the session.
    ///
    /// # Errors
    /// [`CorrectError`] if the frame closed no loop, or none that stands.
    pub fn visit<'a>(
        &'a self,
        closure: &'a FrameEvent,
        measured: &'a [MeasuredEvent],
    ) -> Result<Visit<'a>, CorrectError> {
        let decision = &closure.decision;
        let (Reason::LoopClosure, Some(place), Some(matched)) =
            (decision.reason, decision.place, decision.closure)
        else {
            return Err(CorrectError::NoClosure { reason: decision.reason });
        };
        self.check_at_its_place(closure, "")?;
        Ok(Visit::begin(self, closure, measured, (place, matched.frame)))
    }

    /// Decides what follows from two frames being of one place: a link between the places that the
    /// map has them at. It measures what the two views do, where the map has metres.
    ///
    /// # Errors
    /// [`CorrectError`] if nothing follows from it, or the link that would cannot be measured.
    pub fn confirm(&self, pair: &SamePlace<'_>, said: Said) -> Result<CorrectionEvent, CorrectError> {
        let SamePlace { later, earlier, .. } = *pair;
        if earlier.frame >= later.frame {
            return Err(CorrectError::NotEarlier);
        }
        let from = self.check_at_its_place(later, "later")?;
        let to = self.check_at_its_place(earlier, "earlier")?;
        if from == to {
            return Err(CorrectError::SamePlace { place: from });
        }
        let is_confirmed = |event: &CorrectionEvent| match event.correction {
            Correction::Confirmed(Confirmation { frame, earlier: known, .. }) => {
                (frame, known) == (later.frame, earlier.frame)
            }
            Correction::Withdrawn(_) | Correction::Undone(_) => false,
        };
        if let Some(known) = self.map().corrections().find(|event| is_confirmed(event)) {
            return Err(CorrectError::Confirmed { correction: known.position });
        }
        let kind = match (later.at, earlier.at) {
            (Some(at), Some(seen_from)) => {
                let measured = self.measured_between(pair)?;
                LinkKind::Closed(at.then(&seen_from.then(&measured).back()))
            }
            (None, _) | (_, None) => LinkKind::Session,
        };
        let link = Link { from, to, kind };
        let correction = Confirmation { frame: later.frame, earlier: earlier.frame, link: Some(link) };
        Ok(self.said(later.session, said, Correction::Confirmed(correction)))
    }

    /// Decides that a correction is undone.
    ///
    /// # Errors
    /// [`CorrectError`] if there is none, or a later one rests on it.
    pub fn undo(&self, correction: u64, said: Said) -> Result<CorrectionEvent, CorrectError> {
        let known = self.map().correction(correction).ok_or(CorrectError::Unknown { correction })?;
        if let Some(later) = self.map().corrected_since(known.session, correction) {
            return Err(CorrectError::Later { correction, later });
        }
        let undoing = Undoing { correction, place: known.place() };
        Ok(self.said(known.session, said, Correction::Undone(undoing)))
    }

    fn said(&self, session: SessionId, said: Said, correction: Correction) -> CorrectionEvent {
        let Said { by, said_ns } = said;
        CorrectionEvent { position: self.map().events(), session, by, said_ns, correction }
    }

    /// The place where a frame is; `which` of two, for the message.
    fn check_at_its_place(&self, frame: &FrameEvent, which: &'static str) -> Result<PlaceId, CorrectError> {
        let at_no_place = |event: &CorrectionEvent| match &event.correction {
            Correction::Withdrawn(withdrawal) => withdrawal.has(frame.frame),
            Correction::Confirmed(_) | Correction::Undone(_) => false,
        };
        match self.map().corrections().find(|event| at_no_place(event)) {
            Some(event) => Err(CorrectError::Withdrawn { correction: event.position }),
            None => frame.decision.place.ok_or(CorrectError::NoPlace { which }),
        }
    }

    /// Where the later robot was, seen from the earlier one.
    fn measured_between(&self, pair: &SamePlace<'_>) -> Result<RelativePose, CorrectError> {
        let SamePlace { later, view, focal_length_widths, .. } = pair;
        let view = view.as_ref().ok_or(CorrectError::NoFeatures)?;
        let settings = self.settings().for_frame(later.odometry.as_ref(), *focal_length_widths);
        let checks = settings.verification.of_one_place(view, &settings.place_spacing);
        if let Some(&failed) = checks.iter().find(|check| !check.passed()) {
            return Err(CorrectError::Refused { failed });
        }
        let noise = ClosureNoise::of_spacing(settings.place_spacing.distance_m);
        noise.measure(view, *focal_length_widths).ok_or(CorrectError::Unmeasured)
    }

    /// Whether what a person said is the next of this map's log.
    pub(super) fn check_correction(&self, event: &CorrectionEvent) -> Result<(), FoldError> {
        let CorrectionEvent { position, session, correction, by: _, said_ns: _ } = event;
        let expected = self.map().events();
        if *position != expected {
            return Err(FoldError::Position { expected, found: *position });
        }
        if self.map().session(*session).is_none() {
            return Err(FoldError::Session { session: *session });
        }
        let places = self.map().places().len();
        let (named, frames): (Vec<PlaceId>, Vec<FrameId>) = match correction {
            Correction::Withdrawn(withdrawal) => (withdrawal.places(), withdrawal.events()),
            Correction::Confirmed(Confirmation { frame, earlier, link }) => {
                let ends = link.map(|link| [link.from, link.to]).into_iter().flatten();
                (ends.collect(), vec![*frame, *earlier])
            }
            Correction::Undone(Undoing { correction, place }) => {
                (place.iter().copied().collect(), vec![*correction])
            }
        };
        if let Some(&place) = named.iter().find(|place| place.index() >= places) {
            return Err(FoldError::Place { place });
        }
        let known = match correction {
            Correction::Withdrawn(withdrawal) => {
                let taken_out = withdrawal.relinked.iter().filter_map(|relinked| relinked.was.as_ref());
                taken_out.into_iter().all(|link| self.map().has_link(link))
            }
            Correction::Confirmed(_) => true,
            Correction::Undone(Undoing { correction, .. }) => {
                self.map().correction(*correction).is_some_and(|known| known.session == *session)
                    && self.map().corrected_since(*session, *correction).is_none()
            }
        };
        if known && frames.iter().all(|frame| frame < position) {
            Ok(())
        } else {
            Err(FoldError::Correction { position: *position })
        }
    }
}
