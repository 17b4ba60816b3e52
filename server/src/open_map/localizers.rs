//! Robots that only look: kept in memory, never in the log.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Weak};
use std::time::Instant;

use crate::ingest::{FeatureRecord, Tracker};
use fabmap::recognizer::{Stage, StageObserver};
use tokio::sync::OwnedSemaphorePermit;
use tokio_util::sync::CancellationToken;
use topomap::mapper::{FrameInput, Localizer};

use super::answers::FrameAnswer;
use super::requests::{
    FrameFailure, FrameRequest, FrameSource, FrameWork, LocalizerId, OpenedSession, StreamOpening,
};
use super::views::{SeenFeatures, compared};
use super::{MapWriter, StageClock, not_stored};
use crate::error::ServiceError;
use crate::ingest::intrinsics::Intrinsics;
use crate::metrics::FrameTimings;

/// Answers that are kept of each, for frames that are sent again.
const KEPT_ANSWERS: usize = 100;

/// Robots that may look at one map; for a further one, that without a stream which has been silent for longest
/// is forgotten.
const MAX_LOCALIZERS: usize = 256;

/// The robots that look at a map.
#[derive(Debug, Default)]
pub(super) struct Localizers {
    localizers: HashMap<LocalizerId, Localizing>,
    /// Counts frames and openings: the order in which localizers were last heard of.
    heard: u64,
}

#[derive(Debug)]
struct Localizing {
    name: String,
    /// Name of the token that opened it, if one did.
    owner: Option<String>,
    /// Of the robot, as it said; empty if it did not.
    run: String,
    /// Of its camera, where geometry can use it.
    intrinsics: Option<Intrinsics>,
    localizer: Localizer,
    tracker: Tracker,
    /// The latest ones, oldest first.
    answers: VecDeque<FrameAnswer>,
    /// The latest stream, and how to tell it that a later one took over.
    stream: u64,
    taken_over: CancellationToken,
    /// There for as long as the latest stream is open.
    room: Weak<OwnedSemaphorePermit>,
    last_heard: u64,
}

impl Localizers {
    pub(super) fn is_taken(&self, name: &str) -> bool {
        self.localizers.values().any(|localizing| localizing.name == name)
    }

    /// Whether a stream is open by which a robot localizes.
    pub(super) fn any_open(&self) -> bool {
        self.localizers.values().any(Localizing::is_open)
    }

    fn by_name(&mut self, name: &str) -> Option<(LocalizerId, &mut Localizing)> {
        let found = self.localizers.iter_mut().find(|(_, localizing)| localizing.name == name);
        found.map(|(&id, localizing)| (id, localizing))
    }

    /// Frees a name, forgetting what localized by it before; not one that a stream is open by. Whether it is free.
    pub(super) fn free(&mut self, name: &str) -> bool {
        match self.by_name(name) {
            Some((_, localizing)) if localizing.is_open() => false,
            Some((id, _)) => self.localizers.remove(&id).is_some(),
            None => true,
        }
    }

    fn add(&mut self, localizing: Localizing) -> Result<LocalizerId, ServiceError> {
        if self.localizers.len() >= MAX_LOCALIZERS {
            let without_stream = self.localizers.iter().filter(|(_, localizing)| !localizing.is_open());
            let Some((&id, _)) = without_stream.min_by_key(|(_, localizing)| localizing.last_heard) else {
                return Err(ServiceError::ResourceExhausted {
                    message: format!(
                        "{MAX_LOCALIZERS} robots localize in this map, as many as may at a time; end one of their \
                         streams, or ask again when one has ended"
                    ),
                });
            };
            self.localizers.remove(&id);
        }
        let id = localizing.stream;
        self.localizers.insert(id, localizing);
        Ok(id)
    }
}

impl MapWriter {
    pub(super) fn open_localizer(
        &mut self,
        name: String,
        intrinsics: Option<Intrinsics>,
        opening: StreamOpening,
    ) -> Result<OpenedSession, ServiceError> {
        let StreamOpening { opener, run, stream, taken_over, room } = opening;
        if self.sessions.iter().any(|session| session.name == name) {
            return Err(ServiceError::precondition(format_args!(
                "the map has a session {name} that let it grow; choose another name for localizing"
            )));
        }
        self.localizers.heard += 1;
        let last_heard = self.localizers.heard;
        let noise = self.mapper.settings().odometry_noise;
        let (id, last_committed) = match self.localizers.by_name(&name) {
            Some((id, localizing)) => {
                // Nothing is left behind by it: a name that no stream is open by is anybody's.
                if localizing.is_open() {
                    opener.check(&name, localizing.owner.as_deref())?;
                }
                localizing.owner = opener.token;
                if localizing.stream > stream {
                    taken_over.cancel();
                } else {
                    localizing.taken_over.cancel();
                    (localizing.stream, localizing.taken_over, localizing.room) = (stream, taken_over, room);
                    if !run.is_empty() && localizing.run != run {
                        (localizing.localizer, localizing.run) = (Localizer::new(), run);
                        localizing.intrinsics = intrinsics;
                        localizing.tracker = Tracker::new(noise);
                        localizing.answers.clear();
                    }
                }
                localizing.last_heard = last_heard;
                (id, localizing.localizer.last_sequence())
            }
            None => {
                let localizer = Localizer::new();
                let answers = VecDeque::new();
                let name = name.clone();
                let localizing = Localizing {
                    name,
                    owner: opener.token,
                    run,
                    intrinsics,
                    localizer,
                    tracker: Tracker::new(noise),
                    answers,
                    stream,
                    taken_over,
                    room,
                    last_heard,
                };
                (self.localizers.add(localizing)?, None)
            }
        };
        Ok(OpenedSession { source: FrameSource::Localizer(id), name, owner: None, last_committed })
    }

