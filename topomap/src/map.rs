//! The map: what the log adds up to.

mod corrections;
mod encoding;
mod milestones;
mod place_poses;
mod session;
mod ways;

pub use corrections::Corrections;
pub(crate) use encoding::SESSION_VERSION;
pub use encoding::{decode_place, encode_place};
pub use milestones::{Milestone, Milestones};
pub use place_poses::PlacePoses;
pub use session::{Anchor, LeftPlace, Measured, Past, Placed, Session, Sighting, Stay};

use std::collections::BTreeMap;

use fabmap::appearance::{Appearance, PlaceId};
use fabmap::codec::DecodeError;
use fabmap::model::ContentHash;
use sha2::{Digest, Sha256};

use crate::ids::{FrameId, SessionId};
use crate::log::{FrameEvent, Link, MeasuredEvent};
use crate::settings::MapperSettings;

/// Places, links and sessions; appearances live in the recognizer's index, under the same ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Map {
    places: Vec<Place>,
    links: Vec<Link>,
    /// Per place: the places it is linked with, ascending.
    linked: Vec<Vec<PlaceId>>,
    sessions: BTreeMap<SessionId, Session>,
    /// Per session what places learnt from it, in the order of its frames; derived from the places.
    learnt: BTreeMap<SessionId, Vec<Look>>,
    corrections: Corrections,
    /// Events folded in; the next event's position in the log.
    events: u64,
}

/// A place, as the frames that it learnt from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Place {
    /// Oldest first.
    pub frames: Vec<PlaceFrame>,
}

/// A frame that a place learnt from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlaceFrame {
    /// The frame.
    pub frame: FrameId,
    /// The session it came from.
    pub session: SessionId,
    /// Its number among the frames of that session, from 0.
    pub number: u64,
}

/// That a place learnt from a frame of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Look {
    /// The place.
    pub(crate) place: PlaceId,
    /// The frame.
    pub(crate) frame: FrameId,
    /// Its number among the frames of the session, from 0.
    pub(crate) number: u64,
}

impl Map {
    /// All places, in order of id.
    #[must_use]
    pub fn places(&self) -> &[Place] {
        &self.places
    }

    /// All links that ever were, in order of creation; [`Map::standing_links`] leaves out those that
    /// are no more. Frames add at most one between two places; what robots measured, and what
    /// people corrected, comes on top.
    #[must_use]
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// The places linked with `place`, ascending; none for a place that does not exist.
    #[must_use]
    pub fn linked(&self, place: PlaceId) -> &[PlaceId] {
        self.linked.get(place.index()).map_or(&[], Vec::as_slice)
    }

    /// A frame that `place` learnt from, by its id.
    #[must_use]
    pub fn locate(&self, place: PlaceId, frame: FrameId) -> Option<PlaceFrame> {
        let frames = &self.places.get(place.index())?.frames;
        let position = frames.binary_search_by_key(&frame, |learnt| learnt.frame).ok()?;
        Some(frames[position])
    }

    /// What places learnt from a session's frames after its frame `number`, in their order.
    pub(crate) fn learnt_after(&self, session: SessionId, number: u64) -> &[Look] {
        let looks = self.learnt.get(&session).map_or(&[][..], Vec::as_slice);
        &looks[looks.partition_point(|look| look.number <= number)..]
    }

    /// A session, if it was opened.
    #[must_use]
    pub fn session(&self, session: SessionId) -> Option<&Session> {
        self.sessions.get(&session)
    }

    /// All sessions with their numbers, ascending.
    pub fn sessions(&self) -> impl Iterator<Item = (SessionId, &Session)> {
        self.sessions.iter().map(|(&id, session)| (id, session))
    }

    /// The number that the next session gets.
    #[must_use]
    pub fn next_session(&self) -> SessionId {
        self.sessions.last_key_value().map_or(0, |(last, _)| last + 1)
    }

    /// What other places than a frame's own showed of it, over all sessions: the sum per word, and
    /// the number of frames.
    pub(crate) fn look_alikes(&self) -> (f64, u64) {
        let seen = self.sessions.values().map(|session| session.look_alikes);
        seen.fold((0.0, 0), |(shares, frames), seen| (shares + seen.shares, frames + seen.frames))
    }

    /// Events folded in so far: the position of the next.
    #[must_use]
    pub fn events(&self) -> u64 {
        self.events
    }

