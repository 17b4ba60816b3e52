//! The names under which the command line and the summaries know the choices of the paper, and what else several commands'
//! arguments are read by.

use std::fmt::Display;
use std::ops::RangeInclusive;

use clap::ValueEnum;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use fabmap::likelihood::Dependence;
use fabmap::new_place::NewPlaceMethod;
use fabmap::recognizer::Scorer;
use topomap::evidence::VerificationMethod;
use topomap::log::Reason;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::Feature;

use crate::dataset::Verdict;

/// The values of a choice with their names.
pub(crate) type Choices<T> = &'static [(&'static str, T)];

/// Whether words depend on each other.
pub(crate) const DEPENDENCES: Choices<Dependence> =
    &[("chow_liu", Dependence::ChowLiu), ("naive_bayes", Dependence::NaiveBayes)];

/// How places nobody has seen are stood in for.
pub(crate) const NEW_PLACE_METHODS: Choices<NewPlaceMethod> = &[
    ("mean_field", NewPlaceMethod::MeanField),
    ("sampled", NewPlaceMethod::Sampled),
    ("tail", NewPlaceMethod::Tail),
    ("tempered_tail", NewPlaceMethod::TemperedTail),
];

/// How likelihoods are evaluated.
pub(crate) const SCORERS: Choices<Scorer> = &[("index", Scorer::Index), ("dense", Scorer::Dense)];

/// How closures are verified.
pub(crate) const VERIFICATION_METHODS: Choices<VerificationMethod> = &[
    ("none", VerificationMethod::None),
    ("similarity", VerificationMethod::Similarity),
    ("epipolar", VerificationMethod::Epipolar),
];

/// Why a frame was decided as it was.
pub(crate) const REASONS: Choices<Reason> = &[
    ("new-place", Reason::NewPlace),
    ("same-place", Reason::SamePlace),
    ("loop-closure", Reason::LoopClosure),
    ("below-threshold", Reason::BelowThreshold),
    ("too-few-words", Reason::TooFewWords),
    ("geometry-refused", Reason::GeometryRefused),
];

/// What the truth says of a proposal, if there is one.
pub(crate) const VERDICTS: Choices<Option<Verdict>> = &[
    ("true", Some(Verdict::True)),
    ("false", Some(Verdict::False)),
    ("neutral", Some(Verdict::Neutral)),
    ("none", None),
];

/// Name of a value; empty if the list lacks it.
pub(crate) fn name_of<T: PartialEq>(choices: Choices<T>, value: &T) -> &'static str {
    choices.iter().find(|(_, choice)| choice == value).map_or("", |(name, _)| name)
}

/// What the command line calls one of our own choices.
pub(crate) fn own_name(value: &impl ValueEnum) -> String {
    value.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
}

/// Value of a name.
pub(crate) fn value_of<T: Copy>(choices: Choices<T>, name: &str) -> Option<T> {
    choices.iter().find(|(choice, _)| *choice == name).map(|&(_, value)| value)
}

/// Reads one of the choices by its name.
pub(crate) fn choice<T: Copy + Send + Sync + 'static>(
    choices: Choices<T>,
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(choices.iter().map(|(name, _)| *name))
        .try_map(|name| value_of(choices, &name).ok_or("not one of the choices"))
}

/// Reads a local feature by its name.
pub(crate) fn features() -> impl TypedValueParser<Value = Feature> {
    PossibleValuesParser::new(Feature::ALL.map(Feature::name)).try_map(|name| name.parse::<Feature>())
}

/// Reads a simulated world by its name.
pub(crate) fn worlds() -> impl TypedValueParser<Value = NamedWorld> {
    PossibleValuesParser::new(NamedWorld::ALL.map(NamedWorld::name))
        .try_map(|name| NamedWorld::from_name(&name).ok_or("not one of the worlds"))
}

/// Reads a number of a range.
pub(crate) fn number(
    range: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| match text.parse() {
        Ok(number) if range.contains(&number) => Ok(number),
        Ok(_) | Err(_) => Err(format!("give a number from {} to {}", range.start(), range.end())),
    }
}

/// Help of an argument whose default is not an argument itself.
pub(crate) fn with_default(text: &str, default: impl Display) -> String {
    format!("{text} [default: {default}]")
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
