//! A frame beside another: what they have in common, for people to see.

mod drawing;

use std::collections::HashSet;

use fabmap::appearance::PlaceId;
use fabmap::observation::{Observation, WordId};
use tokio::runtime::Handle;
use topomap::evidence::{Match, Placement, VerificationMethod};
use topomap::ids::FrameId;
use topomap::log::{FrameEvent, MapEvent};
use topomap::settings::MapperSettings;

use self::drawing::{Kind, Mark, Panel, Picture, StillImage};
use super::corrections::{CorrectionView, Corrections};
use super::frames::{Frames, LocatedFrame, content_type};
use super::queries::{GateView, probability, verdict_views};
use crate::error::{ArchiveError, ServiceError};
use crate::ingest::{Comparison, FeatureRecord, Keypoint};
use crate::map_settings;
use crate::names::frame_name;
use crate::open_map::answers::reference;
use crate::open_map::{SeenFeatures, compare, stored_features, verifier};
use crate::storage::{MapRow, MediumKind, Storage, reason_name};

/// Frames of a place that the most alike is chosen from, the latest.
const MAX_FRAMES_OF_PLACE: u32 = 100;

/// As many as an explanation lists against a place.
const MAX_EXPECTED_WORDS: usize = 100;

/// What a frame is shown beside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Beside {
    /// What it was, or could have been, matched with.
    Matched,
    /// An earlier frame of a place: the one that it was compared with, or that has most words in common.
    Place(PlaceId),
    /// `maps/{map}/sessions/{session}/frames/{sequence}`, of any map with the same model.
    Frame(String),
}

impl Beside {
    /// `frame` is empty where none is asked for.
    pub(crate) fn asked(place: Option<u32>, frame: String) -> Result<Self, ServiceError> {
        match (place, frame) {
            (None, frame) if frame.is_empty() => Ok(Self::Matched),
            (Some(place), frame) if frame.is_empty() => Ok(Self::Place(PlaceId::new(place))),
            (None, frame) => Ok(Self::Frame(frame)),
            (Some(_), _) => Err(ServiceError::invalid(
                "a frame is shown beside one of a place or beside a frame that you name, not both; leave one of them out",
            )),
        }
    }
}

/// A picture that stands for itself: it refers to nothing outside.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FramePicture {
    pub(crate) content_type: &'static str,
    pub(crate) picture: Vec<u8>,
}

/// A frame with all that is kept of it.
struct ShownFrame {
    map: MapRow,
    name: String,
    /// What its robot calls it; empty if nothing.
    note: String,
    position: FrameId,
    event: FrameEvent,
    image: Option<StillImage>,
}

/// Frames beside others, drawn. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Pictures {
    pub(super) storage: Storage,
    pub(super) frames: Frames,
}

impl Pictures {
    /// A frame beside another. `expected` are words that the other was expected to have in common, and are marked.
    pub(crate) async fn frame(
        &self,
        name: &str,
        beside: Beside,
        expected: &[u32],
    ) -> Result<FramePicture, ServiceError> {
        let LocatedFrame { map, position } = self.frames.locate(name).await?;
        let expected = self.expected_words(&map, expected).await?;
        let current = self.shown_frame(&map, position).await?;
        let corrections = Corrections::read(&self.storage, map.id).await?;
        let of_frame = corrections.of_frames(&self.storage, &map, vec![position]).await?.remove(&position);
        let said: Vec<String> = of_frame.iter().flatten().map(CorrectionView::told).collect();
        let (place, other) = match beside {
            Beside::Matched => self.counterpart(&map, &current, None, &corrections).await?,
            Beside::Place(place) => self.counterpart(&map, &current, Some(place), &corrections).await?,
            Beside::Frame(name) => (None, self.other_frame(&map, &name).await?),
        };
        let settings = map_settings::from_json(&map.settings)?.mapper;
        let storage = self.storage.clone();
        let runtime = Handle::current();
        let drawing = tokio::task::spawn_blocking(move || {
            let features =
                |frame: &ShownFrame| stored_features(&runtime, &storage, frame.map.id, frame.position);
            let seen = [features(&current)?, features(&other)?];
            let mut picture = side_by_side([current, other], &seen, place, &expected, &settings);
            said.iter().for_each(|said| picture.heading.push_str(&format!("; {said}")));
            Ok::<_, ArchiveError>(picture.to_svg())
        });
        let svg = drawing.await.map_err(ServiceError::internal)??;
        Ok(FramePicture { content_type: "image/svg+xml", picture: svg.into_bytes() })
    }

