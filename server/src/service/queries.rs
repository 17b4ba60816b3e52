//! Where something was seen, and why a frame was decided as it was.

mod gates;
mod odometry_agreement;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use fabmap::appearance::PlaceId;
use fabmap::explanation::Explanation;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use topomap::evidence::{Candidate, Placement};
use topomap::ids::FrameId;
use topomap::log::{FrameEvent, MapEvent, Reason};
use topomap::mapper::{Decided, EarlierFrame, FrameInput, Gate, Mapper};

use self::gates::{gate_views, out_of_reach_view, outdone_view};
pub(super) use self::gates::{probability, verdict_views};
pub(crate) use self::odometry_agreement::OdometryAgreement;
use self::odometry_agreement::SeenAgain;
use super::corrections::{CorrectionView, Corrections};
use super::frames::{Frames, LocatedFrame};
use super::tokens::Caller;
use crate::error::{ArchiveError, ServiceError};
use crate::ingest::content::{Content, Words};
use crate::ingest::extraction::Extraction;
use crate::ingest::model::{LoadedModel, LoadedModels};
use crate::map_settings::{self, Keep};
use crate::names::map_in;
pub(crate) use crate::open_map::answers::QueryAnswer;
use crate::open_map::{FrameStore, OpenMaps, SeenFeatures, compared, no_such_map, stored_features, verifier};
use crate::storage::{MapRow, Storage, StorageError};

/// Words for, and as many against, that an explanation lists at most.
const MAX_EXPLAINED_WORDS: u32 = 100;

const DEFAULT_EXPLAINED_WORDS: u32 = 10;

/// Why a frame was decided as it was.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FrameExplanation {
    /// `maps/{map}/sessions/{session}/frames/{sequence}`.
    pub(crate) name: String,
    pub(crate) reason: Reason,
    /// In the order of checking; empty if the map had no place yet.
    pub(crate) gates: Vec<GateView>,
    pub(crate) place: Option<Explanation>,
    /// Whether the replay came to the logged posteriors to the bit.
    pub(crate) reproduced: bool,
    /// Where REST has the frame beside the place; none if the map had no place yet.
    pub(crate) picture: Option<String>,
    /// None if nothing can be said of it.
    pub(crate) odometry: Option<OdometryAgreement>,
    /// What people have said of its place since, as far as it stands.
    pub(crate) corrections: Vec<CorrectionView>,
}

/// A condition for a loop closure.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GateView {
    pub(crate) name: &'static str,
    pub(crate) gate: Gate,
    pub(crate) description: String,
}

/// Queries and explanations. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Queries {
    storage: Storage,
    models: LoadedModels,
    open_maps: OpenMaps,
    extraction: Extraction,
    frames: Frames,
    /// One replay at a time: it takes as much memory as the map, and a core.
    replays: Arc<Semaphore>,
}

impl Queries {
    pub(super) fn new(frames: Frames, extraction: Extraction) -> Self {
        let Frames { storage, models, open_maps } = frames.clone();
        Self { storage, models, open_maps, extraction, frames, replays: Arc::new(Semaphore::new(1)) }
    }

    /// Where one image, or bag of words, was taken. Nothing is remembered of it.
    pub(crate) async fn query(
        &self,
        caller: &Caller,
        map: &str,
        content: Content,
        words_hash: &str,
        explained_words: Option<u32>,
    ) -> Result<QueryAnswer, ServiceError> {
        let map = map_in(map)?;
        let explained = explained_words_of(explained_words.unwrap_or(0))?;
        let row = self.open_maps.row(map).await?;
        let model = self.models.get(&row.model).await?;
        let words = Words::declared(words_hash, &model)?;
        let turn = self.storage.quotas().frame(caller.token.as_deref(), None, Instant::now())?;
        let observed = self.extraction.observe(model, content, words, Keep::Words, None, None).await;
        if !matches!(observed, Err(ServiceError::Unavailable { .. })) {
            turn.spend();
        }
        let observed = observed?;
        self.open_maps.open_of(&row).await?.query(observed.observation, observed.features, explained).await
    }

