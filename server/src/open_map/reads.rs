//! What is asked of a map without changing it.

use std::sync::Arc;

use crate::ingest::FeatureRecord;
use fabmap::appearance::PlaceId;
use fabmap::observation::{Observation, WordId};

use super::MapWriter;
use super::answers::{ANSWERED_PLACES, PlaceGraph, PlacePose, PlaceSummary, QueryAnswer, WordPlace};
use super::requests::{PlacesWanted, Read};
use super::views::{SeenFeatures, compared};
use crate::error::ServiceError;

/// Frames of one place that a list shows.
const MAX_LISTED_FRAMES: usize = 100;

impl MapWriter {
    /// Answers one question about the map as it is on the disk.
    pub(super) fn read(&mut self, read: Read) {
        // An error means that the caller is gone.
        match read {
            Read::Localize(localizer, request) => self.localize(localizer, request),
            Read::Query { observation, features, explained_words, reply } => {
                let _ = reply.send(self.query(&observation, features, explained_words));
            }
            Read::Look { request, reply } => {
                let _ = reply.send(self.look(*request));
            }
            Read::Plan { from, goal, settings, reply } => {
                let _ = reply.send(self.plan(from, goal, &settings));
            }
            Read::CheckGoal { goal, settings, reply } => {
                let _ = reply.send(self.check_goal(goal, &settings));
            }
            Read::StateHash { reply } => {
                let _ = reply.send(self.mapper.state_hash().to_string());
            }
            Read::Poses { reply } => {
                let _ = reply.send(Box::new(self.mapper.poses().clone()));
            }
            Read::PosesOf { places, reply } => {
                let poses = self.mapper.poses();
                let pose =
                    |place: PlaceId| Some(PlacePose { part: poses.part(place)?, pose: *poses.pose(place)? });
                let _ = reply.send(places.into_iter().map(pose).collect());
            }
            Read::Places { wanted, count, reply } => {
                let _ = reply.send(self.places(&wanted, count));
            }
            Read::PlaceOrder { reply } => {
                let model = self.mapper.recognizer().index().model().clone();
                let places = self.mapper.map().places().iter();
                let firsts =
                    places.map(|place| place.frames.first().map(|first| (first.session, first.frame)));
                let _ = reply.send((firsts.collect(), model));
            }
            Read::PlaceGraph { reply } => {
                let _ = reply.send(Box::new(self.place_graph()));
            }
            Read::UsualLooks { places, reply } => {
                let index = self.mapper.recognizer().index();
                let look = |place| index.appearance(place).unwrap_or_default().usual_look();
                let _ = reply.send(places.into_iter().map(look).collect());
            }
            Read::Place { place, reply } => {
                let _ = reply.send(self.place(place));
            }
            Read::WordPlaces { word, from, count, reply } => {
                let _ = reply.send(self.word_places(word, from, count));
            }
        }
    }

    fn query(
        &self,
        observation: &Observation,
        features: Option<Arc<FeatureRecord>>,
        explained_words: usize,
    ) -> Result<QueryAnswer, ServiceError> {
        // No session, no camera.
        let current = features.map(|features| SeenFeatures::new(features, None));
        let recognized = self.mapper.query(observation.clone(), &mut ())?;
        let (proposed, comparisons) = compared(recognized, self, current.as_ref(), &self.verifier)?;
        let queried = proposed.answer(&comparisons);
        let recognition = &queried.recognition;
        let best = recognition.posterior.best_place().filter(|_| explained_words > 0);
        Ok(QueryAnswer {
            places: recognition.posterior.top(ANSWERED_PLACES),
            new_place_posterior: recognition.posterior.new_place,
            matched: queried.matched.map(|found| self.matched(found, &queried.candidates)).transpose()?,
            accepted: queried.accepted,
            words: observation.len() as u64,
            explanation: best
                .and_then(|(place, _)| self.mapper.explain(observation, recognition, place, explained_words)),
        })
    }

    /// Up to `count` places that are wanted, and where the next one is.
    fn places(&self, wanted: &PlacesWanted, count: u32) -> (Vec<PlaceSummary>, Option<PlaceId>) {
        let PlacesWanted { from, to, every, within } = wanted;
        let total = self.mapper.map().places().len() as u32;
        let end = to.map_or(total, |to| total.min(to.number().saturating_add(1)));
        let first = from.number().checked_next_multiple_of(*every).unwrap_or(end);
        let is_within = |place: &PlaceId| {
            within.is_none_or(|within| self.place_pose(*place).is_some_and(|pose| within.has(&pose)))
        };
        let mut listed = (first..end).step_by(*every as usize).map(PlaceId::new).filter(is_within);
        let places = listed.by_ref().take(count as usize).filter_map(|place| self.place(place)).collect();
        (places, listed.next())
    }

    fn place_graph(&self) -> PlaceGraph {
        let map = self.mapper.map();
        let places = PlaceId::all().zip(map.places());
        let looks = places.flat_map(|(place, known)| {
            known.frames.iter().map(move |frame| (frame.session, frame.frame, place))
        });
        let links = map.standing_links().map(|(_, link)| (link.from, link.to));
        PlaceGraph { looks: looks.collect(), links: links.collect() }
    }

    fn place(&self, place: PlaceId) -> Option<PlaceSummary> {
        let map = self.mapper.map();
        let frames = &map.places().get(place.index())?.frames;
        let appearance = self.mapper.recognizer().index().appearance(place)?;
        let unlisted = frames.len().saturating_sub(MAX_LISTED_FRAMES);
        Some(PlaceSummary {
            place,
            looks: appearance.looks(),
            word_hits: appearance.word_hits().collect(),
            frames: frames[unlisted..].iter().map(|frame| frame.frame).collect(),
            linked: map.linked(place).to_vec(),
            pose: self.place_pose(place),
        })
    }

    fn place_pose(&self, place: PlaceId) -> Option<PlacePose> {
        let poses = self.mapper.poses();
        let part = poses.part(place)?;
        let pose = *poses.pose(place)?;
        poses.is_joined(place).then_some(PlacePose { part, pose })
    }

    /// Places from `from` on that have shown a word.
    fn word_places(&self, word: WordId, from: PlaceId, count: u32) -> Vec<WordPlace> {
        let index = self.mapper.recognizer().index();
        let places = index.places_with(word);
        let first = places.partition_point(|&place| place < from);
        let listed = places[first..].iter().take(count as usize);
        listed
            .filter_map(|&place| {
                let appearance = index.appearance(place)?;
                Some(WordPlace { place, hits: appearance.hits(word), looks: appearance.looks() })
            })
            .collect()
    }
}
