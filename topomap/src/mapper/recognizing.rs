//! The first step of a frame: it is recognised, and the earlier frames are named that it is to be
//! compared with.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use fabmap::appearance::PlaceId;
use fabmap::observation::Observation;
use fabmap::place_filter::MotionPrior;
use fabmap::recognizer::{Association, StageObserver};

use super::FrameError;
use super::frame::{FrameInHand, FrameInput, Growth};
use super::localizer::Localizer;
use super::state::Mapper;
use crate::evidence::VerificationSettings;
use crate::ids::FrameId;
use crate::map::Session;
use crate::metric::RelativePose;

/// Links from where the last frame was within which this one is expected: a way or two further on,
/// or back.
const EXPECTED_LINKS: usize = 2;

/// How many of the places compared are expected ones; the others are the most probable anywhere.
const EXPECTED_CANDIDATES: usize = VerificationSettings::MAX_CANDIDATES / 2;

/// Frames of a place that one frame is compared with, the latest: a place learns a few a visit.
const MAX_COMPARED_FRAMES: usize = 32;

/// What an earlier frame showed, and where.
#[derive(Clone, Debug, PartialEq)]
pub struct EarlierFrame {
    /// Its words.
    pub observation: Observation,
    /// Where in its place's frame the robot was ([`crate::log::FrameEvent::at`]); `None` if that
    /// was not measured.
    pub at: Option<RelativePose>,
}

/// Earlier frames by their ids. One that is lost for good is left out, and not compared.
pub type EarlierFrames = BTreeMap<FrameId, EarlierFrame>;

/// A frame that was recognised: it waits for what the earlier frames showed that it may match.
#[derive(Clone, Debug)]
pub struct Recognized<'a> {
    pub(super) frame: FrameInHand<'a>,
    /// Places that the frame's view is compared with, at most
    /// [`VerificationSettings::MAX_CANDIDATES`].
    pub(super) compared: Vec<PlaceId>,
    /// All places that the best matching frame is looked for of, each with its frames, latest
    /// first.
    pub(super) wanted: BTreeMap<PlaceId, Vec<FrameId>>,
}

impl Mapper {
    /// Recognises a frame of a session of the log. Nothing changes.
    ///
    /// # Errors
    /// [`FrameError`] if the frame cannot be taken.
    pub fn recognize(
        &self,
        input: FrameInput,
        observer: &mut dyn StageObserver,
    ) -> Result<Recognized<'_>, FrameError> {
        let unknown = FrameError::UnknownSession { session: input.session };
        let session = Cow::Borrowed(self.map().session(input.session).ok_or(unknown)?);
        self.recognize_within(Growth::Grows, session, input, observer)
    }

    /// Recognises a frame of a robot that leaves nothing behind: no place is created or learnt, no
    /// link added. What is decided is not for the log; it is what [`Localizer::follow`] goes on
    /// from.
    ///
    /// # Errors
    /// [`FrameError`] if the frame cannot be taken.
    pub fn localize<'a>(
        &'a self,
        localizer: &'a Localizer,
        input: FrameInput,
        observer: &mut dyn StageObserver,
    ) -> Result<Recognized<'a>, FrameError> {
        self.recognize_within(Growth::ReadOnly, Cow::Borrowed(&localizer.session), input, observer)
    }

    /// The same for a robot that may be anywhere: [`Mapper::localize`] by a new [`Localizer`].
    ///
    /// # Errors
    /// [`FrameError`] if the frame cannot be taken.
    pub fn localize_anywhere(
        &self,
        input: FrameInput,
        observer: &mut dyn StageObserver,
    ) -> Result<Recognized<'_>, FrameError> {
        self.recognize_within(Growth::ReadOnly, Cow::Owned(Session::new()), input, observer)
    }

    /// Recognises one observation as if every place were as likely beforehand;
    /// [`Proposed::answer`](super::Proposed::answer) ends it.
    ///
    /// # Errors
    /// [`FrameError::ForeignWord`].
    pub fn query(
        &self,
        observation: Observation,
        observer: &mut dyn StageObserver,
    ) -> Result<Recognized<'_>, FrameError> {
        let sequence = 0;
        let stamp_ns = 0;
        let input =
            FrameInput { session: Localizer::SESSION, sequence, stamp_ns, odometry: None, observation };
        self.check_words(&input.observation)?;
        let session = Cow::Owned(Session::new());
        Ok(self.recognize_with(&MotionPrior::even(), Growth::ReadOnly, session, input, observer))
    }

    fn recognize_within<'a>(
        &'a self,
        growth: Growth,
        session: Cow<'a, Session>,
        input: FrameInput,
        observer: &mut dyn StageObserver,
    ) -> Result<Recognized<'a>, FrameError> {
        self.accept(&input, &session)?;
        let prior = self.motion_prior(&session, input.odometry.as_ref());
        Ok(self.recognize_with(&prior, growth, session, input, observer))
    }

    fn recognize_with<'a>(
        &'a self,
        prior: &MotionPrior,
        growth: Growth,
        session: Cow<'a, Session>,
        input: FrameInput,
        observer: &mut dyn StageObserver,
    ) -> Recognized<'a> {
        let recognition = self.recognizer().recognize_observed(&input.observation, prior, observer);
        let association = recognition.association();
        let looks = self.verifies() && input.observation.len() >= self.settings().min_words;
        let look_alike_inliers =
            looks.then(|| self.expected_look_alike_inliers(&session, &input.observation));
        let mapper = self;
        let frame =
            FrameInHand { mapper, session, growth, input, recognition, association, look_alike_inliers };
        if frame.shows_too_little() {
            return Recognized { frame, compared: Vec::new(), wanted: BTreeMap::new() };
        }
        let compared = frame.places_to_compare();
        let proposed = if compared.is_empty() { frame.most_probable_before_guard() } else { None };
        let seen = match association {
            Association::Seen(place) => Some(place),
            Association::New => None,
        };
        let places: BTreeSet<PlaceId> = compared.iter().copied().chain(proposed).chain(seen).collect();
        let frames_of =
            |place| (place, frame.frames_before_guard(place).take(MAX_COMPARED_FRAMES).collect::<Vec<_>>());
        let wanted = places.into_iter().map(frames_of).collect();
        Recognized { frame, compared, wanted }
    }
}

