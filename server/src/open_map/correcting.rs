//! What people say of loop closures goes into the log.

use std::sync::Arc;

use topomap::evidence::VerificationMethod;
use topomap::ids::FrameId;
use topomap::log::{CorrectionEvent, FrameEvent, MapEvent, MeasuredEvent};
use topomap::mapper::{CorrectError, Heard, Said, SamePlace};

use super::requests::{CorrectionRequest, Verdict};
use super::views::{FrameStore, SeenFeatures, compare, steering_verifier};
use super::{CommitFailed, MapWriter, no_such_map};
use crate::error::ServiceError;
use crate::storage::LogEntry;

/// Frames of a session that are read at a time.
const PAGE: u32 = 100;

impl MapWriter {
    /// Decides, stores and applies.
    pub(super) fn correct(
        &mut self,
        request: &CorrectionRequest,
    ) -> Result<Result<CorrectionEvent, ServiceError>, CommitFailed> {
        let event = match self.decide_correction(request) {
            Ok(event) => event,
            Err(error) => return Ok(Err(error)),
        };
        if let Err(damaged) = self.storage.check_sound(self.map.id) {
            return Ok(Err(damaged.into()));
        }
        let position = event.position;
        let logged = MapEvent::Corrected(Box::new(event.clone()));
        self.take_in(&LogEntry { position, event: logged, media: Vec::new(), note: String::new() })?;
        Ok(Ok(event))
    }

    /// Stores and applies what is no frame.
    pub(super) fn take_in(&mut self, entry: &LogEntry) -> Result<(), CommitFailed> {
        let entries = Arc::from([entry.clone()]);
        if let Err(error) = self.runtime.block_on(self.storage.append(self.map.id, entries)) {
            tracing::error!(map = self.map.name, %error, "an event could not be stored");
            return Err(CommitFailed::default());
        }
        if let Err(error) = self.mapper.apply(&entry.event) {
            tracing::error!(map = self.map.name, %error, "an event could not be applied");
            return Err(CommitFailed::default());
        }
        self.checkpoints.changes().follow(&entry.event);
        Ok(())
    }

    fn decide_correction(&self, request: &CorrectionRequest) -> Result<CorrectionEvent, ServiceError> {
        let CorrectionRequest { verdict, said } = request;
        let said = said.clone();
        match verdict {
            Verdict::Withdrawn { frame } => self.withdraw(&self.frame(*frame)?, said),
            Verdict::Confirmed { frame, matched } => {
                let later = self.frame(*frame)?;
                let earlier = self.frame(*matched)?;
                self.confirm(&later, &earlier, said)
            }
            Verdict::Undone { correction } => self.mapper.undo(*correction, said).map_err(refused),
        }
    }

    fn withdraw(&self, closure: &FrameEvent, said: Said) -> Result<CorrectionEvent, ServiceError> {
        let Self { storage, runtime, map, model, mapper, .. } = self;
        let words = model.model.vocabulary().len();
        let measured: Vec<MeasuredEvent> =
            runtime.block_on(storage.measured_of_session(map.id, closure.session, words))?;
        let mut visit = mapper.visit(closure, &measured).map_err(refused)?;
        let mut heard = Heard::More;
        let mut first = None;
        while heard == Heard::More {
            let before = storage.frames_before(map.id, first.as_ref().unwrap_or(closure), PAGE, words);
            let before = runtime.block_on(before)?;
            let Some(earliest) = before.last().cloned() else { break };
            first = Some(earliest);
            heard = heard_of(&before, |frame| visit.came_from(frame));
        }
        let mut heard = Heard::More;
        let mut last = None;
        while heard == Heard::More {
            let after = storage.frames_after(map.id, last.as_ref().unwrap_or(closure), PAGE, words);
            let after = runtime.block_on(after)?;
            let Some(latest) = after.last().cloned() else { break };
            last = Some(latest);
            heard = heard_of(&after, |frame| visit.went_on(frame));
        }
        visit.withdraw(said).map_err(refused)
    }

    fn confirm(
        &self,
        later: &FrameEvent,
        earlier: &FrameEvent,
        said: Said,
    ) -> Result<CorrectionEvent, ServiceError> {
        let seen = self.features(later.frame)?;
        let seen_earlier = self.features(earlier.frame)?;
        let settings = self.mapper.settings();
        let verifier = match settings.verification.method {
            // It has been asked for now.
            VerificationMethod::None => &steering_verifier(settings),
            VerificationMethod::Similarity | VerificationMethod::Epipolar => &self.verifier,
        };
        let view = seen.as_ref().zip(seen_earlier.as_ref());
        let view = view.map(|(current, earlier)| compare(verifier, earlier, current).view);
        let focal_length_widths = seen.as_ref().and_then(SeenFeatures::focal_length_widths);
        let pair = SamePlace { later, earlier, view, focal_length_widths };
        self.mapper.confirm(&pair, said).map_err(refused)
    }

    fn frame(&self, frame: FrameId) -> Result<FrameEvent, ServiceError> {
        let Self { storage, runtime, map, model, .. } = self;
        let words = model.model.vocabulary().len();
        match runtime.block_on(storage.event_at(map.id, frame, words))? {
            Some(MapEvent::Frame(event)) => Ok(*event),
            Some(MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_)) | None => {
                Err(no_such_map(&map.name))
            }
        }
    }
}

fn heard_of(frames: &[FrameEvent], mut tell: impl FnMut(&FrameEvent) -> Heard) -> Heard {
    let more = frames.iter().all(|frame| tell(frame) == Heard::More);
    if more { Heard::More } else { Heard::Enough }
}

fn refused(error: CorrectError) -> ServiceError {
    match error {
        CorrectError::Unknown { .. } => ServiceError::not_found(error),
        CorrectError::NotEarlier => ServiceError::invalid(error),
        CorrectError::NoClosure { .. }
        | CorrectError::Withdrawn { .. }
        | CorrectError::RestsOnIt { .. }
        | CorrectError::NoPlace { .. }
        | CorrectError::SamePlace { .. }
        | CorrectError::Confirmed { .. }
        | CorrectError::NoFeatures
        | CorrectError::Refused { .. }
        | CorrectError::Unmeasured
        | CorrectError::Later { .. } => ServiceError::precondition(error),
    }
}