    /// Replays the map up to a frame and decides that frame again, this time telling why.
    pub(crate) async fn explain(
        &self,
        name: &str,
        place: Option<PlaceId>,
        max_words: Option<u32>,
    ) -> Result<FrameExplanation, ServiceError> {
        let words = explained_words_of(max_words.unwrap_or(DEFAULT_EXPLAINED_WORDS))?;
        let LocatedFrame { map, position } = self.frames.locate(name).await?;
        let model = self.model_then(&map, position).await?;
        let turn = self.replays.clone().acquire_owned().await.map_err(|_| ServiceError::stopping())?;
        let abandoned = CancellationToken::new();
        let name = name.to_owned();
        let _abandon = abandoned.clone().drop_guard();
        let read = map.clone();
        let replay =
            Replay { storage: self.storage.clone(), runtime: Handle::current(), map, model, abandoned };
        let explaining = tokio::task::spawn_blocking(move || {
            let _turn = turn;
            replay.explain(name, position, place, words)
        });
        let mut explained = explaining.await.map_err(ServiceError::internal)?;
        if let Ok(explanation) = &mut explained {
            let corrections = Corrections::read(&self.storage, read.id).await?;
            let mut of_frame = corrections.of_frames(&self.storage, &read, vec![position]).await?;
            explanation.corrections = of_frame.remove(&position).unwrap_or_default();
        }
        // Of a map that is deleted or rewritten meanwhile, some of what was read may be older than the rest.
        match self.storage.map_of_id(read.id).await? {
            Some(now) if now.edition == read.edition => explained,
            Some(_) => Err(ServiceError::Aborted {
                message: format!(
                    "the map {} was rewritten while the frame was explained; ask again",
                    read.name
                ),
            }),
            None => Err(no_such_map(&read.name)),
        }
    }

