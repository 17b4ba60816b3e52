//! A map's settings: as asked for, and as stored.

use fabmap::detector::DetectorModel;
use fabmap::likelihood::Dependence;
use fabmap::new_place::NewPlaceMethod;
use fabmap::place_filter::FilterSettings;
use fabmap::recognizer::{RecognizerSettings, Scorer};
use serde::{Deserialize, Serialize};
use topomap::mapper::{MapperSettings, PlaceRule};
use topomap::odometry_prior::PlaceSpacing;
use topomap::relative_pose::OdometryNoise;
use topomap::verification::{VerificationMethod, VerificationSettings};

use crate::error::ServiceError;

/// How a map decides, and what it keeps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MapSettings {
    pub(crate) mapper: MapperSettings,
    pub(crate) keep: Keep,
    pub(crate) strategy: NavigationStrategy,
}

/// How robots are led along a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum NavigationStrategy {
    /// Along places that wheels measured, by a camera that looks ahead.
    #[default]
    TopoMetric,
    /// By looks alone, with panoramas.
    Appearance,
}

impl NavigationStrategy {
    /// An appearance graph wants images one by one, and finds by itself which show the same.
    fn place_rule(self) -> PlaceRule {
        match self {
            NavigationStrategy::TopoMetric => PlaceRule::Unrecognized,
            NavigationStrategy::Appearance => PlaceRule::EachFrame,
        }
    }
}

/// What a map keeps of each frame; each keeps all of the ones before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Keep {
    /// Words and decisions.
    Words,
    /// Keypoints, descriptors, a thumbnail.
    #[default]
    Features,
    /// The image as it came.
    Images,
}

/// What may be chosen when a map is made; the rest is the default of the day, and stays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct MapSettingsRequest {
    pub(crate) dependence: Option<Dependence>,
    pub(crate) new_place: Option<NewPlaceMethod>,
    pub(crate) closure_threshold: Option<f64>,
    pub(crate) guard_frames: Option<u32>,
    pub(crate) new_place_prior: Option<f64>,
    pub(crate) true_positive_rate: Option<f64>,
    pub(crate) false_positive_rate: Option<f64>,
    pub(crate) keep: Option<Keep>,
    pub(crate) verification: Option<VerificationMethod>,
    pub(crate) place_spacing_m: Option<f64>,
    pub(crate) place_spacing_rad: Option<f64>,
    pub(crate) strategy: Option<NavigationStrategy>,
}

