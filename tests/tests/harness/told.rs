//! What a server told and what the library decided, made alike for comparing.

use fabmap::PlaceId;
use topomap::evidence::Match;
use topomap::log::{FrameEvent, Reason};
use waypost_client::v1;

use super::Reference;

/// What the answer and the event both say, with the bits of every number.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Told {
    reason: v1::Reason,
    place: Option<u32>,
    posterior_bits: u64,
    new_place_posterior_bits: u64,
    words: usize,
    closure: Option<ToldMatch>,
    proposal: Option<ToldMatch>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ToldMatch {
    place: u32,
    posterior_bits: u64,
    log_odds_bits: u64,
    sequence: u64,
}

/// What an answer says.
pub(crate) fn told(answer: &v1::FrameAnswer) -> Told {
    Told {
        reason: answer.reason(),
        place: answer.place_number,
        posterior_bits: answer.posterior.to_bits(),
        new_place_posterior_bits: answer.new_place_posterior.to_bits(),
        words: answer.words as usize,
        closure: answer.r#match.as_ref().map(told_match),
        proposal: answer.best_candidate.as_ref().map(told_match),
    }
}

pub(crate) fn told_match(found: &v1::Match) -> ToldMatch {
    ToldMatch {
        place: found.place_number,
        posterior_bits: found.posterior.to_bits(),
        log_odds_bits: found.log_odds.to_bits(),
        sequence: found.frame.as_ref().expect("a match is a frame").sequence,
    }
}

/// What an event decided.
pub(crate) fn decided(event: &FrameEvent, reference: &Reference) -> Told {
    Told {
        reason: match event.decision.reason {
            Reason::NewPlace => v1::Reason::NewPlace,
            Reason::SamePlace => v1::Reason::SamePlace,
            Reason::LoopClosure => v1::Reason::LoopClosure,
            Reason::BelowThreshold => v1::Reason::BelowThreshold,
            Reason::TooFewWords => v1::Reason::TooFewWords,
            Reason::GeometryRefused => v1::Reason::GeometryRefused,
        },
        place: event.decision.place.map(PlaceId::number),
        posterior_bits: event.decision.posterior.to_bits(),
        new_place_posterior_bits: event.new_place_posterior.to_bits(),
        words: event.observation.len(),
        closure: event.decision.closure.map(|found| decided_match(found, reference)),
        proposal: event.proposal.map(|found| decided_match(found, reference)),
    }
}

pub(crate) fn decided_match(found: Match, reference: &Reference) -> ToldMatch {
    let Match { place, posterior, log_odds, frame } = found;
    ToldMatch {
        place: place.number(),
        posterior_bits: posterior.to_bits(),
        log_odds_bits: log_odds.to_bits(),
        sequence: reference.sequence_of(frame),
    }
}
