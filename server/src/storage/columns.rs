//! What the log's columns tell of an event, beside its bytes.

use fabmap::appearance::PlaceId;
use topomap::evidence::Candidate;
use topomap::ids::SessionId;
use topomap::log::{Confirmation, Correction, CorrectionEvent, Link, MapEvent, Reason, Undoing};

use super::values::{MaybeWhole, to_sql};

/// What the column of reasons says of corrections.
const WITHDRAWN: &str = "closure_withdrawn";
const CONFIRMED: &str = "closure_confirmed";
const UNDONE: &str = "correction_undone";

/// The columns of an event.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(super) struct EventColumns {
    #[sqlx(try_from = "i64")]
    pub(super) session: SessionId,
    /// Of a frame.
    pub(super) sequence: Option<i64>,
    pub(super) stamp_ns: Option<i64>,
    pub(super) reason: Option<String>,
    #[sqlx(try_from = "MaybeWhole")]
    pub(super) place: Option<u32>,
    pub(super) posterior: Option<f64>,
    pub(super) matched_frame: Option<i64>,
    /// `None` in what the first servers wrote.
    pub(super) probability: Option<f64>,
    #[sqlx(try_from = "MaybeWhole")]
    pub(super) link_from: Option<u32>,
    #[sqlx(try_from = "MaybeWhole")]
    pub(super) link_to: Option<u32>,
}

impl EventColumns {
    pub(super) fn of(event: &MapEvent) -> Self {
        let (frame, link): (_, Option<Link>) = match event {
            MapEvent::SessionOpened { .. } => (None, None),
            MapEvent::Frame(frame) => (Some(frame), frame.link),
            MapEvent::Measured(measured) => (None, measured.link),
            MapEvent::Corrected(corrected) => return Self::of_correction(corrected),
        };
        let decision = frame.map(|frame| &frame.decision);
        Self {
            session: event.session(),
            sequence: frame.map(|frame| to_sql(frame.sequence)),
            stamp_ns: frame.map(|frame| frame.stamp_ns),
            reason: decision.map(|decision| reason_name(decision.reason).to_owned()),
            place: decision.and_then(|decision| decision.place).map(PlaceId::number),
            posterior: decision.map(|decision| decision.posterior),
            matched_frame: decision
                .and_then(|decision| decision.closure)
                .map(|closure| to_sql(closure.frame)),
            probability: frame.and_then(|frame| frame.verified_by()).map(Candidate::probability),
            link_from: link.map(|link| link.from.number()),
            link_to: link.map(|link| link.to.number()),
        }
    }

    /// Their links are in their bytes alone: they take some out, too.
    fn of_correction(event: &CorrectionEvent) -> Self {
        let (reason, of) = match &event.correction {
            Correction::Withdrawn(withdrawal) => (WITHDRAWN, withdrawal.frame),
            Correction::Confirmed(Confirmation { frame, .. }) => (CONFIRMED, *frame),
            Correction::Undone(Undoing { correction, .. }) => (UNDONE, *correction),
        };
        Self {
            session: event.session,
            sequence: None,
            stamp_ns: None,
            reason: Some(reason.to_owned()),
            place: None,
            posterior: None,
            matched_frame: Some(to_sql(of)),
            probability: None,
            link_from: None,
            link_to: None,
        }
    }

    /// Whether these are the columns of that event.
    pub(super) fn are_of(&self, event: &MapEvent) -> bool {
        let columns = Self::of(event);
        let probability = self.probability.and(columns.probability);
        *self == Self { probability, ..columns }
    }
}

/// A reason as the log, the metrics and people have it.
pub(crate) fn reason_name(reason: Reason) -> &'static str {
    match reason {
        Reason::NewPlace => "new_place",
        Reason::SamePlace => "same_place",
        Reason::LoopClosure => "loop_closure",
        Reason::BelowThreshold => "below_threshold",
        Reason::TooFewWords => "too_few_words",
        Reason::GeometryRefused => "geometry_refused",
    }
}
