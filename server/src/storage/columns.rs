//! What the log's columns tell of an event, beside its bytes.

use fabmap::appearance::PlaceId;
use sqlx::{Any, Transaction};
use topomap::evidence::Candidate;
use topomap::ids::SessionId;
use topomap::log::{Confirmation, Correction, CorrectionEvent, Link, MapEvent, Reason, Undoing};

use super::row_sums::checksum;
use super::values::{MaybeReal, MaybeWhole, to_sql};
use super::{MapId, StorageError};

/// What the column of reasons says of corrections.
const WITHDRAWN: &str = "closure_withdrawn";
const CONFIRMED: &str = "closure_confirmed";
const UNDONE: &str = "correction_undone";

/// The columns of an event.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(super) struct EventColumns {
    #[sqlx(try_from = "i64")]
    session: SessionId,
    sequence: Option<i64>,
    stamp_ns: Option<i64>,
    reason: Option<String>,
    #[sqlx(try_from = "MaybeWhole")]
    place: Option<u32>,
    posterior: Option<f64>,
    matched_frame: Option<i64>,
    /// `None` in what the first servers wrote.
    probability: Option<f64>,
    #[sqlx(try_from = "MaybeWhole")]
    link_from: Option<u32>,
    #[sqlx(try_from = "MaybeWhole")]
    link_to: Option<u32>,
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

    pub(super) fn session(&self) -> SessionId {
        self.session
    }

    /// Of a frame.
    pub(super) fn sequence(&self) -> Option<i64> {
        self.sequence
    }

    /// Whether these are the columns of that event.
    pub(super) fn are_of(&self, event: &MapEvent) -> bool {
        let columns = Self::of(event);
        let probability = self.probability.and(columns.probability);
        *self == Self { probability, ..columns }
    }
}

/// Stores an event; how many bytes it takes.
pub(super) async fn insert_event(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    position: i64,
    event: &MapEvent,
) -> Result<u64, StorageError> {
    let EventColumns {
        session,
        sequence,
        stamp_ns,
        reason,
        place,
        posterior,
        matched_frame,
        probability,
        link_from,
        link_to,
    } = EventColumns::of(event);
    let bytes = event.to_bytes();
    let length = bytes.len() as u64;
    // The chain goes on as in `row_sums::chained`.
    sqlx::query(
        "INSERT INTO log (map_id, position, checksum, chain, session, sequence, stamp_ns, reason, place, posterior, \
         matched_frame, probability, link_from, link_to, event) VALUES ($1, $2, $3, \
         (coalesce((SELECT chain FROM log WHERE map_id = $1 AND position = $2 - 1), 0) * 48271 + $3) % 2147483647, \
         $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14)",
    )
    .bind(map)
    .bind(position)
    .bind(checksum(position, &bytes))
    .bind(i64::from(session))
    .bind(sequence)
    .bind(stamp_ns)
    .bind(reason)
    .bind(place.map(i64::from))
    .bind(MaybeReal(posterior))
    .bind(matched_frame)
    .bind(MaybeReal(probability))
    .bind(link_from.map(i64::from))
    .bind(link_to.map(i64::from))
    .bind(bytes)
    .execute(&mut **transaction)
    .await?;
    Ok(length)
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