impl MapSettingsRequest {
    /// Fills in the defaults. Ranges are checked when the map is made.
    pub(crate) fn with_defaults(self) -> Result<MapSettings, ServiceError> {
        let Self {
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
        let (keep, strategy) = (keep.unwrap_or_default(), strategy.unwrap_or_default());
        if strategy == NavigationStrategy::Appearance && keep < Keep::Features {
            return Err(ServiceError::invalid(
                "a map that is navigated by appearance compares features: let it keep features or images, not words alone",
            ));
        }
        let defaults = MapperSettings::default();
        let detector = match (true_positive_rate, false_positive_rate) {
            (None, None) => None,
            (Some(seen), Some(mistaken)) => {
                Some(DetectorModel::new(seen, mistaken).map_err(ServiceError::invalid)?)
            }
            (Some(_), None) | (None, Some(_)) => {
                return Err(ServiceError::invalid(
                    "give both rates of the detector, or neither to use the model's",
                ));
            }
        };
        let FilterSettings { new_place_prior: prior, even_share, likelihood_smoothing } =
            defaults.recognizer.filter;
        let mapper = MapperSettings {
            recognizer: RecognizerSettings {
                dependence: dependence.unwrap_or(defaults.recognizer.dependence),
                new_place: new_place.unwrap_or(defaults.recognizer.new_place),
                scorer: Scorer::Index,
                detector,
                filter: FilterSettings {
                    new_place_prior: new_place_prior.unwrap_or(prior),
                    even_share,
                    likelihood_smoothing,
                },
            },
            closure_threshold: closure_threshold.unwrap_or(defaults.closure_threshold),
            verification: VerificationSettings {
                method: verification.unwrap_or(defaults.verification.method),
                ..defaults.verification
            },
            guard_frames: guard_frames.map_or(defaults.guard_frames, u64::from),
            place_spacing: PlaceSpacing {
                distance_m: place_spacing_m.unwrap_or(defaults.place_spacing.distance_m),
                angle_rad: place_spacing_rad.unwrap_or(defaults.place_spacing.angle_rad),
            },
            place_rule: strategy.place_rule(),
            ..defaults
        };
        Ok(MapSettings { mapper, keep, strategy })
    }
}

/// The stored form: every setting spelled out, so that a new default changes no old map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredSettings {
    dependence: StoredDependence,
    new_place: StoredNewPlace,
    detector: Option<StoredDetector>,
    new_place_prior: f64,
    even_share: f64,
    likelihood_smoothing: f64,
    closure_threshold: f64,
    guard_frames: u64,
    looks_per_stay: u32,
    min_words: u64,
    max_speed_m_per_s: f64,
    #[serde(default = "keep_before_it_was_a_setting")]
    keep: Keep,
    /// Maps that were made before there was any have none.
    #[serde(default)]
    verification: Option<StoredVerification>,
    /// Maps that were made before places had poses take the defaults of then.
    #[serde(default)]
    metric: StoredMetric,
    /// Maps that were made before it was a setting are led along places that wheels measured.
    #[serde(default)]
    navigation_strategy: NavigationStrategy,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredMetric {
    place_spacing_m: f64,
    place_spacing_rad: f64,
    translation_share: f64,
    heading_rad_per_m: f64,
    turn_share: f64,
    position_floor_m: f64,
    heading_floor_rad: f64,
    prior_frames: u64,
}

impl Default for StoredMetric {
    fn default() -> Self {
        Self {
            place_spacing_m: 0.5,
            place_spacing_rad: 10_f64.to_radians(),
            translation_share: 0.05,
            heading_rad_per_m: 0.05,
            turn_share: 0.05,
            position_floor_m: 0.01,
            heading_floor_rad: 0.01,
            prior_frames: 4,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredVerification {
    method: StoredVerificationMethod,
    min_posterior: f64,
    min_inliers: u32,
    max_rotation_rad: f64,
    max_ln_scale: f64,
    max_translation_widths: f64,
    min_evidence: f64,
    consistency_frames: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum StoredVerificationMethod {
    None,
    Similarity,
    Epipolar,
}

impl From<VerificationSettings> for StoredVerification {
    fn from(settings: VerificationSettings) -> Self {
        let VerificationSettings {
            method,
            min_posterior,
            min_inliers,
            max_rotation_rad,
            max_ln_scale,
            max_translation_widths,
            min_evidence,
            consistency_frames,
        } = settings;
        Self {
            method: match method {
                VerificationMethod::None => StoredVerificationMethod::None,
                VerificationMethod::Similarity => StoredVerificationMethod::Similarity,
                VerificationMethod::Epipolar => StoredVerificationMethod::Epipolar,
            },
            min_posterior,
            min_inliers,
            max_rotation_rad,
            max_ln_scale,
            max_translation_widths,
            min_evidence,
            consistency_frames,
        }
    }
}

impl From<StoredVerification> for VerificationSettings {
    fn from(stored: StoredVerification) -> Self {
        let StoredVerification {
            method,
            min_posterior,
            min_inliers,
            max_rotation_rad,
            max_ln_scale,
            max_translation_widths,
            min_evidence,
            consistency_frames,
        } = stored;
        Self {
            method: match method {
                StoredVerificationMethod::None => VerificationMethod::None,
                StoredVerificationMethod::Similarity => VerificationMethod::Similarity,
                StoredVerificationMethod::Epipolar => VerificationMethod::Epipolar,
            },
            min_posterior,
            min_inliers,
            max_rotation_rad,
            max_ln_scale,
            max_translation_widths,
            min_evidence,
            consistency_frames,
        }
    }
}

fn keep_before_it_was_a_setting() -> Keep {
    Keep::Words
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum StoredDependence {
    ChowLiu,
    NaiveBayes,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum StoredNewPlace {
    MeanField,
    Sampled,
    Tail,
    TemperedTail,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct StoredDetector {
    true_positive_rate: f64,
    false_positive_rate: f64,
}

/// Settings as the JSON that the database keeps.
pub(super) fn to_json(settings: &MapSettings) -> Result<String, ServiceError> {
    let MapSettings { mapper, keep, strategy } = *settings;
    let MapperSettings {
        recognizer,
        closure_threshold,
        verification,
        guard_frames,
        looks_per_stay,
        min_words,
        max_speed_m_per_s,
        place_spacing: PlaceSpacing { distance_m, angle_rad },
        // By the strategy.
        place_rule: _,
        odometry_noise,
        prior_frames,
    } = mapper;
    let OdometryNoise {
        translation_share,
        heading_rad_per_m,
        turn_share,
        position_floor_m,
        heading_floor_rad,
    } = odometry_noise;
    // Both scorers give the same values, so a map need not remember which was used.
    let RecognizerSettings { dependence, new_place, scorer: _, detector, filter } = recognizer;
    let FilterSettings { new_place_prior, even_share, likelihood_smoothing } = filter;
    let stored = StoredSettings {
        dependence: match dependence {
            Dependence::ChowLiu => StoredDependence::ChowLiu,
            Dependence::NaiveBayes => StoredDependence::NaiveBayes,
        },
        new_place: match new_place {
            NewPlaceMethod::MeanField => StoredNewPlace::MeanField,
            NewPlaceMethod::Sampled => StoredNewPlace::Sampled,
            NewPlaceMethod::Tail => StoredNewPlace::Tail,
            NewPlaceMethod::TemperedTail => StoredNewPlace::TemperedTail,
        },
        detector: detector.map(|detector| StoredDetector {
            true_positive_rate: detector.probability(true, true),
            false_positive_rate: detector.probability(true, false),
        }),
        new_place_prior,
        even_share,
        likelihood_smoothing,
        closure_threshold,
        guard_frames,
        looks_per_stay,
        min_words: min_words as u64,
        max_speed_m_per_s,
        keep,
        verification: Some(verification.into()),
        metric: StoredMetric {
            place_spacing_m: distance_m,
            place_spacing_rad: angle_rad,
            translation_share,
            heading_rad_per_m,
            turn_share,
            position_floor_m,
            heading_floor_rad,
            prior_frames: prior_frames as u64,
        },
        navigation_strategy: strategy,
    };
    serde_json::to_string(&stored).map_err(ServiceError::internal)
}

/// Reads what [`to_json`] wrote.
pub(crate) fn from_json(json: &str) -> Result<MapSettings, ServiceError> {
    let StoredSettings {
        dependence,
        new_place,
        detector,
        new_place_prior,
        even_share,
        likelihood_smoothing,
        closure_threshold,
        guard_frames,
        looks_per_stay,
        min_words,
        max_speed_m_per_s,
        keep,
        verification,
        metric,
        navigation_strategy: strategy,
    } = serde_json::from_str(json).map_err(ServiceError::internal)?;
    let StoredMetric {
        place_spacing_m,
        place_spacing_rad,
        translation_share,
        heading_rad_per_m,
        turn_share,
        position_floor_m,
        heading_floor_rad,
        prior_frames,
    } = metric;
    let detector = detector.map(|StoredDetector { true_positive_rate, false_positive_rate }| {
        DetectorModel::new(true_positive_rate, false_positive_rate).map_err(ServiceError::internal)
    });
    let mapper = MapperSettings {
        recognizer: RecognizerSettings {
            dependence: match dependence {
                StoredDependence::ChowLiu => Dependence::ChowLiu,
                StoredDependence::NaiveBayes => Dependence::NaiveBayes,
            },
            new_place: match new_place {
                StoredNewPlace::MeanField => NewPlaceMethod::MeanField,
                StoredNewPlace::Sampled => NewPlaceMethod::Sampled,
                StoredNewPlace::Tail => NewPlaceMethod::Tail,
                StoredNewPlace::TemperedTail => NewPlaceMethod::TemperedTail,
            },
            scorer: Scorer::Index,
            detector: detector.transpose()?,
            filter: FilterSettings { new_place_prior, even_share, likelihood_smoothing },
        },
        closure_threshold,
        verification: verification.map_or_else(VerificationSettings::none, VerificationSettings::from),
        guard_frames,
        looks_per_stay,
        min_words: usize::try_from(min_words).unwrap_or(usize::MAX),
        max_speed_m_per_s,
        place_spacing: PlaceSpacing { distance_m: place_spacing_m, angle_rad: place_spacing_rad },
        place_rule: strategy.place_rule(),
        odometry_noise: OdometryNoise {
            translation_share,
            heading_rad_per_m,
            turn_share,
            position_floor_m,
            heading_floor_rad,
        },
        prior_frames: usize::try_from(prior_frames).unwrap_or(usize::MAX),
    };
    Ok(MapSettings { mapper, keep, strategy })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_come_back_from_the_database() {
        let asked = MapSettingsRequest {
            dependence: Some(Dependence::NaiveBayes),
            new_place: Some(NewPlaceMethod::MeanField),
            closure_threshold: Some(0.7),
            guard_frames: Some(3),
            new_place_prior: Some(0.8),
            true_positive_rate: Some(0.4),
            false_positive_rate: Some(0.02),
            keep: Some(Keep::Images),
            verification: Some(VerificationMethod::Epipolar),
            place_spacing_m: Some(0.25),
            place_spacing_rad: Some(0.1),
            strategy: Some(NavigationStrategy::Appearance),
        };
        let settings = asked.with_defaults().unwrap();
        assert_eq!((settings.mapper.closure_threshold, settings.mapper.guard_frames), (0.7, 3));
        assert_eq!(from_json(&to_json(&settings).unwrap()), Ok(settings));
        let defaults = MapSettingsRequest::default().with_defaults().unwrap();
        let (keep, strategy) = (Keep::Features, NavigationStrategy::TopoMetric);
        assert_eq!(defaults, MapSettings { mapper: MapperSettings::default(), keep, strategy });
    }

    #[test]
    fn numbers_come_back_to_the_bit() {
        let mut asked =
            MapSettingsRequest { new_place_prior: Some(1.0 - f64::EPSILON / 2.0), ..Default::default() };
        for step in 0..1000_u32 {
            let settings = asked.with_defaults().unwrap();
            assert_eq!(from_json(&to_json(&settings).unwrap()), Ok(settings));
            // Irrational steps: numbers of all 17 digits.
            let number = (f64::from(step) * std::f64::consts::SQRT_2).fract();
            (asked.closure_threshold, asked.new_place_prior) = (Some(number), Some(number.sqrt()));
        }
    }

    #[test]
    fn settings_as_version_0_1_wrote_them_still_open() {
        let stored = r#"{"dependence":"chow_liu","new_place":"sampled","detector":null,"new_place_prior":0.9,
            "even_share":0.1,"likelihood_smoothing":0.99,"closure_threshold":0.9,"guard_frames":20,
            "looks_per_stay":3,"min_words":10,"max_speed_m_per_s":100.0}"#;
        let settings = from_json(stored).unwrap();
        assert_eq!((settings.mapper.guard_frames, settings.keep), (20, Keep::Words));
        assert_eq!(settings.strategy, NavigationStrategy::TopoMetric);
        assert_eq!(settings.mapper.verification.method, VerificationMethod::None);
        assert_eq!(settings.mapper.recognizer.new_place, NewPlaceMethod::Sampled);
        assert_eq!(
            settings.mapper.place_spacing,
            PlaceSpacing { distance_m: 0.5, angle_rad: 10_f64.to_radians() }
        );
    }

    #[test]
    fn appearance_takes_features() {
        let asked = |keep| MapSettingsRequest {
            keep,
            strategy: Some(NavigationStrategy::Appearance),
            ..MapSettingsRequest::default()
        };
        assert!(asked(Some(Keep::Images)).with_defaults().is_ok() && asked(None).with_defaults().is_ok());
        let refused = asked(Some(Keep::Words)).with_defaults().unwrap_err();
        assert!(refused.to_string().contains("keep features"), "{refused}");
    }

    #[test]
    fn half_a_detector_is_refused() {
        let asked = MapSettingsRequest { true_positive_rate: Some(0.4), ..MapSettingsRequest::default() };
        assert!(matches!(asked.with_defaults(), Err(ServiceError::InvalidArgument { .. })));
    }
}
