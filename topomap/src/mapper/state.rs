//! The fold, and what it has come to.

use fabmap::appearance::{Appearance, PlaceId};
use std::sync::Arc;

use fabmap::explanation::Explanation;
use fabmap::look_alikes::Kinds;
use fabmap::model::{ContentHash, Model};
use fabmap::observation::Observation;
use fabmap::recognizer::{Recognition, Recognizer};

use super::FoldError;
use crate::evidence;
use crate::log::{FrameEvent, Link, MapEvent, MeasuredEvent};
use crate::map::{Map, Place, PlacePoses, Session};
use crate::settings::{MapperError, MapperSettings};

/// A map that grows: recognizer and place graph, driven by events.
///
/// A frame is decided in three steps that change nothing: [`Mapper::recognize`],
/// [`super::Recognized::propose`] and [`super::Proposed::decide`]. [`Mapper::apply`] is the fold.
/// The holder of the log commits between the two, or after both and before the robot is answered.
#[derive(Clone, Debug)]
pub struct Mapper {
    recognizer: Recognizer,
    map: Map,
    /// Derived from the map's links.
    poses: PlacePoses,
    links_followed: Followed,
    settings: MapperSettings,
    vocabulary_len: usize,
    look_alikes: LookAlikes,
}

/// What the model says of them.
#[derive(Clone, Debug)]
enum LookAlikes {
    Known(Arc<Kinds>),
    /// What the best one of any image is expected to show, in inliers.
    Unknown(f64),
}

/// Whether poses know of all links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Followed {
    Yes,
    /// A correction has taken some out: they are to be made anew.
    UpToCorrection,
}

impl Mapper {
    /// An empty map over `model`.
    ///
    /// # Errors
    /// [`MapperError`] if a setting is out of range.
    pub fn new(model: &Model, settings: MapperSettings) -> Result<Self, MapperError> {
        let MapperSettings { closure_threshold, looks_per_stay, max_speed_m_per_s, .. } = settings;
        if !(closure_threshold > 0.0 && closure_threshold <= 1.0) {
            return Err(MapperError::ClosureThreshold { value: closure_threshold });
        }
        if looks_per_stay == 0 {
            return Err(MapperError::LooksPerStay);
        }
        if max_speed_m_per_s.is_nan() || max_speed_m_per_s <= 0.0 {
            return Err(MapperError::MaxSpeed { value: max_speed_m_per_s });
        }
        settings.verification.check()?;
        settings.check_metric()?;
        let unknown = || LookAlikes::Unknown(evidence::of_unknown_kind(model.sampling_set()));
        let look_alikes = model.kinds().map_or_else(unknown, |kinds| LookAlikes::Known(Arc::new(kinds)));
        Ok(Self {
            recognizer: Recognizer::new(model, settings.recognizer)?,
            map: Map::default(),
            poses: PlacePoses::default(),
            links_followed: Followed::Yes,
            settings,
            vocabulary_len: model.vocabulary().len(),
            look_alikes,
        })
    }

    /// What the log's next event makes of the map, with poses that agree with all links.
    ///
    /// # Errors
    /// [`FoldError`] if it is not the next event of this map's log; nothing changes then.
    pub fn apply(&mut self, event: &MapEvent) -> Result<(), FoldError> {
        self.fold(event)?;
        self.relax();
        Ok(())
    }

    /// The fold alone, for the replay of a log: poses agree with the links after [`Mapper::relax`].
    ///
    /// # Errors
    /// See [`Mapper::apply`].
    pub fn fold(&mut self, event: &MapEvent) -> Result<(), FoldError> {
        self.check_next(event)?;
        match event {
            MapEvent::SessionOpened { session } => self.map.open_session(*session),
            MapEvent::Frame(event) => {
                match event.decision.place {
                    Some(place) if place.index() == self.recognizer.places() => {
                        self.recognizer.add_place(&Appearance::of(&event.observation));
                    }
                    Some(place) if event.learnt => self.recognizer.observe_place(place, &event.observation),
                    Some(_) | None => {}
                }
                if event.decision.place.is_some_and(|place| place.index() == self.map.places().len()) {
                    self.poses.add_place(event.session);
                }
                self.follow_link(event.link.as_ref());
                let number = self.map.session(event.session).map_or(0, |session| session.frames);
                let sightings = self.sightings(number, &event.candidates, event.odometry.as_ref());
                self.map.fold_frame(event, &self.settings, sightings);
            }
            MapEvent::Measured(event) => {
                self.follow_link(event.link.as_ref());
                self.map.fold_measured(event);
            }
            MapEvent::Corrected(event) => {
                self.map.fold_corrected(event, &self.settings);
                self.links_followed = Followed::UpToCorrection;
            }
        }
        Ok(())
    }

    /// Makes the poses of places agree with all links as well as they can, if a loop was closed
    /// since, or a link taken out.
    pub fn relax(&mut self) {
        if self.links_followed == Followed::UpToCorrection {
            let makers = self.poses.makers().to_vec();
            self.poses = PlacePoses::over(makers, self.map.standing_links(), &self.settings.odometry_noise);
            self.links_followed = Followed::Yes;
        }
        self.poses.relax(&self.settings.odometry_noise);
    }