    async fn expected_words(&self, map: &MapRow, words: &[u32]) -> Result<HashSet<WordId>, ServiceError> {
        if words.len() > MAX_EXPECTED_WORDS {
            return Err(ServiceError::invalid(format_args!(
                "at most {MAX_EXPECTED_WORDS} expected words are marked, not {}",
                words.len()
            )));
        }
        let known = self.frames.vocabulary_len(map).await?;
        match words.iter().find(|&&word| word as usize >= known) {
            Some(word) => Err(ServiceError::invalid(format_args!(
                "there is no word {word}: the map's model has the words 0 to {}",
                known.saturating_sub(1)
            ))),
            None => Ok(words.iter().map(|&word| WordId::new(word)).collect()),
        }
    }

    /// A frame that was asked for by name, to be shown beside one of `map`.
    async fn other_frame(&self, map: &MapRow, name: &str) -> Result<ShownFrame, ServiceError> {
        let LocatedFrame { map: other, position } = self.frames.locate(name).await?;
        if other.model != map.model {
            return Err(ServiceError::precondition(format_args!(
                "the maps {} and {} have different models, so that a word of the one is another of the other; \
                 show frames of maps with one model",
                map.name, other.name
            )));
        }
        self.shown_frame(&other, position).await
    }

    async fn shown_frame(&self, map: &MapRow, position: FrameId) -> Result<ShownFrame, ServiceError> {
        let event = self.frame_event(map, position).await?;
        let stored = self.storage.frames_at(map.id, &[position]).await?;
        let sessions = self.storage.sessions(map.id).await?;
        let reference = stored.first().map(|stored| reference(&map.name, &sessions, stored));
        let reference = reference.ok_or_else(|| deleted(map))?;
        let mut image = None;
        for kind in [MediumKind::Image, MediumKind::Thumbnail] {
            if image.is_none() {
                let bytes = self.storage.medium(map.id, position, kind).await?;
                image = bytes.map(|bytes| StillImage { content_type: content_type(&bytes), bytes });
            }
        }
        let name = frame_name(&reference.session, reference.sequence);
        Ok(ShownFrame { map: map.clone(), name, note: reference.note, position, event, image })
    }

    async fn frame_event(&self, map: &MapRow, position: FrameId) -> Result<FrameEvent, ServiceError> {
        let words = self.frames.vocabulary_len(map).await?;
        match self.storage.event_at(map.id, position, words).await? {
            Some(MapEvent::Frame(event)) => Ok(*event),
            Some(MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_)) | None => {
                Err(deleted(map))
            }
        }
    }

    /// The place, and the earlier frame of it that a frame is shown beside.
    async fn counterpart(
        &self,
        map: &MapRow,
        ShownFrame { name, event, .. }: &ShownFrame,
        place: Option<PlaceId>,
        corrections: &Corrections,
    ) -> Result<(Option<PlaceId>, ShownFrame), ServiceError> {
        let decided = event.decision.closure.or(event.proposal);
        let compared = match place {
            None => decided,
            Some(place) => compared(event).find(|matched| matched.place == place),
        };
        if let Some(Match { place, frame, .. }) = compared {
            return Ok((Some(place), self.shown_frame(map, frame).await?));
        }
        let Some(place) = place.or(event.decision.place) else {
            return Err(ServiceError::not_found(format_args!(
                "{name} showed too little to be compared with any place; name one to see it beside that"
            )));
        };
        let mut most_alike: Option<(usize, FrameId)> = None;
        let frames = self.storage.frames_of_place(map.id, place, event.frame, MAX_FRAMES_OF_PLACE).await?;
        for frame in frames.into_iter().filter(|&frame| !corrections.is_withdrawn(frame)) {
            let seen = self.frame_event(map, frame).await?.observation;
            let common = shared_words(&seen, &event.observation);
            if most_alike.is_none_or(|(most, _)| common > most) {
                most_alike = Some((common, frame));
            }
        }
        let (_, frame) = most_alike.ok_or_else(|| {
            ServiceError::not_found(format_args!(
                "no frame of place {place} was there when {name} came in; ask about an earlier place, or a later frame"
            ))
        })?;
        Ok((Some(place), self.shown_frame(map, frame).await?))
    }
}

/// A frame and another, with what the settings of the first one's map make of them. Where the other was looked for,
/// it is an earlier one of `place`.
fn side_by_side(
    [current, other]: [ShownFrame; 2],
    seen: &[Option<SeenFeatures>; 2],
    place: Option<PlaceId>,
    expected: &HashSet<WordId>,
    settings: &MapperSettings,
) -> Picture {
    let comparison = match (settings.verification.method, seen) {
        (VerificationMethod::Similarity | VerificationMethod::Epipolar, [Some(current), Some(other)]) => {
            Some(compare(&verifier(settings), other, current))
        }
        (VerificationMethod::None, _) | (_, [None, _] | [_, None]) => None,
    };
    let focal_length_widths = seen[0].as_ref().and_then(SeenFeatures::focal_length_widths);
    let settings = settings.for_frame(current.event.odometry.as_ref(), focal_length_widths);
    let ours = current.event.observation.clone();
    let theirs = other.event.observation.clone();
    Picture {
        heading: match place {
            Some(place) => heading(&current.event, place),
            None => "side by side: nothing was decided about these two together".to_owned(),
        },
        verdict: place.map(|place| verdict(&current.event, place, &settings)).unwrap_or_default(),
        summary: summary([&ours, &theirs], comparison.as_ref()),
        panels: [
            current.panel(seen[0].as_ref(), &theirs, &HashSet::new()),
            other.panel(seen[1].as_ref(), &ours, expected),
        ],
        joined: comparison.as_ref().map(joined).unwrap_or_default(),
    }
}

