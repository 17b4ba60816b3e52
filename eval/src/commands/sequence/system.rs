//! The system to judge, with its settings.

use anyhow::Result;
use clap::{Args, ValueEnum};
use fabmap::likelihood::Dependence;
use fabmap::model::Model;
use fabmap::new_place::NewPlaceMethod;
use fabmap::recognizer::{RecognizerSettings, Scorer};
use topomap::evidence::VerificationMethod;
use topomap::settings::MapperSettings;

use crate::choices::{
    DEPENDENCES, NEW_PLACE_METHODS, SCORERS, VERIFICATION_METHODS, choice, name_of, own_name, with_default,
};
use crate::error::refused;
use crate::match_matrix::Scale;
use crate::ranking::{FabMap, LikelihoodRanking, Ranking, TfIdfRanking};

/// The system to judge, with its settings.
#[derive(Args)]
pub(super) struct SystemOptions {
    #[arg(long, value_name = "P", help = with_default(
        "Posterior (with tf-idf: cosine) from which a loop closure is accepted",
        MapperSettings::default().closure_threshold,
    ))]
    pub(super) threshold: Option<f64>,
    /// The system to judge.
    #[arg(long, value_enum, default_value_t)]
    pub(super) ranking: RankingName,
    #[command(flatten)]
    knobs: Knobs,
}

/// A system to judge.
#[derive(Clone, Copy, Default, PartialEq, ValueEnum)]
pub(super) enum RankingName {
    /// FAB-MAP over a growing map, as the server runs it.
    #[default]
    FabMap,
    /// FAB-MAP's likelihood alone, without map, motion and filter.
    Likelihood,
    /// The baseline: every earlier frame by the cosine of its tf-idf vector.
    TfIdf,
}

/// What can be set of FAB-MAP; `None` keeps the default, which the settings themselves have.
#[derive(Args, Default, PartialEq)]
#[command(next_help_heading = "FAB-MAP")]
struct Knobs {
    #[arg(long = "verify", value_parser = choice(VERIFICATION_METHODS), help = with_default(
        "Geometry that has to agree before a loop is closed",
        name_of(VERIFICATION_METHODS, &MapperSettings::default().verification.method),
    ))]
    verification: Option<VerificationMethod>,
    #[arg(long, value_parser = choice(DEPENDENCES), help = with_default(
        "Whether words depend on each other",
        name_of(DEPENDENCES, &RecognizerSettings::default().dependence),
    ))]
    dependence: Option<Dependence>,
    #[arg(long, value_parser = choice(NEW_PLACE_METHODS), help = with_default(
        "What stands in for places nobody has seen",
        name_of(NEW_PLACE_METHODS, &RecognizerSettings::default().new_place),
    ))]
    new_place: Option<NewPlaceMethod>,
    #[arg(long, value_parser = choice(SCORERS), help = with_default(
        "How likelihoods are evaluated; the values are the same",
        name_of(SCORERS, &RecognizerSettings::default().scorer),
    ))]
    scorer: Option<Scorer>,
}

impl SystemOptions {
    /// Refuses what cannot be asked for together.
    pub(super) fn check(&self) -> Result<()> {
        if self.ranking == RankingName::TfIdf && self.knobs != Knobs::default() {
            return Err(refused(
                "with --ranking tf-idf there are no FAB-MAP settings to make; leave out --verify, --dependence, \
                 --new-place and --scorer",
            ));
        }
        Ok(())
    }

    /// An empty system; frames closer than `gap` are never loops.
    pub(super) fn start(&self, model: &Model, gap: usize, seed: u64) -> Result<Box<dyn Ranking>> {
        Ok(match self.ranking {
            RankingName::FabMap => Box::new(FabMap::new(model, self.settings(gap), seed)?),
            RankingName::Likelihood => {
                let settings = self.settings(gap).recognizer;
                Box::new(LikelihoodRanking::new(model, settings, gap)?)
            }
            RankingName::TfIdf => Box::new(TfIdfRanking::new(model, gap)),
        })
    }

    /// How the system's similarities are drawn.
    pub(super) fn scale(&self) -> Scale {
        match self.ranking {
            RankingName::FabMap | RankingName::Likelihood => Scale::Posterior,
            RankingName::TfIdf => Scale::Cosine,
        }
    }

    /// The mapper's settings with these knobs turned; frames closer than `gap` are never loops. The mapper checks them.
    pub(super) fn settings(&self, gap: usize) -> MapperSettings {
        let Knobs { verification, dependence, new_place, scorer } = self.knobs;
        let mut settings = MapperSettings { guard_frames: gap as u64, ..MapperSettings::default() };
        set(&mut settings.closure_threshold, self.threshold);
        set(&mut settings.verification.method, verification);
        set(&mut settings.recognizer.dependence, dependence);
        set(&mut settings.recognizer.new_place, new_place);
        set(&mut settings.recognizer.scorer, scorer);
        settings
    }

    /// The system in a few words, for titles.
    pub(super) fn in_words(&self) -> String {
        let ranking = own_name(&self.ranking);
        if self.ranking == RankingName::TfIdf {
            return ranking;
        }
        let defaults = RecognizerSettings::default();
        let dependence = name_of(DEPENDENCES, &self.knobs.dependence.unwrap_or(defaults.dependence));
        let new_place = name_of(NEW_PLACE_METHODS, &self.knobs.new_place.unwrap_or(defaults.new_place));
        let verification = match self.knobs.verification {
            None | Some(VerificationMethod::None) => String::new(),
            Some(method) => format!(", {} verified", name_of(VERIFICATION_METHODS, &method)),
        };
        format!("{ranking}, {dependence}, {new_place} new place{verification}")
    }
}

fn set<T>(setting: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *setting = given;
    }
}