    /// The place graph and the sessions.
    #[must_use]
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// The recognizer with the appearances of all places.
    #[must_use]
    pub fn recognizer(&self) -> &Recognizer {
        &self.recognizer
    }

    /// Poses of places.
    #[must_use]
    pub fn poses(&self) -> &PlacePoses {
        &self.poses
    }

    /// The settings in force.
    #[must_use]
    pub fn settings(&self) -> &MapperSettings {
        &self.settings
    }

    /// Words of the vocabulary that observations are made of.
    #[must_use]
    pub fn vocabulary_len(&self) -> usize {
        self.vocabulary_len
    }

    /// What the best look-alike of a frame of `session` is expected to show by itself, in inliers.
    pub(super) fn expected_look_alike_inliers(&self, session: &Session, observation: &Observation) -> f64 {
        let of_image = match &self.look_alikes {
            LookAlikes::Unknown(inliers) => *inliers,
            LookAlikes::Known(kinds) => {
                evidence::of_kind(kinds.of(observation), observation.len(), self.map.look_alikes())
            }
        };
        session.look_alikes.expected_inliers(of_image)
    }

    /// Memory that the map takes, in bytes, roughly.
    #[must_use]
    pub fn memory_bytes(&self) -> u64 {
        (self.recognizer.memory_bytes() + self.map.memory_bytes()) as u64
    }

    /// Why `place` got its posterior in `recognition`; see [`Recognizer::explain`].
    #[must_use]
    pub fn explain(
        &self,
        observation: &Observation,
        recognition: &Recognition,
        place: PlaceId,
        words: usize,
    ) -> Option<Explanation> {
        self.recognizer.explain(observation, recognition, place, words)
    }

    /// Hash of the state that the log decided; see [`Map::state_hash`].
    #[must_use]
    pub fn state_hash(&self) -> ContentHash {
        self.map.state_hash(self.recognizer.index().appearances())
    }

    pub(crate) fn index_places(&mut self, appearances: impl IntoIterator<Item = Appearance>) {
        self.recognizer.add_places(appearances);
    }

    pub(crate) fn take_map(&mut self, map: Map) {
        let maker = |place: &Place| place.frames.first().map_or(0, |frame| frame.session);
        let makers = map.places().iter().map(maker);
        self.poses = PlacePoses::over(makers, map.standing_links(), &self.settings.odometry_noise);
        self.map = map;
    }

    /// Takes a link into the poses that the map is about to get.
    fn follow_link(&mut self, link: Option<&Link>) {
        if let Some(link) = link.filter(|_| self.links_followed == Followed::Yes) {
            self.poses.add_link(self.map.links().len(), link, &self.settings.odometry_noise);
        }
    }

    fn check_next(&self, event: &MapEvent) -> Result<(), FoldError> {
        let expected = self.map.events();
        match event {
            MapEvent::SessionOpened { session } if *session == self.map.next_session() => Ok(()),
            MapEvent::SessionOpened { session } => Err(FoldError::Session { session: *session }),
            MapEvent::Frame(event) => {
                let FrameEvent { frame, session, decision, learnt, link, observation, .. } = event.as_ref();
                let places = self.recognizer.places() as u64;
                let created = decision.place.is_some_and(|place| u64::from(place) == places);
                let known = |place: PlaceId| u64::from(place) < places + u64::from(created);
                let foreign_word =
                    observation.words().last().filter(|&&word| word.index() >= self.vocabulary_len);
                if *frame != expected {
                    Err(FoldError::Position { expected, found: *frame })
                } else if self.map.session(*session).is_none() {
                    Err(FoldError::Session { session: *session })
                } else if let Some(place) =
                    decision.place.filter(|&place| !known(place) || (created && !learnt))
                {
                    Err(FoldError::Place { place })
                } else if let Some(place) =
                    link.and_then(|link| [link.from, link.to].into_iter().find(|&place| !known(place)))
                {
                    Err(FoldError::Place { place })
                } else if let Some(&word) = foreign_word {
                    Err(FoldError::Word { word })
                } else {
                    Ok(())
                }
            }
            MapEvent::Corrected(event) => self.check_correction(event),
            MapEvent::Measured(event) => {
                let MeasuredEvent { position, session, frame, earlier, place, link, goes_on_from, .. } =
                    event.as_ref();
                let places = self.map.places().len();
                let ends = link.map(|link| [link.from, link.to]).into_iter().flatten();
                let unknown = ends.chain([*place]).find(|&place| place.index() >= places);
                let at = |session: &Session| session.stay.as_ref().map(|stay| stay.place);
                match (self.map.session(*session), unknown) {
                    _ if *position != expected || frame.max(earlier) >= position => {
                        Err(FoldError::Position { expected, found: *position })
                    }
                    (None, _) => Err(FoldError::Session { session: *session }),
                    (_, Some(place)) => Err(FoldError::Place { place }),
                    (Some(known), None) if goes_on_from.is_some() && at(known) != Some(*place) => {
                        Err(FoldError::Place { place: *place })
                    }
                    (Some(_), None) => Ok(()),
                }
            }
        }
    }
}