/// Matches that were looked at when a frame was decided.
fn compared(event: &FrameEvent) -> impl Iterator<Item = Match> {
    let candidates = event.candidates.iter().map(|candidate| candidate.matched);
    [event.decision.closure, event.proposal].into_iter().flatten().chain(candidates)
}

impl ShownFrame {
    /// `other` is what the frame beside it shows, and `expected` what that should have shown, too.
    fn panel(self, seen: Option<&SeenFeatures>, other: &Observation, expected: &HashSet<WordId>) -> Panel {
        let kind = |word| match (other.contains(word), expected.contains(&word)) {
            (true, _) => Kind::Common,
            (false, true) => Kind::Expected,
            (false, false) => Kind::Other,
        };
        let mark = |(keypoint, &word): (&Keypoint, &WordId)| Mark {
            x_px: f64::from(keypoint.x_px),
            y_px: f64::from(keypoint.y_px),
            word,
            kind: kind(word),
        };
        let features = seen.map(|seen| &*seen.features);
        let marks = features
            .map_or_else(Vec::new, |known| known.keypoints().iter().zip(known.words()).map(mark).collect());
        let no_image = "no image of it is kept: the robot sent words, or the map keeps words alone";
        let no_keypoints =
            "where its words are is not known: the robot sent counts, or the map keeps words alone";
        let notes = [self.image.is_none().then_some(no_image), features.is_none().then_some(no_keypoints)];
        Panel {
            title: if self.note.is_empty() { self.name } else { format!("{} ({})", self.name, self.note) },
            image: self.image,
            size_px: features.map(FeatureRecord::image_size_px),
            marks,
            notes: notes.into_iter().flatten().collect(),
        }
    }
}

fn heading(event: &FrameEvent, place: PlaceId) -> String {
    let reason = reason_name(event.decision.reason);
    let of_place = |matched: Match| matched.place == place;
    let posterior = match compared(event).find(|&matched| of_place(matched)) {
        Some(matched) => Some(matched.posterior),
        None if event.decision.place == Some(place) => Some(event.decision.posterior),
        None => {
            event.belief.places.iter().find(|(known, _)| *known == place).map(|&(_, posterior)| posterior)
        }
    };
    let posterior = posterior.map_or("small".to_owned(), probability);
    let new_place = probability(event.new_place_posterior);
    format!("{reason}: place {place}, posterior {posterior}; somewhere new {new_place}")
}

fn verdict(event: &FrameEvent, place: PlaceId, settings: &MapperSettings) -> Vec<GateView> {
    let candidate = event.candidates.iter().find(|candidate| candidate.matched.place == place);
    candidate.map(|candidate| verdict_views(settings, candidate)).unwrap_or_default()
}

/// Features that structure measured by, or else those that the motion of the view joins.
fn joined(comparison: &Comparison) -> Vec<[usize; 2]> {
    let Comparison { view: _, inliers, placed } = comparison;
    let shown = if placed.is_empty() { inliers } else { placed };
    shown.iter().map(|matched| [matched.current, matched.earlier]).collect()
}

fn summary([ours, theirs]: [&Observation; 2], comparison: Option<&Comparison>) -> String {
    let common = shared_words(ours, theirs);
    let words = format!("{common} words in common, of {} here and {} there", ours.len(), theirs.len());
    match comparison.map(|comparison| (comparison.view.placement, comparison.inliers.len())) {
        Some((Placement::At { pose, inliers }, _)) => {
            let sigma_m = pose.position_sigma_m();
            let pose = pose.pose();
            format!(
                "{words}; {inliers} features of known depth put the robot {:.2} m ahead of there and {:.2} m to the left, \
                 turned by {:.1} degrees, to {sigma_m:.2} m",
                pose.x_m(),
                pose.y_m(),
                pose.heading_rad().to_degrees()
            )
        }
        Some((Placement::Nowhere, _)) => {
            format!("{words}; features of known depth contradict each other: the robot was not near there")
        }
        None | Some((Placement::Unknown, 0)) => words,
        Some((Placement::Unknown, joined)) => format!("{words}; {joined} features joined by one motion"),
    }
}

fn shared_words(ours: &Observation, theirs: &Observation) -> usize {
    ours.words().iter().filter(|&&word| theirs.contains(word)).count()
}

fn deleted(map: &MapRow) -> ServiceError {
    ServiceError::not_found(format_args!("the map {} was deleted just now", map.name))
}
