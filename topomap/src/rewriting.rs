//! A log rewritten without some of its sessions, or some of its places; and which places a map can
//! do without.
//!
//! The new log passes the fold: a merge is undone, and a session removed, by folding it from
//! nothing. Counts that were halved cannot be taken back one by one, and what was learnt of a place
//! cannot be told apart; the log has all of it.
//!
//! What stays is what was decided then: nobody is asked again where a frame was taken. A place that
//! a removed session made is made by the first frame that is left there, and lies where that was
//! taken.

mod teller;
mod trimming;
mod ways;

use std::collections::{BTreeMap, BTreeSet};

use fabmap::appearance::PlaceId;

use crate::ids::{FrameId, SessionId};
use crate::log::{Correction, MapEvent, Undoing, Withdrawal};
use crate::settings::MapperSettings;
use teller::{Left, Teller};

pub use trimming::{Budgeted, Dispensable, Distance, Why, over_budget};

/// A log without what was left out of it.
///
/// A closure onto a frame that is gone names the frame that made the place, and loses its
/// candidates: what two images had in common says nothing about two others.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Retold {
    /// What the new log holds. Events before the first that was left out are as they were, bit for
    /// bit.
    pub events: Vec<MapEvent>,
    /// Positions in the new log by those in the old, of what stays.
    pub frames: BTreeMap<FrameId, FrameId>,
    /// Numbers in the new log by those in the old, of sessions that stay: a log counts its sessions
    /// without gaps, so that those opened after one that was left out have other numbers.
    pub sessions: BTreeMap<SessionId, SessionId>,
    /// By places of the old log: what each is in the new; `None` if it is gone.
    pub places: Vec<Option<PlaceId>>,
    /// What is no more.
    pub dropped: Dropped,
}

/// How much was left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Events of the log.
    pub events: u64,
    /// Places.
    pub places: u64,
    /// Links, of those that stayed in the log's events.
    pub links: u64,
    /// What people said of frames that are gone, or at other places now.
    pub corrections: u64,
    /// Loop closures of frames that stay, whose place only what was left out had seen before.
    pub closures: u64,
}

/// A log that cannot be rewritten.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RetellError {
    /// It names what it has not made before.
    #[error("event {position} of the log names a place, frame or session that no event before has made")]
    Unknown {
        /// Its position.
        position: u64,
    },
    /// Events are missing, or in another order.
    #[error("event {found} of the log stands where {expected} should; give the whole log from its beginning")]
    Position {
        /// The position that comes next.
        expected: u64,
        /// The event's own.
        found: u64,
    },
    /// There is nothing to leave out.
    #[error("the log has no session {session}; name one that it has")]
    NoSession {
        /// The session.
        session: SessionId,
    },
    /// There is nothing to leave out.
    #[error("the log has no place {place}; name one that it has")]
    NoPlace {
        /// The place.
        place: PlaceId,
    },
}

/// The log as it would be if these sessions had not been.
///
/// Ways that only a removed session's link stood for are linked as the remaining session drove
/// them. Places that only removed sessions visited are gone, and what was believed of them is the
/// probability of somewhere new.
///
/// # Errors
/// [`RetellError`] if `log` is not a map's whole log, or a session is none of it.
pub fn without_sessions<'a>(
    settings: &MapperSettings,
    log: impl IntoIterator<Item = &'a MapEvent>,
    removed: &BTreeSet<SessionId>,
) -> Result<Retold, RetellError> {
    let (retold, opened) = told(settings, log, (removed, &BTreeSet::new()))?;
    match removed.iter().find(|&&session| u64::from(session) >= opened) {
        Some(&session) => Err(RetellError::NoSession { session }),
        None => Ok(retold),
    }
}

/// The log without these places: what was seen there is a frame at no place, so that all frames
/// keep their positions, and a session's places before and after are linked by what its wheels did
/// between them.
///
/// # Errors
/// [`RetellError`] if `log` is not a map's whole log, or a place is none of it.
pub fn without_places<'a>(
    settings: &MapperSettings,
    log: impl IntoIterator<Item = &'a MapEvent>,
    dropped: &BTreeSet<PlaceId>,
) -> Result<Retold, RetellError> {
    let (retold, _) = told(settings, log, (&BTreeSet::new(), dropped))?;
    match dropped.iter().find(|&&place| place.index() >= retold.places.len()) {
        Some(&place) => Err(RetellError::NoPlace { place }),
        None => Ok(retold),
    }
}

/// The new log, and how many sessions the old one has.
fn told<'a>(
    settings: &MapperSettings,
    log: impl IntoIterator<Item = &'a MapEvent>,
    (sessions, places): (&BTreeSet<SessionId>, &BTreeSet<PlaceId>),
) -> Result<(Retold, u64), RetellError> {
    let log: Vec<&MapEvent> = log.into_iter().collect();
    let left = Left { sessions, places, withdrawn: &withdrawn(&log) };
    let mut teller = Teller::new(settings, &left);
    log.into_iter().try_for_each(|event| teller.tell(event))?;
    Ok(teller.end())
}

/// Frames that are at no place because somebody said so, each with the closure that was withdrawn.
fn withdrawn(log: &[&MapEvent]) -> BTreeMap<FrameId, FrameId> {
    let mut standing: BTreeMap<u64, &Withdrawal> = BTreeMap::new();
    for event in log {
        let MapEvent::Corrected(event) = event else { continue };
        match &event.correction {
            Correction::Withdrawn(withdrawal) => {
                standing.insert(event.position, withdrawal);
            }
            Correction::Undone(Undoing { correction, .. }) => {
                standing.remove(correction);
            }
            Correction::Confirmed(_) => {}
        }
    }
    let of_closure = |withdrawal: &Withdrawal| {
        let closure = withdrawal.frame;
        withdrawal.frames.iter().map(move |&frame| (frame, closure)).collect::<Vec<_>>()
    };
    standing.into_values().flat_map(of_closure).collect()
}