    /// Memory of places and links.
    pub(crate) fn memory_bytes(&self) -> usize {
        let frames: usize = self.places.iter().map(|place| place.frames.capacity()).sum();
        let linked: usize = self.linked.iter().map(Vec::capacity).sum();
        let looks: usize = self.learnt.values().map(Vec::capacity).sum();
        self.places.capacity() * (size_of::<Place>() + size_of::<Vec<PlaceId>>())
            + frames * size_of::<PlaceFrame>()
            + looks * size_of::<Look>()
            + linked * size_of::<PlaceId>()
            + self.links.capacity() * size_of::<Link>()
    }

    /// A map from all that it consists of; `events` is the length of its log.
    ///
    /// # Errors
    /// [`DecodeError`] if a link leads to or from a place that is not there, or a correction is of
    /// what is not there.
    pub fn from_parts(
        places: Vec<Place>,
        links: Vec<Link>,
        sessions: BTreeMap<SessionId, Session>,
        corrections: Corrections,
        events: u64,
    ) -> Result<Self, DecodeError> {
        let known = |place: PlaceId| (place.index()) < places.len();
        if links.iter().any(|link| !known(link.from) || !known(link.to)) {
            return Err(DecodeError::invalid("a link to a place that does not exist"));
        }
        if !corrections.fit(places.len(), links.len()) {
            return Err(DecodeError::invalid("a correction of what does not exist"));
        }
        let learnt = looks_of(&places);
        let mut map = Self { places, links, linked: Vec::new(), sessions, learnt, corrections, events };
        map.link_places();
        Ok(map)
    }

    pub(crate) fn open_session(&mut self, session: SessionId) {
        self.sessions.insert(session, Session::new());
        self.events += 1;
    }

    /// Folds a frame in, except for appearances. The settings bound what a session remembers of the
    /// places it left and of what it saw.
    pub(crate) fn fold_frame(
        &mut self,
        event: &FrameEvent,
        settings: &MapperSettings,
        sightings: Vec<Sighting>,
    ) {
        let session = self.sessions.entry(event.session).or_insert_with(Session::new);
        if let Some(place) = event.decision.place {
            if place.index() >= self.places.len() {
                self.places.resize_with(place.index() + 1, Place::default);
                self.linked.resize_with(place.index() + 1, Vec::new);
            }
            if event.learnt {
                let learnt =
                    PlaceFrame { frame: event.frame, session: event.session, number: session.frames };
                self.places[place.index()].frames.push(learnt);
                let look = Look { place, frame: learnt.frame, number: learnt.number };
                self.learnt.entry(event.session).or_default().push(look);
            }
        }
        session.follow(event, settings, sightings);
        if let Some(link) = event.link {
            self.add_link(link);
        }
        self.events = event.frame + 1;
    }

    /// Folds in what a robot measured by itself.
    pub(crate) fn fold_measured(&mut self, event: &MeasuredEvent) {
        if let (Some(session), Some(odometry)) = (self.sessions.get_mut(&event.session), &event.goes_on_from)
        {
            session.go_on_from(event.place, odometry, event.at);
        }
        if let Some(link) = event.link {
            self.add_link(link);
        }
        self.events = event.position + 1;
    }

    fn add_link(&mut self, link: Link) {
        self.links.push(link);
        for (place, other) in [(link.from, link.to), (link.to, link.from)] {
            let linked = &mut self.linked[place.index()];
            if let Err(position) = linked.binary_search(&other) {
                linked.insert(position, other);
            }
        }
    }

    /// SHA-256 of all that the log decided: counts, frames of places, links with their
    /// measurements, sessions with their beliefs. Equal logs give equal hashes, whatever happened
    /// in between.
    #[must_use]
    pub fn state_hash(&self, appearances: impl Iterator<Item = Appearance>) -> ContentHash {
        let mut hasher = Sha256::new();
        for (place, appearance) in self.places.iter().zip(appearances) {
            hasher.update(encode_place(place, &appearance));
        }
        hasher.update(self.encode_graph());
        ContentHash::from_bytes(hasher.finalize().into())
    }
}

/// [`Map::learnt`] of places that were read.
fn looks_of(places: &[Place]) -> BTreeMap<SessionId, Vec<Look>> {
    let mut learnt: BTreeMap<SessionId, Vec<Look>> = BTreeMap::new();
    for (place, Place { frames }) in PlaceId::all().zip(places) {
        for &PlaceFrame { frame, session, number } in frames {
            learnt.entry(session).or_default().push(Look { place, frame, number });
        }
    }
    learnt.values_mut().for_each(|looks| looks.sort_by_key(|look| look.number));
    learnt
}
