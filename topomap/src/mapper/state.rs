//! The fold, and the map's state to and from checkpoints.

use fabmap::appearance::{Appearance, PlaceId};
use fabmap::explanation::Explanation;
use fabmap::model::{ContentHash, Model};
use fabmap::observation::Observation;
use fabmap::recognizer::{Recognition, Recognizer};

use super::{FoldError, Mapper, MapperSettings, RestoreError};
use crate::event::{FrameEvent, MapEvent};
use crate::map::{Map, Place, decode_place, encode_place};

impl Mapper {
    /// The fold: what the log's next event makes of the map.
    ///
    /// # Errors
    /// [`FoldError`] if it is not the next event of this map's log; nothing changes then.
    pub fn apply(&mut self, event: &MapEvent) -> Result<(), FoldError> {
        self.check_next(event)?;
        match event {
            MapEvent::SessionOpened { session } => self.map.open_session(*session),
            MapEvent::Frame(event) => {
                match event.decision.place {
                    Some(place) if place as usize == self.recognizer.places() => {
                        self.recognizer.add_place(&Appearance::of(&event.observation));
                    }
                    Some(place) if event.learnt => self.recognizer.observe_place(place, &event.observation),
                    Some(_) | None => {}
                }
                let number = self.map.session(event.session).map_or(0, |session| session.frames);
                let sightings = self.sightings(number, &event.candidates);
                self.map.fold_frame(event, &self.settings, sightings);
            }
        }
        Ok(())
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

    /// The settings in force.
    #[must_use]
    pub fn settings(&self) -> &MapperSettings {
        &self.settings
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

    /// The byte form of one place, for a checkpoint; `None` if there is no such place.
    #[must_use]
    pub fn encode_place(&self, place: PlaceId) -> Option<Vec<u8>> {
        let appearance = self.recognizer.index().appearance(place)?;
        Some(encode_place(self.map.places().get(place as usize)?, &appearance))
    }

    /// Opens a map from a checkpoint: the byte forms of all places in order, and of the graph.
    ///
    /// # Errors
    /// [`RestoreError`] if they are damaged or do not belong together.
    pub fn restore<'a>(
        model: &Model,
        settings: MapperSettings,
        places: impl IntoIterator<Item = &'a [u8]>,
        graph: &[u8],
    ) -> Result<Self, RestoreError> {
        let mut mapper = Self::new(model, settings)?;
        let mut restored: Vec<Place> = Vec::new();
        let (vocabulary_len, mut damage) = (mapper.vocabulary_len, None);
        let appearances = places.into_iter().map_while(|bytes| match decode_place(bytes, vocabulary_len) {
            Ok((place, appearance)) => {
                restored.push(place);
                Some(appearance)
            }
            Err(error) => {
                damage = Some(error);
                None
            }
        });
        mapper.recognizer.add_places(appearances);
        if let Some(error) = damage {
            return Err(error.into());
        }
        mapper.map = Map::decode_graph(graph, restored)?;
        Ok(mapper)
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
                    observation.words().last().filter(|&&word| word as usize >= self.vocabulary_len);
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
        }
    }
}
