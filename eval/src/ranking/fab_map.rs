//! FAB-MAP with its map, through the very function that the server calls.

use std::sync::Arc;

use anyhow::{Context, Result};
use fabmap::appearance::PlaceId;
use fabmap::model::Model;
use fabmap::recognizer::Recognition;
use topomap::evidence::{Candidate, Match};
use topomap::ids::{FrameId, SessionId};
use topomap::in_memory;
use topomap::log::{Decision, FrameEvent, MapEvent};
use topomap::mapper::{Decided, FrameInput, Mapper};
use topomap::settings::MapperSettings;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::verification::Verifier;

use super::{Proposal, Ranked, RankedCandidate, RankedDecision, Ranking};
use crate::error::{fault, refused};
use crate::event_log::EventLog;
use crate::observing::{CurrentView, Observed};
use crate::timing::FrameWatch;

/// FAB-MAP over a map that grows with the sequence, in one session.
#[derive(Clone, Debug)]
pub(crate) struct FabMap {
    pub(crate) mapper: Mapper,
    pub(crate) log: EventLog,
    verifier: Verifier,
    /// Of all frames so far, by index in the sequence.
    pub(crate) features: Vec<Arc<FeatureRecord>>,
}

/// The one session that a sequence is run in.
const SESSION: SessionId = 0;

/// Sequences have no stamps; frames are held to be this far apart. Without odometry only their
/// order matters.
const FRAME_INTERVAL_NS: i64 = 1_000_000_000;

impl FabMap {
    /// An empty map with an open session.
    pub(crate) fn new(model: &Model, settings: MapperSettings, seed: u64) -> Result<Self> {
        let mut mapper = Mapper::new(model, settings).map_err(refused)?;
        let opened = MapEvent::SessionOpened { session: SESSION };
        mapper.apply(&opened).map_err(fault)?;
        let verifier = Verifier::new(settings.verification, seed);
        Ok(Self { mapper, log: EventLog(vec![opened]), verifier, features: Vec::new() })
    }
}

impl Ranking for FabMap {
    fn rank(&mut self, index: usize, seen: Observed, mut watch: FrameWatch) -> Result<Ranked> {
        let Observed { observation, features } = seen;
        let words = observation.len();
        let input = FrameInput {
            session: SESSION,
            sequence: index as u64,
            stamp_ns: FRAME_INTERVAL_NS.saturating_mul(i64::try_from(index).unwrap_or(i64::MAX)),
            odometry: None,
            observation,
        };
        let views = CurrentView {
            current: &features,
            log: &self.log,
            earlier: &self.features,
            verifier: self.verifier,
            camera: None,
        };
        let decided = in_memory::decide(&self.mapper, &self.log.0, input, &views, &mut watch);
        let Decided { event, recognition, .. } = decided.with_context(|| format!("frame {index}"))?;
        let FrameEvent { decision, proposal, new_place_posterior, .. } = event;
        let candidates = event.candidates.clone();
        let event = MapEvent::Frame(Box::new(event));
        self.mapper.apply(&event).map_err(fault).with_context(|| format!("frame {index}"))?;
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
            candidates: candidates.iter().filter_map(|candidate| self.log.compared(candidate)).collect(),
            similarities: self
                .log
                .frames()
                .map(|earlier| posterior_of(earlier.decision.place, &recognition))
                .collect(),
            times,
        };
        self.log.0.push(event);
        self.features.push(Arc::new(features));
        Ok(ranked)
    }

    fn places(&self) -> Option<usize> {
        Some(self.mapper.map().places().len())
    }
}

/// The posterior of the place that an earlier frame was assigned to; 0 if it was to none.
fn posterior_of(place: Option<PlaceId>, recognition: &Recognition) -> f64 {
    place.and_then(|place| recognition.posterior.places.get(place.index())).copied().unwrap_or(0.0)
}

impl EventLog {
    fn compared(&self, candidate: &Candidate) -> Option<RankedCandidate> {
        Some(RankedCandidate { frame: self.index(candidate.matched.frame)?, candidate: *candidate })
    }

    /// The index in the sequence is the sequence number that the frame was sent with.
    fn proposal(&self, matched: Match, candidates: &[Candidate]) -> Option<Proposal> {
        let Match { place: _, posterior, log_odds, frame } = matched;
        let index = self.index(frame)?;
        let candidate = candidate_of(candidates, frame);
        let score = candidate.map_or(log_odds, Candidate::score);
        let probability = Some(candidate.map_or(posterior, Candidate::probability));
        Some(Proposal { frame: index, score, posterior: Some(posterior), probability })
    }
}

fn candidate_of(candidates: &[Candidate], frame: FrameId) -> Option<&Candidate> {
    candidates.iter().find(|candidate| candidate.matched.frame == frame)
}