    /// The model that a map had when a frame was decided; the present one if that is gone.
    async fn model_then(&self, map: &MapRow, position: FrameId) -> Result<Arc<LoadedModel>, ServiceError> {
        if let Some(former) = self.storage.former_model(map.id, position).await? {
            match self.models.get(&former).await {
                Ok(model) => return Ok(model),
                Err(ServiceError::NotFound { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        self.models.get(&map.model).await
    }
}

fn explained_words_of(words: u32) -> Result<usize, ServiceError> {
    if words > MAX_EXPLAINED_WORDS {
        return Err(ServiceError::invalid(format_args!(
            "an explanation lists at most {MAX_EXPLAINED_WORDS} words for and as many against, not {words}"
        )));
    }
    Ok(words as usize)
}

/// A map as it was when one of its frames came in.
struct Replay {
    storage: Storage,
    runtime: Handle,
    map: MapRow,
    model: Arc<LoadedModel>,
    /// Nobody waits for the answer any more.
    abandoned: CancellationToken,
}

impl Replay {
    /// Blocks.
    fn explain(
        &self,
        name: String,
        position: FrameId,
        place: Option<PlaceId>,
        words: usize,
    ) -> Result<FrameExplanation, ServiceError> {
        let (mapper, before, event) = self.up_to(position)?;
        let input = FrameInput {
            session: event.session,
            sequence: event.sequence,
            stamp_ns: event.stamp_ns,
            odometry: event.odometry.clone(),
            observation: event.observation.clone(),
        };
        let current = self.features(position)?;
        let recognized = mapper.recognize(input.clone(), &mut ())?;
        let verifier = verifier(mapper.settings());
        let (proposed, comparisons) = compared(recognized, self, current.as_ref(), &verifier)?;
        let decided = proposed.decide(&comparisons)?;
        let explained = place.or_else(|| contested_place(&event, &decided));
        let places = mapper.recognizer().places();
        if let Some(place) = place.filter(|&place| place.index() >= places) {
            return Err(ServiceError::not_found(format_args!(
                "there was no place {place} when {name} came in, there were {places}; ask about an earlier one, \
                 or leave the place out"
            )));
        }
        let recognition = &decided.recognition;
        let gates = explained.and_then(|place| mapper.gates(&input, recognition, place));
        // As logged: the decision stands by what was found then.
        let candidate = event.candidates.iter().find(|candidate| Some(candidate.matched.place) == explained);
        let mut gates = gates.map(|gates| gate_views(&gates, candidate)).unwrap_or_default();
        let settings = mapper.settings().for_frame(input.odometry.as_ref(), comparisons.focal_length_widths);
        if let Some(candidate) = candidate {
            gates.extend(verdict_views(&settings, candidate));
            let stronger = mapper.outdone_by(candidate, &event.candidates);
            gates.extend(stronger.map(|stronger| outdone_view(candidate, stronger)));
            let out_of_reach = mapper.out_of_reach(&input, candidate.matched.place);
            gates.extend(out_of_reach.map(|out_of_reach| out_of_reach_view(&out_of_reach)));
        }
        let words = explained.and_then(|place| mapper.explain(&input.observation, recognition, place, words));
        Ok(FrameExplanation {
            picture: explained.map(|place| picture_path(&name, place, words.as_ref())),
            name,
            reason: event.decision.reason,
            gates,
            place: words,
            reproduced: decided.event == event,
            odometry: self.odometry_agreement(&mapper, before, event)?,
            corrections: Vec::new(),
        })
    }

    fn odometry_agreement(
        &self,
        mapper: &Mapper,
        before: VecDeque<FrameEvent>,
        event: FrameEvent,
    ) -> Result<Option<OdometryAgreement>, ServiceError> {
        let mut frames = Vec::from(before);
        frames.push(event);
        let seen = frames.iter().map(|event| self.features(event.frame)).collect::<Result<Vec<_>, _>>()?;
        let mut seen_again = Vec::new();
        for event in &frames {
            seen_again.extend(self.seen_again(mapper, event)?);
        }
        Ok(OdometryAgreement::of(mapper.settings().odometry_noise, &frames, &seen, &seen_again))
    }

    /// The earlier frame that a frame was accepted to be near to, if there is one and the way between
    /// them was measured.
    fn seen_again(&self, mapper: &Mapper, event: &FrameEvent) -> Result<Option<SeenAgain>, ServiceError> {
        let measured = |candidate: &Candidate| match candidate.view?.placement {
            Placement::At { pose, .. } => Some((candidate.matched.frame, pose)),
            Placement::Unknown | Placement::Nowhere => None,
        };
        let accepted = event.candidates.iter().filter(|candidate| mapper.verdict(candidate).is_accepted());
        let Some((frame, pose)) = accepted.filter_map(measured).next() else { return Ok(None) };
        let words = self.model.model.vocabulary().len();
        match self.runtime.block_on(self.storage.event_at(self.map.id, frame, words))? {
            Some(MapEvent::Frame(earlier)) => Ok(earlier
                .odometry
                .zip(event.odometry.clone())
                .map(|(then, now)| SeenAgain { session: earlier.session, then, now, pose })),
            Some(MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_)) | None => {
                Ok(None)
            }
        }
    }

    /// The map before the event at `position`, the last frames of its session before it, and that event.
    fn up_to(&self, position: FrameId) -> Result<(Mapper, VecDeque<FrameEvent>, FrameEvent), ServiceError> {
        let Self { storage, runtime, map, model, abandoned } = self;
        let settings = map_settings::from_json(&map.settings)?.mapper;
        let mut mapper = Mapper::new(&model.model, settings).map_err(ServiceError::internal)?;
        let words = model.model.vocabulary().len();
        let deleted = || no_such_map(&map.name);
        let event = match runtime.block_on(storage.event_at(map.id, position, words))? {
            Some(MapEvent::Frame(event)) => *event,
            Some(MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_)) | None => {
                return Err(deleted());
            }
        };
        let session = event.session;
        let mut before = VecDeque::new();
        let mut fold = |_: u64, event: MapEvent| {
            if abandoned.is_cancelled() {
                return Err(StorageError::Abandoned);
            }
            mapper.apply(&event).map_err(|error| StorageError::Damaged(error.to_string()))?;
            if let MapEvent::Frame(frame) = event
                && frame.session == session
            {
                before.push_back(*frame);
                if before.len() == odometry_agreement::MOST_FRAMES {
                    before.pop_front();
                }
            }
            Ok(())
        };
        runtime.block_on(storage.replay(map.id, 0..position, words, &mut fold))?;
        Ok((mapper, before, event))
    }
}

impl FrameStore for Replay {
    fn earlier_frame(&self, frame: FrameId) -> Result<Option<EarlierFrame>, ArchiveError> {
        let words = self.model.model.vocabulary().len();
        match self.runtime.block_on(self.storage.event_at(self.map.id, frame, words)) {
            Ok(Some(MapEvent::Frame(event))) => {
                Ok(Some(EarlierFrame { observation: event.observation, at: event.at }))
            }
            Ok(
                Some(MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_)) | None,
            )
            | Err(StorageError::Damaged(_)) => Ok(None),
            Err(error) => Err(ArchiveError::of(frame, error)),
        }
    }

    fn features(&self, frame: FrameId) -> Result<Option<SeenFeatures>, ArchiveError> {
        stored_features(&self.runtime, &self.storage, self.map.id, frame)
    }
}

/// Where REST has the frame beside a place, with the words marked that the place was expected to show.
fn picture_path(name: &str, place: PlaceId, explained: Option<&Explanation>) -> String {
    let against = explained.iter().flat_map(|explained| &explained.words_against);
    let expected: Vec<String> =
        against.filter(|evidence| !evidence.seen).map(|evidence| evidence.word.to_string()).collect();
    let marked =
        if expected.is_empty() { String::new() } else { format!("&expected_words={}", expected.join(",")) };
    format!("/v1/{name}/picture?place_number={place}{marked}")
}

/// The place that was matched, or else the one that came closest to it.
fn contested_place(event: &FrameEvent, decided: &Decided) -> Option<PlaceId> {
    let existing = |place: &PlaceId| place.index() < decided.recognition.posterior.places.len();
    let closure = event.decision.closure.map(|closure| closure.place);
    let best = || decided.recognition.posterior.best_place().map(|(place, _)| place);
    closure.or(event.decision.place.filter(existing)).or_else(best)
}
