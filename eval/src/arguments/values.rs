//! Values that several commands take.

use std::fmt::Display;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use waypost_eval::choices::{Choices, value_of};
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::Feature;

/// Help of an argument whose default is not an argument itself.
pub(crate) fn with_default(text: &str, default: impl Display) -> String {
    format!("{text} [default: {default}]")
}

/// One of the choices, by its name.
pub(crate) fn choice<T: Copy + Send + Sync + 'static>(
    choices: Choices<T>,
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(choices.iter().map(|(name, _)| *name))
        .try_map(|name| value_of(choices, &name).ok_or("not one of the choices"))
}

/// A local feature, by its name.
pub(crate) fn features() -> impl TypedValueParser<Value = Feature> {
    PossibleValuesParser::new(Feature::ALL.map(Feature::name)).try_map(|name| name.parse::<Feature>())
}

/// A simulated world, by its name.
pub(crate) fn worlds() -> impl TypedValueParser<Value = NamedWorld> {
    PossibleValuesParser::new(NamedWorld::ALL.map(NamedWorld::name))
        .try_map(|name| NamedWorld::from_name(&name).ok_or("not one of the worlds"))
}
