//! `waypost-eval appearance`.

use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use waypost_eval::commands::appearance::eye::Acuity;
use waypost_eval::commands::appearance::index::WordSource;
use waypost_eval::commands::appearance::{self, AppearanceOptions, Part};
use waypost_eval::error::EvalError;

use crate::{print_if, refuse};

/// Send a simulated robot with a panoramic camera to goals by looks alone, in buildings that it has images of.
#[derive(Args)]
pub(crate) struct AppearanceArguments {
    /// Buildings that the robot drives in, each with two goals.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    trials: u32,
    /// Seed of the first building; the next ones take the next seeds.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Most people in the robot's way, each number up to it tried.
    #[arg(long, value_name = "K", default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=8))]
    people: u8,
    /// Panoramas of the graph that is made through the index, of as many buildings as have room for them.
    #[arg(long, value_name = "N", default_value_t = 600, value_parser = clap::value_parser!(u16).range(2..=5000))]
    panoramas: u16,
    /// Panoramas that are compared with all others, to see which links the index does not lead to; all if there are no
    /// more.
    #[arg(long, value_name = "N", default_value_t = 600, value_parser = clap::value_parser!(u16).range(1..))]
    reference: u16,
    /// How fine the panoramas of that graph are: 512x128 with 300 features, or 1024x256 with 500.
    #[arg(long, value_name = "ACUITY", default_value = "coarse", value_parser = acuity())]
    acuity: Acuity,
    /// Model with the words of the index [default: they are learnt of panoramas of three other buildings].
    #[arg(long, value_name = "FILE", conflicts_with = "words")]
    model: Option<PathBuf>,
    /// How many words are learnt.
    #[arg(long, value_name = "N", default_value_t = 3000, value_parser = clap::value_parser!(u32).range(2..=20_000))]
    words: u32,
    /// What to measure [default: all that needs no --data, and with it the compass, too].
    #[arg(long, value_name = "PART", num_args = 1.., value_parser = parts())]
    parts: Option<Vec<Part>>,
    /// Folder panorama_alife with the recorded panoramas of a real robot, for the compass.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder for the pictures; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl AppearanceArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { trials, seed, people, panoramas, reference, acuity, model, words, parts, data, out, json } =
            self;
        if data.is_none() && parts.as_ref().is_some_and(|parts| parts.contains(&Part::Compass)) {
            refuse(
                "the compass is measured on recorded panoramas; give their folder with --data, or leave out compass",
            );
        }
        let parts = parts.unwrap_or_else(|| Part::ALL.to_vec());
        let (people, panoramas, reference) = (people.into(), panoramas.into(), reference.into());
        let words = model.map_or(WordSource::Panoramas(words), WordSource::Model);
        let options =
            AppearanceOptions { trials, seed, people, panoramas, reference, acuity, words, parts, data, out };
        print_if(json, &appearance::run(&options)?)
    }
}

fn acuity() -> impl TypedValueParser<Value = Acuity> {
    let named = |name: &str| Acuity::NAMED.iter().find(|(known, _)| *known == name);
    PossibleValuesParser::new(Acuity::NAMED.map(|(name, _)| name))
        .try_map(move |name| named(&name).map(|(_, acuity)| *acuity).ok_or("not one of them"))
}

fn parts() -> impl TypedValueParser<Value = Part> {
    PossibleValuesParser::new(Part::ALL.map(Part::name))
        .try_map(|name| Part::from_name(&name).ok_or("not one of the parts"))
}