impl Recognized<'_> {
    /// The earlier frames whose words are wanted to go on, each once.
    pub fn wanted_frames(&self) -> impl Iterator<Item = FrameId> {
        self.wanted.values().flatten().copied()
    }
}

impl FrameInHand<'_> {
    /// At most [`VerificationSettings::MAX_CANDIDATES`] places known from before the guard, each
    /// once: the expected ones and the most probable ones; none if nothing is verified.
    fn places_to_compare(&self) -> Vec<PlaceId> {
        let settings = self.mapper.settings();
        if !self.mapper.verifies() {
            return Vec::new();
        }
        let posterior = &self.recognition.posterior.places;
        let may_be = |place: PlaceId| {
            posterior[place as usize] >= settings.verification.min_posterior
                && self.frames_before_guard(place).next().is_some()
        };
        let mut places: Vec<PlaceId> = self.expected().into_iter().filter(|&place| may_be(place)).collect();
        places.sort_by(|&a, &b| posterior[b as usize].total_cmp(&posterior[a as usize]).then(a.cmp(&b)));
        places.truncate(EXPECTED_CANDIDATES);

        // Places within the guard are the most probable of all and not to be compared: the one where
        // the session is, and those that it left.
        let guarded = self.session.left.len() + 1;
        let enough = guarded.saturating_add(2 * VerificationSettings::MAX_CANDIDATES).min(posterior.len());
        for (place, _) in self.recognition.posterior.top(enough) {
            if places.len() == VerificationSettings::MAX_CANDIDATES {
                break;
            }
            if !places.contains(&place) && may_be(place) {
                places.push(place);
            }
        }
        places
    }

    /// The places around the one that the session's last frame had most evidence for.
    fn expected(&self) -> BTreeSet<PlaceId> {
        let session = &self.session;
        let last = session.sightings.iter().filter(|sighting| sighting.number + 1 == session.frames);
        let strongest =
            last.max_by(|a, b| a.total_evidence.total_cmp(&b.total_evidence).then(b.place.cmp(&a.place)));
        let mut places: BTreeSet<PlaceId> = strongest.map(|sighting| sighting.place).into_iter().collect();
        for _ in 0..EXPECTED_LINKS {
            let linked: Vec<PlaceId> =
                places.iter().flat_map(|&place| self.mapper.map().linked(place)).copied().collect();
            places.extend(linked);
        }
        places
    }

    /// The most probable place known from before the guard; of equal ones the first.
    fn most_probable_before_guard(&self) -> Option<PlaceId> {
        let mut best: Option<(PlaceId, f64)> = None;
        for (place, &posterior) in (0..).zip(&self.recognition.posterior.places) {
            if best.is_none_or(|(_, best)| posterior > best)
                && self.frames_before_guard(place).next().is_some()
            {
                best = Some((place, posterior));
            }
        }
        best.map(|(place, _)| place)
    }
}