    /// Says where a robot is, and remembers it for the robot's next frame alone.
    pub(super) fn localize(&mut self, id: LocalizerId, request: FrameRequest) {
        let FrameRequest { stream, work, reply, since } = request;
        let answer = self.localized(id, stream, work, since);
        let _ = reply.send(answer);
    }

    fn localized(
        &mut self,
        id: LocalizerId,
        stream: u64,
        work: FrameWork,
        since: Instant,
    ) -> Result<FrameAnswer, FrameFailure> {
        let Some(localizing) = self.localizers.localizers.get(&id) else {
            // A session is not forgotten for another's sake while it has a stream.
            let message = "the map was opened anew and localizing begins anew; open the session again";
            return Err(FrameFailure::Ended(ServiceError::unavailable(message)));
        };
        if localizing.stream > stream {
            return Err(FrameFailure::Ended(ServiceError::taken_over()));
        }
        let sequence = work.sequence();
        if localizing.localizer.last_sequence().is_some_and(|last| sequence <= last) {
            return localizing.stored(sequence);
        }
        let FrameWork::Fresh { input, features, media: _, note: _, mut timings, room: _ } = work else {
            return Err(not_stored());
        };
        let answer =
            self.localize_fresh(id, *input, features, &mut timings).map_err(FrameFailure::Refused)?;
        timings.total = since.elapsed();
        timings.commit = timings.total.saturating_sub(timings.work());
        let localizing = self.localizers.localizers.get(&id);
        let map_pose = localizing.and_then(|localizing| localizing.localizer.map_pose(&self.mapper));
        Ok(FrameAnswer { timings: Some(timings), map_pose, ..answer })
    }

    fn localize_fresh(
        &mut self,
        id: LocalizerId,
        input: FrameInput,
        features: Option<Arc<FeatureRecord>>,
        timings: &mut FrameTimings,
    ) -> Result<FrameAnswer, ServiceError> {
        let gone = || ServiceError::internal("a localizer went away under its frame");
        let Localizing { localizer, intrinsics, tracker, .. } =
            self.localizers.localizers.get(&id).ok_or_else(gone)?;
        let mut tracker = tracker.clone();
        let mut clock = StageClock::start(timings);
        let current = features.map(|features| {
            SeenFeatures::tracked(features, intrinsics.as_ref(), input.odometry.as_ref(), &mut tracker)
        });
        clock.tracked();
        let recognized = self.mapper.localize(localizer, input, &mut clock)?;
        let (proposed, comparisons) = compared(recognized, self, current.as_ref(), &self.verifier)?;
        if self.mapper.verifies() {
            clock.completed(Stage::Verification);
        }
        let event = proposed.decide(&comparisons)?.event;
        let answer = self.answer(&event, None)?;
        self.localizers.heard += 1;
        let last_heard = self.localizers.heard;
        let localizing = self.localizers.localizers.get_mut(&id).ok_or_else(gone)?;
        localizing.localizer.follow(&event, &self.mapper);
        localizing.tracker = tracker;
        localizing.last_heard = last_heard;
        localizing.answers.push_back(answer.clone());
        if localizing.answers.len() > KEPT_ANSWERS {
            localizing.answers.pop_front();
        }
        Ok(answer)
    }
}

impl Localizing {
    fn is_open(&self) -> bool {
        self.room.strong_count() > 0
    }

    /// The answer that a frame got.
    fn stored(&self, sequence: u64) -> Result<FrameAnswer, FrameFailure> {
        let found = self.answers.iter().find(|answer| answer.sequence == sequence);
        found.cloned().ok_or_else(|| {
            FrameFailure::Refused(ServiceError::precondition(format_args!(
                "sequence number {sequence} is not among the last {KEPT_ANSWERS} that this robot localized by; \
                 number frames upwards"
            )))
        })
    }
}
