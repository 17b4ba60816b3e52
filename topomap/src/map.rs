//! The map: what the log adds up to.

mod encoding;
mod place_poses;

pub(crate) use encoding::SESSION_VERSION;
pub use encoding::{decode_place, encode_place};
pub use place_poses::PlacePoses;

use std::collections::{BTreeMap, VecDeque};

use fabmap::appearance::{Appearance, PlaceId};
use fabmap::codec::DecodeError;
use fabmap::model::ContentHash;
use fabmap::place_filter::Belief;
use sha2::{Digest, Sha256};

use crate::ids::{FrameId, SessionId};
use crate::log::{FrameEvent, Link, MeasuredEvent};
use crate::metric::{Odometry, RelativePose};
use crate::settings::{MAX_PAST_FRAMES, MapperSettings};

/// Places, links and sessions; appearances live in the recognizer's index, under the same ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Map {
    places: Vec<Place>,
    links: Vec<Link>,
    /// Per place: the places it is linked with, ascending.
    linked: Vec<Vec<PlaceId>>,
    sessions: BTreeMap<SessionId, Session>,
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

/// One run of one robot, as far as it has come.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// Frames so far.
    pub frames: u64,
    /// Sequence number of the last frame.
    pub last_sequence: Option<u64>,
    /// Stamp of the last frame.
    pub last_stamp_ns: Option<i64>,
    /// The last odometry, with its frame's stamp.
    pub last_odometry: Option<(i64, Odometry)>,
    /// Where the session is.
    pub stay: Option<Stay>,
    /// Places left a short while ago.
    pub left: VecDeque<LeftPlace>,
    /// What the next frame starts from.
    pub belief: Belief,
    /// What geometry found for the last frames, oldest first; empty where nothing is verified.
    pub sightings: VecDeque<Sighting>,
    /// The last frames with odometry, latest first; empty where none is measured.
    pub past: VecDeque<Past>,
    /// Where wheels go on from: the last frame that was surely somewhere.
    pub anchor: Option<Anchor>,
}

/// A frame whose place was not only recognised: where in it the robot was is known to within a
/// place spacing.
#[derive(Clone, Debug, PartialEq)]
pub struct Anchor {
    /// The place.
    pub place: PlaceId,
    /// Odometry of the frame.
    pub odometry: Odometry,
    /// Where in the place's frame the robot was.
    pub at: RelativePose,
}

/// What a session believed at an earlier frame, and where its wheels put it then.
#[derive(Clone, Debug, PartialEq)]
pub struct Past {
    /// Odometry of the frame.
    pub odometry: Odometry,
    /// What it carried on.
    pub belief: Belief,
}

/// An earlier frame that one of a session's last frames has evidence for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Number of the session's frame that saw it, from 0.
    pub number: u64,
    /// The place that was seen.
    pub place: PlaceId,
    /// The frame of it.
    pub seen: PlaceFrame,
    /// What the two frames say by themselves.
    pub evidence: f64,
    /// What they say with the frames before.
    pub total_evidence: f64,
}

impl Sighting {
    /// Whether it is of `place`, or of a frame that the same session took within `frames` of
    /// `other`.
    #[must_use]
    pub fn is_near(&self, place: PlaceId, other: PlaceFrame, frames: u64) -> bool {
        let same_way =
            self.seen.session == other.session && self.seen.number.abs_diff(other.number) <= frames;
        self.place == place || same_way
    }
}

/// Consecutive frames at one place.
#[derive(Clone, Debug, PartialEq)]
pub struct Stay {
    /// The place.
    pub place: PlaceId,
    /// Looks that the place has learnt from this stay.
    pub looks: u32,
    /// Odometry of the stay's last frame.
    pub odometry: Option<Odometry>,
    /// Where in the place's frame the robot was then, if that was measured.
    pub at: Option<RelativePose>,
}

/// A place that a session has just left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LeftPlace {
    /// The place.
    pub place: PlaceId,
    /// The number of the session's first frame elsewhere.
    pub number: u64,
    /// Looks learnt there; coming back soon continues the stay.
    pub looks: u32,
}

impl Map {
    /// All places, in order of id.
    #[must_use]
    pub fn places(&self) -> &[Place] {
        &self.places
    }

    /// All links, in order of creation. Frames add at most one between two places; what robots
    /// measured comes on top.
    #[must_use]
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// The places linked with `place`, ascending; none for a place that does not exist.
    #[must_use]
    pub fn linked(&self, place: PlaceId) -> &[PlaceId] {
        self.linked.get(place as usize).map_or(&[], Vec::as_slice)
    }

