//! What a frame has to pass to close a loop, number by number and in sentences.

use topomap::evidence::{Bound, Candidate, Check, Contributions, Quantity, Verdict};
use topomap::mapper::{AS_GOOD, Gate, Gates, OutOfReach};
use topomap::settings::MapperSettings;

use super::GateView;

pub(super) fn gate_views(gates: &Gates, candidate: Option<&Candidate>) -> Vec<GateView> {
    let Gates { place, words, known_place, guard, threshold } = *gates;
    let enough = if words.passed { "enough" } else { "too few" };
    let words_text = format!("{} different words are {enough}: {} are needed", words.value, words.required);
    let compared = if known_place.passed { "at least as probable as" } else { "less probable than" };
    let known_place_text = format!(
        "place {place}, posterior {}, is {compared} somewhere new, {}",
        probability(known_place.value),
        probability(known_place.required)
    );
    let guard_text = match (guard.passed, guard.value) {
        (true, _) => {
            format!("the session was not at place {place} within the last {} frames", guard.required)
        }
        (false, 0.0) => format!("the session is at place {place}: staying closes no loop"),
        (false, 1.0) => {
            format!("the session left place {place} 1 frame ago; a loop takes {} or more", guard.required)
        }
        (false, frames) => format!(
            "the session left place {place} {} frames ago; a loop takes {} or more",
            (10.0 * frames).round() / 10.0,
            guard.required
        ),
    };
    let reaches = if threshold.passed { "reaches" } else { "stays below" };
    let threshold_text = format!(
        "the posterior {} {reaches} the map's threshold {}",
        probability(threshold.value),
        probability(threshold.required)
    );
    let view = |name, gate, description| GateView { name, gate, description };
    let [words, guard] = [view("words", words, words_text), view("guard", guard, guard_text)];
    // Where views were compared, words are a part of the probability that the threshold is for: they decide nothing alone.
    if candidate.is_some_and(|candidate| candidate.view.is_some()) {
        return vec![words, guard];
    }
    let known_place = view("known_place", known_place, known_place_text);
    vec![words, known_place, guard, view("threshold", threshold, threshold_text)]
}

pub(in crate::service) fn verdict_views(settings: &MapperSettings, candidate: &Candidate) -> Vec<GateView> {
    let view = |check: &Check| {
        let Check { quantity, value, bound } = *check;
        let (required, asked) = match bound {
            Bound::AtLeast(least) => (least, "at least"),
            Bound::AtMost(most) => (most, "at most"),
        };
        let [found, wanted] = [value, required].map(|value| digits(quantity, value));
        let found = format!("{quantity} {found}, {asked} {wanted} asked for");
        let description = match quantity {
            Quantity::Probability => format!("{found}: {}", nats(settings, candidate)),
            Quantity::Posterior => format!("without keypoints to compare, words decide: {found}"),
            Quantity::Inliers
            | Quantity::RotationRad
            | Quantity::LnScale
            | Quantity::TranslationWidths
            | Quantity::PlacedInliers
            | Quantity::DistanceM
            | Quantity::HeadingRad => format!("geometry: {found}"),
        };
        let gate = Gate { passed: check.passed(), value, required };
        GateView { name: gate_name(quantity), gate, description }
    };
    let Verdict { checks } = settings.verdict(candidate);
    checks.iter().map(view).collect()
}

/// That another place has far more evidence.
pub(super) fn outdone_view(candidate: &Candidate, stronger: &Candidate) -> GateView {
    let [value, required] = [candidate.evidence(), AS_GOOD * stronger.evidence()];
    let description = format!(
        "evidence {value:.0} inliers, at least {required:.0} asked for: place {} shows {:.0}, and where one shows far more, no \
         other closes a loop",
        stronger.matched.place,
        stronger.evidence()
    );
    GateView { name: "strongest", gate: Gate { passed: false, value, required }, description }
}

/// That the robot has driven away from the place, and not back.
pub(super) fn out_of_reach_view(out_of_reach: &OutOfReach) -> GateView {
    let OutOfReach { least_m, allowed_m } = *out_of_reach;
    let description = format!(
        "wheels: the place is {least_m:.1} m off at least, {allowed_m:.1} m would be allowed: since it was there the robot has \
         driven away, and no drift of its wheels makes a loop of that"
    );
    GateView {
        name: "wheels",
        gate: Gate { passed: false, value: least_m, required: allowed_m },
        description,
    }
}

/// What a candidate's probability is made of, and what would have been enough.
fn nats(settings: &MapperSettings, candidate: &Candidate) -> String {
    let weights = settings.verification.weights;
    let Contributions { offset_nats, geometry_nats, words_nats } = candidate.contributions(&weights);
    let threshold = settings.closure_threshold;
    let wanted_nats = (threshold / (1.0 - threshold).max(f64::MIN_POSITIVE)).ln();
    let enough = (wanted_nats - offset_nats - words_nats) / weights.per_look_alike_nats;
    format!(
        "{:+.1} nats of {wanted_nats:.1}; geometry gives {geometry_nats:+.1} (evidence {:.0} inliers, where \
         look-alikes show {:.0}; {:.0} would be enough), words {words_nats:+.1}, and {offset_nats:+.1} to begin with",
        candidate.log_odds_nats,
        candidate.evidence(),
        candidate.look_alike_inliers,
        (enough * candidate.look_alike_inliers).max(0.0),
    )
}

/// As many digits as tell something.
fn digits(quantity: Quantity, value: f64) -> String {
    match quantity {
        Quantity::Inliers | Quantity::PlacedInliers => format!("{value:.0}"),
        Quantity::Probability | Quantity::Posterior => probability(value),
        Quantity::RotationRad | Quantity::HeadingRad => format!("{value:.3} rad"),
        Quantity::DistanceM => format!("{value:.2} m"),
        Quantity::LnScale => format!("ln {value:.3}"),
        Quantity::TranslationWidths => format!("{value:.3} widths"),
    }
}

fn gate_name(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Inliers => "inliers",
        Quantity::Probability => "probability",
        Quantity::Posterior => "posterior",
        Quantity::RotationRad => "rotation",
        Quantity::LnScale => "scale",
        Quantity::TranslationWidths => "translation",
        Quantity::PlacedInliers => "placed_inliers",
        Quantity::DistanceM => "distance",
        Quantity::HeadingRad => "heading",
    }
}

/// Digits where they tell: near 0 and near 1.
pub(in crate::service) fn probability(value: f64) -> String {
    if value < 1e-3 { format!("{value:.1e}") } else { format!("{value:.9}") }
}
