//! `waypost map create`: a map with its settings.

use clap::ValueEnum;
use waypost_client::v1;

use super::short_map;

/// What is left out has the server's default; `waypost map show` shows what is in force.
#[derive(clap::Args)]
pub(crate) struct Creation {
    /// 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit
    name: String,
    /// Hash of the model, its beginning, or a display name that only one model has
    #[arg(long)]
    model: String,
    /// Whether words depend on each other
    #[arg(long, value_enum)]
    dependence: Option<Dependence>,
    /// How being somewhere new is judged
    #[arg(long, value_enum)]
    new_place: Option<NewPlace>,
    /// Posterior from which a loop closure is accepted, above 0 and at most 1
    #[arg(long, value_name = "P")]
    closure_threshold: Option<f64>,
    /// A place that the session left fewer frames ago is not a loop closure
    #[arg(long, value_name = "N")]
    guard_frames: Option<u32>,
    /// Prior probability of being somewhere new, between 0 and 1
    #[arg(long, value_name = "P")]
    new_place_prior: Option<f64>,
    /// How probably a word that is there is seen, in place of the model's
    #[arg(long, value_name = "P", requires = "false_positive_rate")]
    true_positive_rate: Option<f64>,
    /// How probably a word that is not there is seen, in place of the model's
    #[arg(long, value_name = "P", requires = "true_positive_rate")]
    false_positive_rate: Option<f64>,
    /// What is kept of each frame beside its words
    #[arg(long, value_enum)]
    keep: Option<Keep>,
    /// How loop closures are verified by where features are; it takes a map that keeps features
    #[arg(long, value_enum)]
    verification: Option<Verification>,
    /// Where frames carry odometry: metres that a robot goes before it is at another place
    #[arg(long, value_name = "M")]
    place_spacing_m: Option<f64>,
    /// The same for how far it turns, in radians
    #[arg(long, value_name = "RAD")]
    place_spacing_rad: Option<f64>,
    /// How robots are led along the map; appearance takes panoramas, and a map that keeps features
    #[arg(long, value_enum)]
    strategy: Option<Strategy>,
}

impl Creation {
    pub(super) fn request(self) -> v1::CreateMapRequest {
        let Creation {
            name,
            model,
            dependence,
            new_place,
            closure_threshold,
            guard_frames,
            new_place_prior,
            true_positive_rate,
            false_positive_rate,
            keep,
            verification,
            place_spacing_m,
            place_spacing_rad,
            strategy,
        } = self;
        let dependence = match dependence {
            None => v1::map_settings::Dependence::Unspecified,
            Some(Dependence::ChowLiu) => v1::map_settings::Dependence::ChowLiu,
            Some(Dependence::NaiveBayes) => v1::map_settings::Dependence::NaiveBayes,
        };
        let new_place = match new_place {
            None => v1::map_settings::NewPlace::Unspecified,
            Some(NewPlace::MeanField) => v1::map_settings::NewPlace::MeanField,
            Some(NewPlace::Sampled) => v1::map_settings::NewPlace::Sampled,
            Some(NewPlace::Tail) => v1::map_settings::NewPlace::Tail,
            Some(NewPlace::TemperedTail) => v1::map_settings::NewPlace::TemperedTail,
        };
        let settings = v1::MapSettings {
            dependence: dependence.into(),
            new_place: new_place.into(),
            closure_threshold,
            guard_frames,
            new_place_prior,
            true_positive_rate,
            false_positive_rate,
            keep: match keep {
                None => v1::map_settings::Keep::Unspecified,
                Some(Keep::Words) => v1::map_settings::Keep::Words,
                Some(Keep::Features) => v1::map_settings::Keep::Features,
                Some(Keep::Images) => v1::map_settings::Keep::Images,
            }
            .into(),
            verification: match verification {
                None => v1::map_settings::Verification::Unspecified,
                Some(Verification::None) => v1::map_settings::Verification::None,
                Some(Verification::Similarity) => v1::map_settings::Verification::Similarity,
                Some(Verification::Epipolar) => v1::map_settings::Verification::Epipolar,
            }
            .into(),
            place_spacing_m,
            place_spacing_rad,
            navigation_strategy: match strategy {
                None => v1::map_settings::NavigationStrategy::Unspecified,
                Some(Strategy::TopoMetric) => v1::map_settings::NavigationStrategy::TopoMetric,
                Some(Strategy::Appearance) => v1::map_settings::NavigationStrategy::Appearance,
            }
            .into(),
        };
        let map_id = short_map(&name).to_owned();
        v1::CreateMapRequest { map_id, model, settings: Some(settings) }
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum Strategy {
    /// Along places that wheels measured, by a camera that looks ahead; the server's default
    TopoMetric,
    /// By looks alone: panoramas, no odometry
    Appearance,
}

#[derive(Clone, Copy, ValueEnum)]
enum Verification {
    /// Not at all: the posterior decides alone
    None,
    /// By a motion in the image plane: the camera is back very close; the server's default
    Similarity,
    /// By epipolar geometry: the camera may have moved sideways
    Epipolar,
}

#[derive(Clone, Copy, ValueEnum)]
enum Keep {
    /// Nothing
    Words,
    /// Keypoints, descriptors, a thumbnail; the server's default
    Features,
    /// All of that and the image as it came
    Images,
}

#[derive(Clone, Copy, ValueEnum)]
enum Dependence {
    /// Each word on its parent in the Chow-Liu tree
    ChowLiu,
    /// No word on any other
    NaiveBayes,
}

#[derive(Clone, Copy, ValueEnum)]
enum NewPlace {
    /// By the average place
    MeanField,
    /// By the mean over the model's sampling set
    Sampled,
    /// By what the best of many unrelated places would reach, from the tail of the sampling set
    Tail,
    /// By the same tail, with likelihood ratios tempered to it; use with a lower --closure-threshold
    TemperedTail,
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        creation: Creation,
    }

    fn request(arguments: &str) -> v1::CreateMapRequest {
        Line::parse_from(format!("create {arguments}").split(' ')).creation.request()
    }

    #[test]
    fn what_is_left_out_is_left_to_the_server() {
        let request = request("maps/office --model abcdef");
        assert_eq!((request.map_id.as_str(), request.model.as_str()), ("office", "abcdef"));
        assert_eq!(request.settings, Some(v1::MapSettings::default()));
    }

    #[test]
    fn what_is_given_is_passed_on() {
        let settings = request(
            "a --model m --dependence naive-bayes --new-place mean-field --closure-threshold 0.9 \
             --guard-frames 0 --true-positive-rate 0.4 --false-positive-rate 0.01 --strategy appearance",
        )
        .settings
        .unwrap();
        assert_eq!(settings.dependence(), v1::map_settings::Dependence::NaiveBayes);
        assert_eq!(settings.navigation_strategy(), v1::map_settings::NavigationStrategy::Appearance);
        assert_eq!(settings.new_place(), v1::map_settings::NewPlace::MeanField);
        assert_eq!((settings.closure_threshold, settings.guard_frames), (Some(0.9), Some(0)));
        assert_eq!((settings.true_positive_rate, settings.false_positive_rate), (Some(0.4), Some(0.01)));
    }

    #[test]
    fn one_rate_without_the_other_is_wrong_usage() {
        assert!(
            Line::try_parse_from(["create", "a", "--model", "m", "--true-positive-rate", "0.4"]).is_err()
        );
    }
}