    /// A frame that `place` learnt from, by its id.
    #[must_use]
    pub fn locate(&self, place: PlaceId, frame: FrameId) -> Option<PlaceFrame> {
        let frames = &self.places.get(place as usize)?.frames;
        let position = frames.binary_search_by_key(&frame, |learnt| learnt.frame).ok()?;
        Some(frames[position])
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

    /// Events folded in so far: the position of the next.
    #[must_use]
    pub fn events(&self) -> u64 {
        self.events
    }

    /// Memory of places and links.
    pub(crate) fn memory_bytes(&self) -> usize {
        let frames: usize = self.places.iter().map(|place| place.frames.capacity()).sum();
        let linked: usize = self.linked.iter().map(Vec::capacity).sum();
        self.places.capacity() * (size_of::<Place>() + size_of::<Vec<PlaceId>>())
            + frames * size_of::<PlaceFrame>()
            + linked * size_of::<PlaceId>()
            + self.links.capacity() * size_of::<Link>()
    }

    /// A map from all that it consists of; `events` is the length of its log.
    ///
    /// # Errors
    /// [`DecodeError`] if a link leads to or from a place that is not there.
    pub fn from_parts(
        places: Vec<Place>,
        links: Vec<Link>,
        sessions: BTreeMap<SessionId, Session>,
        events: u64,
    ) -> Result<Self, DecodeError> {
        let linked = vec![Vec::new(); places.len()];
        let mut map = Self { places, links: Vec::with_capacity(links.len()), linked, sessions, events };
        for link in links {
            let known = |place: PlaceId| (place as usize) < map.places.len();
            if !known(link.from) || !known(link.to) {
                return Err(DecodeError::invalid("a link to a place that does not exist"));
            }
            map.add_link(link);
        }
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
            if place as usize >= self.places.len() {
                self.places.resize_with(place as usize + 1, Place::default);
                self.linked.resize_with(place as usize + 1, Vec::new);
            }
            if event.learnt {
                let learnt =
                    PlaceFrame { frame: event.frame, session: event.session, number: session.frames };
                self.places[place as usize].frames.push(learnt);
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
            let linked = &mut self.linked[place as usize];
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

impl Session {
    /// A session without a frame.
    pub(crate) fn new() -> Self {
        Self {
            frames: 0,
            last_sequence: None,
            last_stamp_ns: None,
            last_odometry: None,
            stay: None,
            left: VecDeque::new(),
            belief: Belief::unknown(),
            sightings: VecDeque::new(),
            past: VecDeque::new(),
            anchor: None,
        }
    }

    /// The place the session is at, or one that it left fewer than `guard_frames` frames ago.
    #[must_use]
    pub fn is_near(&self, place: PlaceId, guard_frames: u64) -> bool {
        self.frames_since(place, guard_frames).is_some()
    }

    /// Looks that `place` has learnt from the stay there that is going on or was just interrupted.
    #[must_use]
    pub fn looks_of_stay(&self, place: PlaceId, guard_frames: u64) -> u32 {
        match &self.stay {
            Some(stay) if stay.place == place => stay.looks,
            Some(_) | None => {
                self.left_lately(guard_frames).find(|left| left.place == place).map_or(0, |left| left.looks)
            }
        }
    }

    /// Frames since the session was at `place`, if it is there or left it fewer than `guard_frames`
    /// ago.
    #[must_use]
    pub fn frames_since(&self, place: PlaceId, guard_frames: u64) -> Option<u64> {
        match &self.stay {
            Some(stay) if stay.place == place => Some(0),
            Some(_) | None => self
                .left_lately(guard_frames)
                .find(|left| left.place == place)
                .map(|left| self.frames - left.number),
        }
    }

    /// Folds a frame of this session in.
    pub(crate) fn follow(&mut self, event: &FrameEvent, settings: &MapperSettings, sightings: Vec<Sighting>) {
        if let Some(place) = event.decision.place {
            self.arrive(place, event, settings.guard_frames);
            if let (Some(odometry), Some(at)) = (&event.odometry, event.at)
                && at.position_sigma_m() <= settings.place_spacing.distance_m
            {
                self.anchor = Some(Anchor { place, odometry: odometry.clone(), at });
            }
        }
        let earliest = (self.frames + 1).saturating_sub(settings.verification.consistency_frames.max(1));
        self.sightings.retain(|sighting| sighting.number >= earliest);
        self.sightings.extend(sightings);
        self.frames += 1;
        self.last_sequence = Some(event.sequence);
        self.last_stamp_ns = Some(event.stamp_ns);
        if let Some(odometry) = &event.odometry {
            self.last_odometry = Some((event.stamp_ns, odometry.clone()));
        }
        self.belief = event.belief.clone();
        if let (Some(odometry), Some(_)) = (&event.odometry, &event.at) {
            self.past.push_front(Past { odometry: odometry.clone(), belief: event.belief.clone() });
            self.past.truncate(MAX_PAST_FRAMES);
        }
    }

    /// Says better where the session's last frame was taken, within the place that it is at.
    fn go_on_from(&mut self, place: PlaceId, odometry: &Odometry, at: RelativePose) {
        if let Some(stay) = &mut self.stay {
            stay.odometry = Some(odometry.clone());
            stay.at = Some(at);
        }
        self.anchor = Some(Anchor { place, odometry: odometry.clone(), at });
    }

    fn left_lately(&self, guard_frames: u64) -> impl Iterator<Item = &LeftPlace> {
        self.left.iter().filter(move |left| self.frames - left.number < guard_frames)
    }

    fn arrive(&mut self, place: PlaceId, event: &FrameEvent, guard_frames: u64) {
        let number = self.frames;
        let looks = self.looks_of_stay(place, guard_frames) + u32::from(event.learnt);
        let odometry = event.odometry.clone();
        let at = event.at;
        let before = self.stay.replace(Stay { place, looks, odometry, at });
        if let Some(before) = before.filter(|before| before.place != place) {
            self.left.retain(|left| left.place != place && number - left.number < guard_frames);
            self.left.push_back(LeftPlace { place: before.place, number, looks: before.looks });
        }
    }
}
