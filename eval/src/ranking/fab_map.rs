//! FAB-MAP with its map, through the very function that the server calls.

use fabmap::appearance::PlaceId;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::recognizer::Recognition;
use topomap::event::{Decision, FrameId, MapEvent, Match, SessionId};
use topomap::mapper::{ArchiveError, Decided, FrameInput, Mapper, MapperSettings};
use topomap::verification::{Candidate, TwoView, Views};
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::verification::{Verifier, View};

use super::{Proposal, Ranked, RankedDecision, Ranking};
use crate::error::EvalError;
use crate::event_log::EventLog;
use crate::timing::FrameWatch;

/// FAB-MAP over a map that grows with the sequence, in one session.
#[derive(Clone, Debug)]
pub struct FabMap {
    mapper: Mapper,
    log: EventLog,
    verifier: Verifier,
    /// Of all frames so far, by index in the sequence.
    features: Vec<FeatureRecord>,
}

/// The frame that is being decided, beside all before it.
struct CurrentView<'a> {
    current: &'a FeatureRecord,
    log: &'a EventLog,
    earlier: &'a [FeatureRecord],
    verifier: Verifier,
}

/// The one session that a sequence is run in.
const SESSION: SessionId = 0;

/// Sequences have no stamps; frames are held to be this far apart. Without odometry only their
/// order matters.
const FRAME_INTERVAL_NS: i64 = 1_000_000_000;

impl FabMap {
    /// An empty map with an open session.
    ///
    /// # Errors
    /// [`EvalError::Mapper`] if a setting is out of range.
    pub fn new(model: &Model, settings: MapperSettings, seed: u64) -> Result<Self, EvalError> {
        let mut mapper = Mapper::new(model, settings)?;
        let opened = MapEvent::SessionOpened { session: SESSION };
        mapper.apply(&opened).map_err(|reason| EvalError::Fold { index: 0, reason })?;
        let verifier = Verifier::new(settings.verification, seed);
        Ok(Self { mapper, log: EventLog(vec![opened]), verifier, features: Vec::new() })
    }

    /// The map so far.
    #[must_use]
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// What was decided so far.
    #[must_use]
    pub fn log(&self) -> &EventLog {
        &self.log
    }

    /// What the frames so far showed, by index in the sequence.
    #[must_use]
    pub fn features(&self) -> &[FeatureRecord] {
        &self.features
    }
}

impl Ranking for FabMap {
    fn rank(
        &mut self,
        index: usize,
        observation: Observation,
        features: FeatureRecord,
        mut watch: FrameWatch,
    ) -> Result<Ranked, EvalError> {
        let words = observation.len();
        let input = FrameInput {
            session: SESSION,
            sequence: index as u64,
            stamp_ns: FRAME_INTERVAL_NS.saturating_mul(i64::try_from(index).unwrap_or(i64::MAX)),
            odometry: None,
            observation,
        };
        let Self { log, verifier, .. } = &*self;
        let views = CurrentView { current: &features, log, earlier: &self.features, verifier: *verifier };
        let Decided { event, recognition } = self
            .mapper
            .decide(input, &self.log, &views, &mut watch)
            .map_err(|reason| EvalError::Frame { index, reason })?;
        let (decision, proposal, new_place_posterior) =
            (event.decision, event.proposal, event.new_place_posterior);
        let candidates = event.candidates.clone();
        let event = MapEvent::Frame(Box::new(event));
        self.mapper.apply(&event).map_err(|reason| EvalError::Fold { index, reason })?;
        let times = watch.stop();

        let Decision { reason, place, posterior, closure } = decision;
        let closure = closure.and_then(|matched| self.log.proposal(matched, &candidates));
        let inliers = proposal
            .and_then(|proposal| candidate_of(&candidates, proposal.frame))
            .and_then(|candidate| candidate.view.map(|view| view.inliers));
        let ranked = Ranked {
            words,
            proposal: proposal.and_then(|matched| self.log.proposal(matched, &candidates)),
            decision: Some(RankedDecision {
                reason,
                place,
                posterior,
                new_place_posterior,
                closure,
                inliers,
            }),
            similarities: self
                .log
                .frames()
                .map(|earlier| posterior_of(earlier.decision.place, &recognition))
                .collect(),
            times,
        };
        self.log.0.push(event);
        self.features.push(features);
        Ok(ranked)
    }

    fn places(&self) -> Option<usize> {
        Some(self.mapper.map().places().len())
    }
}

/// The posterior of the place that an earlier frame was assigned to; 0 if it was to none.
fn posterior_of(place: Option<PlaceId>, recognition: &Recognition) -> f64 {
    place.and_then(|place| recognition.posterior.places.get(place as usize)).copied().unwrap_or(0.0)
}

impl EventLog {
    /// The index in the sequence is the sequence number that the frame was sent with.
    fn proposal(&self, matched: Match, candidates: &[Candidate]) -> Option<Proposal> {
        let Match { place: _, posterior, log_odds, frame } = matched;
        let index = usize::try_from(self.frame(frame)?.sequence).ok()?;
        let candidate = candidate_of(candidates, frame);
        let score = candidate.map_or(log_odds, Candidate::score);
        let probability = Some(candidate.map_or(posterior, Candidate::probability));
        Some(Proposal { frame: index, score, posterior: Some(posterior), probability })
    }
}

fn candidate_of(candidates: &[Candidate], frame: FrameId) -> Option<&Candidate> {
    candidates.iter().find(|candidate| candidate.matched.frame == frame)
}

impl Views for CurrentView<'_> {
    fn compare(&self, earlier: FrameId) -> Result<Option<TwoView>, ArchiveError> {
        let index = self.log.frame(earlier).and_then(|event| usize::try_from(event.sequence).ok());
        let Some(earlier) = index.and_then(|index| self.earlier.get(index)) else {
            return Err(ArchiveError { frame: earlier, why: "it is not in the log".to_owned() });
        };
        let view = |features| View { features, camera: None };
        Ok(Some(self.verifier.compare(view(earlier), view(self.current))))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        None
    }
}
