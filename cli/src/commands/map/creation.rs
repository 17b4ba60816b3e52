//! `waypost map create`: a map with its settings.

use waypost_client::{Client, v1};
use waypost_proto::flags::MapSettingsFlags;

use crate::failure::Failure;
use crate::names::short_map;

/// A setting that is left out has its default; `waypost map show` shows all
#[derive(clap::Args)]
pub(crate) struct Creation {
    /// 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit
    name: String,
    /// Hash of the model, its beginning, or a display name that only one model has; if left out, the
    /// server's only model: the one that ships, until another is trained or imported
    #[arg(long, default_value = "", hide_default_value = true)]
    model: String,
    #[command(flatten)]
    settings: MapSettingsFlags,
}

impl Creation {
    pub(super) fn request(self) -> v1::CreateMapRequest {
        let Creation { name, model, settings } = self;
        let map_id = short_map(&name).to_owned();
        v1::CreateMapRequest { map_id, model, settings: Some(settings.into()) }
    }
}

/// What may be amiss with a map that was just made.
pub(super) async fn hint(client: &Client, map: &v1::Map) -> Result<Option<String>, Failure> {
    let settings = map.settings.unwrap_or_default();
    if settings.navigation_strategy() != v1::map_settings::NavigationStrategy::Appearance {
        return Ok(None);
    }
    let model = client.model(&map.model).await?;
    Ok(model.extractor.starts_with("orb").then(|| {
        "its model describes images by ORB, by which panoramas that see the same are often not linked: the graph falls into \
         pieces, and no way leads from one to another. A model of rootsift joins more"
            .to_owned()
    }))
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
        assert_eq!(request("office").model, "");
        let request = request("maps/office --model abcdef");
        assert_eq!((request.map_id.as_str(), request.model.as_str()), ("office", "abcdef"));
        assert_eq!(request.settings, Some(v1::MapSettings::default()));
    }

    #[test]
    fn what_is_given_is_passed_on() {
        let settings = request(
            "a --model m --dependence naive_bayes --new-place mean_field --closure-threshold 0.9 \
             --guard-frames 0 --true-positive-rate 0.4 --false-positive-rate 0.01 \
             --navigation-strategy appearance",
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
