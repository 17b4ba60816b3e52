//! A map's settings: as asked for, and as stored.

use fabmap::detector::DetectorModel;
use fabmap::likelihood::Dependence;
use fabmap::new_place::NewPlaceMethod;
use fabmap::place_filter::FilterSettings;
use fabmap::recognizer::{RecognizerSettings, Scorer};
use serde::{Deserialize, Serialize};
use topomap::evidence::{VerificationMethod, VerificationSettings};
use topomap::metric::{OdometryNoise, PlaceSpacing};
use topomap::settings::{GuardMeasure, MapperSettings, PlaceRule};

use crate::error::ServiceError;

/// How a map decides, and what it keeps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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

impl MapSettings {
    /// The settings with the strategy, and the rule by which it makes places.
    pub(crate) fn with_strategy(mut self, strategy: NavigationStrategy) -> Self {
        self.strategy = strategy;
        self.mapper.place_rule = strategy.place_rule();
        self
    }

    /// Whether the settings fit together. Ranges are checked with the model.
    pub(crate) fn check(&self) -> Result<(), ServiceError> {
        if self.strategy == NavigationStrategy::Appearance && self.keep < Keep::Features {
            return Err(ServiceError::invalid(
                "a map that is navigated by appearance compares features: let it keep features or images, not words alone",
            ));
        }
        Ok(())
    }
}

/// The stored form: every setting spelled out, so that a new default changes no old map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredSettings {
    #[serde(with = "StoredDependence")]
    dependence: Dependence,
    #[serde(with = "StoredNewPlace")]
    new_place: NewPlaceMethod,
    detector: Option<StoredDetector>,
    new_place_prior: f64,
    even_share: f64,
    likelihood_smoothing: f64,
    closure_threshold: f64,
    guard_frames: u64,
    /// Maps that were made before it was counted in ways count frames.
    #[serde(default = "frames_before_ways_were_counted", with = "StoredGuardMeasure")]
    guard_measure: GuardMeasure,
    looks_per_stay: u32,
    min_words: u64,
    max_speed_m_per_s: f64,
    #[serde(default = "keep_before_it_was_a_setting")]
    keep: Keep,
    /// Maps that were made before there was any have none.
    #[serde(default = "StoredVerification::none")]
    verification: StoredVerification,
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
    #[serde(with = "StoredVerificationMethod")]
    method: VerificationMethod,
    min_posterior: f64,
    min_inliers: u32,
    max_rotation_rad: f64,
    max_ln_scale: f64,
    max_translation_widths: f64,
    /// Maps that were made before closures had one probability asked for so many inliers beside it.
    /// It is read and decides nothing.
    #[serde(default, skip_serializing)]
    min_evidence: Option<f64>,
    consistency_frames: u64,
}

impl StoredVerification {
    fn none() -> Self {
        VerificationSettings::none().into()
    }
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
            // Part of the program, as how likelihoods are scored is.
            weights: _,
            consistency_frames,
        } = settings;
        Self {
            method,
            min_posterior,
            min_inliers,
            max_rotation_rad,
            max_ln_scale,
            max_translation_widths,
            min_evidence: None,
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
            min_evidence: _,
            consistency_frames,
        } = stored;
        Self {
            method,
            min_posterior,
            min_inliers,
            max_rotation_rad,
            max_ln_scale,
            max_translation_widths,
            consistency_frames,
            ..Self::default()
        }
    }
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "VerificationMethod", rename_all = "snake_case")]
enum StoredVerificationMethod {
    None,
    Similarity,
    Epipolar,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "GuardMeasure", rename_all = "snake_case")]
enum StoredGuardMeasure {
    Way,
    Frames,
}

fn frames_before_ways_were_counted() -> GuardMeasure {
    GuardMeasure::Frames
}

fn keep_before_it_was_a_setting() -> Keep {
    Keep::Words
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Dependence", rename_all = "snake_case")]
enum StoredDependence {
    ChowLiu,
    NaiveBayes,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "NewPlaceMethod", rename_all = "snake_case")]
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
pub(crate) fn to_json(settings: &MapSettings) -> Result<String, ServiceError> {
    let MapSettings { mapper, keep, strategy } = *settings;
    let MapperSettings {
        recognizer,
        closure_threshold,
        verification,
        guard_frames,
        guard_measure,
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
        dependence,
        new_place,
        detector: detector.map(|detector| StoredDetector {
            true_positive_rate: detector.probability(true, true),
            false_positive_rate: detector.probability(true, false),
        }),
        new_place_prior,
        even_share,
        likelihood_smoothing,
        closure_threshold,
        guard_frames,
        guard_measure,
        looks_per_stay,
        min_words: min_words as u64,
        max_speed_m_per_s,
        keep,
        verification: verification.into(),
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
        guard_measure,
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
            dependence,
            new_place,
            scorer: Scorer::Index,
            detector: detector.transpose()?,
            filter: FilterSettings { new_place_prior, even_share, likelihood_smoothing },
        },
        closure_threshold,
        verification: verification.into(),
        guard_frames,
        guard_measure,
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
mod tests;
