//! A closure takes the threshold: what only lacks probability is below it, and not refused by geometry.

use fabmap::PlaceId;
use topomap::evidence::{ProbabilityWeights, Quantity, VerificationSettings};
use topomap::log::Reason;
use topomap::settings::MapperSettings;

use crate::look_alikes::{World, settings};

#[test]
fn what_only_lacks_probability_is_below_the_threshold() {
    // As if most candidates that look like this were none.
    let weights = ProbabilityWeights { offset_nats: -1e6, ..ProbabilityWeights::default() };
    let verification = VerificationSettings { weights, ..settings().verification };
    let mut world = World::new(MapperSettings { verification, ..settings() });
    for place in 1..=6 {
        world.sees(place, 40);
    }
    let event = world.sees(1, 40);
    assert_eq!(
        (event.decision.reason, event.decision.place),
        (Reason::BelowThreshold, Some(PlaceId::new(6)))
    );
    assert_eq!(event.decision.closure.map(|closure| closure.place), Some(PlaceId::new(0)));
    let improbable =
        event.candidates.iter().find(|candidate| candidate.matched.place == PlaceId::new(0)).unwrap();
    let verdict = world.mapper.verdict(improbable);
    let failed: Vec<Quantity> =
        verdict.checks.iter().filter(|check| !check.passed()).map(|check| check.quantity).collect();
    assert_eq!(failed, [Quantity::Probability]);
}
