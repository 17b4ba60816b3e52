//! The system to judge, for the commands that judge one.

use clap::Args;
use fabmap::likelihood::Dependence;
use fabmap::new_place::NewPlaceMethod;
use fabmap::place_filter::FilterSettings;
use fabmap::recognizer::{RecognizerSettings, Scorer};
use topomap::mapper::MapperSettings;
use topomap::verification::VerificationMethod;
use waypost_eval::choices::{
    DEPENDENCES, NEW_PLACE_METHODS, RANKINGS, RankingName, SCORERS, VERIFICATION_METHODS, name_of,
};
use waypost_eval::commands::sequence::{Knobs, System};

use crate::arguments::values::{choice, with_default};

/// The system to judge, with its settings.
#[derive(Args)]
pub(crate) struct SystemArguments {
    #[arg(long, value_name = "P", help = with_default(
        "Posterior (with tf-idf: cosine) from which a loop closure is accepted",
        MapperSettings::default().closure_threshold,
    ))]
    threshold: Option<f64>,
    /// The system to judge.
    #[arg(long, value_parser = choice(RANKINGS), default_value = name_of(RANKINGS, &RankingName::default()))]
    ranking: RankingName,
    #[command(flatten)]
    knobs: KnobArguments,
}

/// The paper's choices; of FAB-MAP alone.
#[derive(Args)]
#[command(next_help_heading = "FAB-MAP")]
pub(crate) struct KnobArguments {
    #[arg(long = "verify", value_parser = choice(VERIFICATION_METHODS), help = with_default(
        "Geometry that has to agree before a loop is closed",
        name_of(VERIFICATION_METHODS, &MapperSettings::default().verification.method),
    ))]
    verification: Option<VerificationMethod>,
    #[arg(long, value_name = "INLIERS", help = with_default(
        "Least evidence of a verified closure",
        MapperSettings::default().verification.min_evidence,
    ))]
    min_evidence: Option<f64>,
    #[arg(long, value_name = "FRAMES", help = with_default(
        "Earlier frames whose matches speak for those near them",
        MapperSettings::default().verification.consistency_frames,
    ))]
    consistency_frames: Option<u64>,
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
    /// p(z=1|e=1): how often a scene element that exists is seen [default: the model's].
    #[arg(long, value_name = "P")]
    true_positive_rate: Option<f64>,
    /// p(z=1|e=0): how often one is seen that does not exist [default: the model's].
    #[arg(long, value_name = "P")]
    false_positive_rate: Option<f64>,
    #[arg(long, value_name = "P", help = with_default(
        "p(new): prior probability of a place never seen",
        FilterSettings::default().new_place_prior,
    ))]
    new_place_prior: Option<f64>,
    #[arg(long, value_name = "SIGMA", help = with_default(
        "Weight of the normalised likelihoods against an even distribution; 1 is no smoothing",
        FilterSettings::default().likelihood_smoothing,
    ))]
    smoothing: Option<f64>,
    #[arg(long, value_name = "EPSILON", help = with_default(
        "Share of the prior that is spread evenly over all places whatever the motion",
        FilterSettings::default().even_share,
    ))]
    even_share: Option<f64>,
}

impl SystemArguments {
    /// # Errors
    /// What cannot be asked for together.
    pub(crate) fn system(self) -> Result<System, &'static str> {
        let Self { threshold, ranking, knobs } = self;
        Ok(match ranking {
            RankingName::FabMap => System::FabMap(knobs.with_threshold(threshold)),
            RankingName::Likelihood => System::Likelihood(knobs.with_threshold(threshold)),
            RankingName::TfIdf if knobs.are_untouched() => System::TfIdf { threshold },
            RankingName::TfIdf => {
                return Err(
                    "with --ranking tf-idf there are no FAB-MAP settings to make; leave out --verify, --min-evidence, \
                     --consistency-frames, --dependence, --new-place, --scorer, the rates, --new-place-prior, \
                     --smoothing and --even-share",
                );
            }
        })
    }
}

impl KnobArguments {
    pub(crate) fn with_threshold(self, closure_threshold: Option<f64>) -> Knobs {
        let Self {
            verification,
            min_evidence,
            consistency_frames,
            dependence,
            new_place,
            scorer,
            true_positive_rate,
            false_positive_rate,
            new_place_prior,
            smoothing,
            even_share,
        } = self;
        Knobs {
            closure_threshold,
            verification,
            min_evidence,
            consistency_frames,
            dependence,
            new_place,
            scorer,
            true_positive_rate,
            false_positive_rate,
            new_place_prior,
            even_share,
            likelihood_smoothing: smoothing,
        }
    }

    fn are_untouched(&self) -> bool {
        let Self {
            verification,
            min_evidence,
            consistency_frames,
            dependence,
            new_place,
            scorer,
            true_positive_rate,
            false_positive_rate,
            new_place_prior,
            smoothing,
            even_share,
        } = self;
        let rates = [true_positive_rate, false_positive_rate, new_place_prior, smoothing, even_share];
        verification.is_none()
            && min_evidence.is_none()
            && consistency_frames.is_none()
            && dependence.is_none()
            && new_place.is_none()
            && scorer.is_none()
            && rates.iter().all(|rate| rate.is_none())
    }
}
