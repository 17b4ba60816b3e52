//! The names under which the command line and the summaries know the choices of the paper.

use fabmap::likelihood::Dependence;
use fabmap::new_place::NewPlaceMethod;
use fabmap::recognizer::Scorer;
use topomap::event::Reason;
use topomap::relaxation::Closures;
use topomap::verification::VerificationMethod;

use crate::commands::calibrate::DetectorChoice;
use crate::commands::navigate::{Lighting, Trial};
use crate::commands::posegraph::GraphStart;
use crate::dataset::Verdict;

/// The values of a choice with their names.
pub type Choices<T> = &'static [(&'static str, T)];

/// Whether words depend on each other.
pub const DEPENDENCES: Choices<Dependence> =
    &[("chow-liu", Dependence::ChowLiu), ("naive-bayes", Dependence::NaiveBayes)];

/// How places nobody has seen are stood in for.
pub const NEW_PLACE_METHODS: Choices<NewPlaceMethod> = &[
    ("mean-field", NewPlaceMethod::MeanField),
    ("sampled", NewPlaceMethod::Sampled),
    ("tail", NewPlaceMethod::Tail),
    ("tempered-tail", NewPlaceMethod::TemperedTail),
];

/// How likelihoods are evaluated.
pub const SCORERS: Choices<Scorer> = &[("index", Scorer::Index), ("dense", Scorer::Dense)];

/// How closures are verified.
pub const VERIFICATION_METHODS: Choices<VerificationMethod> = &[
    ("none", VerificationMethod::None),
    ("similarity", VerificationMethod::Similarity),
    ("epipolar", VerificationMethod::Epipolar),
];

/// Which system ranks earlier frames.
pub const RANKINGS: Choices<RankingName> = &[
    ("fab-map", RankingName::FabMap),
    ("likelihood", RankingName::Likelihood),
    ("tf-idf", RankingName::TfIdf),
];

/// Where the detector's rates come from.
pub const DETECTORS: Choices<DetectorChoice> = &[
    ("fixed", DetectorChoice::Fixed),
    ("tempered", DetectorChoice::Tempered),
    ("learned", DetectorChoice::Learned),
];

/// What a robot that is led is to do.
pub const NAVIGATION_TRIALS: Choices<Trial> = &[
    ("repeat", Trial::Repeat),
    ("shortcut", Trial::Shortcut),
    ("sparse", Trial::Sparse),
    ("kidnapped", Trial::Kidnapped),
    ("facing", Trial::Facing),
];

/// Light of the day on which a way is driven again.
pub const LIGHTINGS: Choices<Lighting> = &[("as-taught", Lighting::AsTaught), ("another", Lighting::Another)];

/// Where relaxation of a pose graph starts from.
pub const GRAPH_STARTS: Choices<GraphStart> = &[
    ("odometry", GraphStart::Odometry),
    ("chordal", GraphStart::Chordal),
    ("best", GraphStart::Best),
    ("file", GraphStart::File),
];

/// Whether closures of a pose graph may be wrong.
pub const CLOSURES: Choices<Closures> = &[("judged", Closures::Judged), ("trusted", Closures::Trusted)];

/// Why a frame was decided as it was.
pub const REASONS: Choices<Reason> = &[
    ("new-place", Reason::NewPlace),
    ("same-place", Reason::SamePlace),
    ("loop-closure", Reason::LoopClosure),
    ("below-threshold", Reason::BelowThreshold),
    ("too-few-words", Reason::TooFewWords),
    ("geometry-refused", Reason::GeometryRefused),
];

/// What the truth says of a proposal, if there is one.
pub const VERDICTS: Choices<Option<Verdict>> = &[
    ("true", Some(Verdict::True)),
    ("false", Some(Verdict::False)),
    ("neutral", Some(Verdict::Neutral)),
    ("none", None),
];

/// A system, by name alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RankingName {
    /// FAB-MAP with its map and filter.
    #[default]
    FabMap,
    /// FAB-MAP's likelihood alone: no map, no motion, no filter.
    Likelihood,
    /// The baseline.
    TfIdf,
}

/// Name of a value; empty if the list lacks it.
#[must_use]
pub fn name_of<T: PartialEq>(choices: Choices<T>, value: &T) -> &'static str {
    choices.iter().find(|(_, choice)| choice == value).map_or("", |(name, _)| name)
}

/// Value of a name.
#[must_use]
pub fn value_of<T: Copy>(choices: Choices<T>, name: &str) -> Option<T> {
    choices.iter().find(|(choice, _)| *choice == name).map(|&(_, value)| value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_values_lead_to_each_other() {
        for &(name, reason) in REASONS {
            assert_eq!(name_of(REASONS, &reason), name);
            assert_eq!(value_of(REASONS, name), Some(reason));
        }
        assert_eq!(value_of(DEPENDENCES, "chow liu"), None);
        assert_eq!(name_of(VERDICTS, &None), "none");
    }
}
