//! Map settings, to and from messages. Their stored form is in [`crate::map_settings`].

use fabmap::detector::DetectorModel;
use fabmap::likelihood::Dependence;
use fabmap::new_place::NewPlaceMethod;
use fabmap::place_filter::FilterSettings;
use fabmap::recognizer::RecognizerSettings;
use topomap::evidence::VerificationMethod;
use topomap::metric::PlaceSpacing;
use topomap::settings::MapperSettings;
use waypost_proto::v1;
use waypost_proto::v1::map_settings as wire;

use super::known;
use crate::error::ServiceError;
use crate::map_settings::{Keep, MapSettings, NavigationStrategy};

/// A choice that is an enum of the contract, too.
trait Choice: Sized {
    type Wire: TryFrom<i32> + Into<i32>;

    /// `None` for the unspecified value.
    fn of_wire(value: Self::Wire) -> Option<Self>;
    fn to_wire(self) -> Self::Wire;

    /// The choice that a field of a message makes, unless it leaves it open.
    fn read(field: &str, value: i32) -> Result<Option<Self>, ServiceError> {
        known(field, value).map(Self::of_wire)
    }
}

/// Values of the same name mean the same.
macro_rules! choices {
    ($($core:ident is $wire:ident { $($value:ident),+ })+) => {
        $(impl Choice for $core {
            type Wire = wire::$wire;

            fn of_wire(value: wire::$wire) -> Option<Self> {
                match value {
                    wire::$wire::Unspecified => None,
                    $(wire::$wire::$value => Some(Self::$value),)+
                }
            }

            fn to_wire(self) -> wire::$wire {
                match self {
                    $(Self::$value => wire::$wire::$value,)+
                }
            }
        })+
    };
}

choices! {
    Dependence is Dependence { ChowLiu, NaiveBayes }
    NewPlaceMethod is NewPlace { MeanField, Sampled, Tail, TemperedTail }
    Keep is Keep { Words, Features, Images }
    VerificationMethod is Verification { None, Similarity, Epipolar }
    NavigationStrategy is NavigationStrategy { TopoMetric, Appearance }
}

/// The settings that a message asks for: what it leaves out has its default. Ranges are checked when
/// the map is made.
pub(crate) fn requested_settings(message: v1::MapSettings) -> Result<MapSettings, ServiceError> {
    let v1::MapSettings {
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
        navigation_strategy,
    } = message;
    fn set<T>(setting: &mut T, asked: Option<impl Into<T>>) {
        if let Some(asked) = asked {
            *setting = asked.into();
        }
    }
    let strategy = Choice::read("navigation_strategy", navigation_strategy)?.unwrap_or_default();
    let mut settings = MapSettings::default().with_strategy(strategy);
    set(&mut settings.keep, Keep::read("keep", keep)?);
    let mapper = &mut settings.mapper;
    set(&mut mapper.recognizer.dependence, Dependence::read("dependence", dependence)?);
    set(&mut mapper.recognizer.new_place, NewPlaceMethod::read("new_place", new_place)?);
    mapper.recognizer.detector = detector(true_positive_rate, false_positive_rate)?;
    set(&mut mapper.recognizer.filter.new_place_prior, new_place_prior);
    set(&mut mapper.closure_threshold, closure_threshold);
    set(&mut mapper.guard_frames, guard_frames);
    mapper.verification.method = verification_method(
        settings.keep,
        VerificationMethod::read("verification", verification)?,
        mapper.verification.method,
    )?;
    set(&mut mapper.place_spacing.distance_m, place_spacing_m);
    set(&mut mapper.place_spacing.angle_rad, place_spacing_rad);
    settings.check()?;
    Ok(settings)
}

/// How views are compared. Where words alone are kept, there is nothing to compare.
fn verification_method(
    keep: Keep,
    asked: Option<VerificationMethod>,
    usual: VerificationMethod,
) -> Result<VerificationMethod, ServiceError> {
    match (keep, asked) {
        (Keep::Words, None) => Ok(VerificationMethod::None),
        (Keep::Words, Some(method)) if method.verifies() => Err(ServiceError::invalid(
            "the map keeps words alone, so there are no features by which a place could be verified: leave \
             `verification` out, or let the map keep features or images",
        )),
        (Keep::Words | Keep::Features | Keep::Images, asked) => Ok(asked.unwrap_or(usual)),
    }
}

/// The detector in place of the model's, if there is to be one.
fn detector(
    true_positive_rate: Option<f64>,
    false_positive_rate: Option<f64>,
) -> Result<Option<DetectorModel>, ServiceError> {
    match (true_positive_rate, false_positive_rate) {
        (None, None) => Ok(None),
        (Some(seen), Some(mistaken)) => {
            DetectorModel::new(seen, mistaken).map(Some).map_err(ServiceError::invalid)
        }
        (Some(_), None) | (None, Some(_)) => {
            Err(ServiceError::invalid("give both rates of the detector, or neither to use the model's"))
        }
    }
}

/// All settings that the contract knows.
pub(crate) fn settings_message(settings: &MapSettings) -> v1::MapSettings {
    let MapSettings { mapper, keep, strategy } = *settings;
    let MapperSettings {
        recognizer,
        closure_threshold,
        verification,
        guard_frames,
        guard_measure: _,
        looks_per_stay: _,
        min_words: _,
        max_speed_m_per_s: _,
        place_spacing: PlaceSpacing { distance_m, angle_rad },
        place_rule: _,
        odometry_noise: _,
        prior_frames: _,
    } = mapper;
    let RecognizerSettings { dependence, new_place, scorer: _, detector, filter } = recognizer;
    let FilterSettings { new_place_prior, even_share: _, likelihood_smoothing: _ } = filter;
    let rate = |exists| move |detector: DetectorModel| detector.probability(true, exists);
    v1::MapSettings {
        dependence: dependence.to_wire().into(),
        new_place: new_place.to_wire().into(),
        closure_threshold: Some(closure_threshold),
        guard_frames: Some(u32::try_from(guard_frames).unwrap_or(u32::MAX)),
        new_place_prior: Some(new_place_prior),
        true_positive_rate: detector.map(rate(true)),
        false_positive_rate: detector.map(rate(false)),
        keep: keep.to_wire().into(),
        verification: verification.method.to_wire().into(),
        place_spacing_m: Some(distance_m),
        place_spacing_rad: Some(angle_rad),
        navigation_strategy: strategy.to_wire().into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_out_has_its_default() {
        assert_eq!(requested_settings(v1::MapSettings::default()).unwrap(), MapSettings::default());
    }

    /// Each setting by itself, and every value of each choice, on its way to the core and back.
    #[test]
    fn every_setting_arrives() {
        let defaults = settings_message(&MapSettings::default());
        let rates =
            v1::MapSettings { true_positive_rate: Some(0.4), false_positive_rate: Some(0.01), ..defaults };
        let numbers = [
            v1::MapSettings { closure_threshold: Some(0.7), ..defaults },
            v1::MapSettings { guard_frames: Some(3), ..defaults },
            v1::MapSettings { new_place_prior: Some(0.8), ..defaults },
            v1::MapSettings { place_spacing_m: Some(0.25), ..defaults },
            v1::MapSettings { place_spacing_rad: Some(0.1), ..defaults },
            rates,
        ];
        let choices = (1..=4).flat_map(|value| {
            [
                v1::MapSettings { dependence: value.min(2), ..defaults },
                v1::MapSettings { new_place: value, ..defaults },
                v1::MapSettings { keep: value.clamp(2, 3), ..defaults },
                v1::MapSettings { verification: value.min(3), ..defaults },
                v1::MapSettings { navigation_strategy: value.min(2), ..defaults },
            ]
        });
        let usual = requested_settings(defaults).unwrap();
        for message in numbers.into_iter().chain(choices) {
            let settings = requested_settings(message).unwrap();
            assert_eq!(settings_message(&settings), message);
            assert_eq!(settings == usual, message == defaults, "{message:?}");
        }
    }

    #[test]
    fn where_words_alone_are_kept_nothing_is_verified() {
        let of = |verification: wire::Verification| v1::MapSettings {
            keep: wire::Keep::Words.into(),
            verification: verification.into(),
            ..v1::MapSettings::default()
        };
        for asked in [wire::Verification::Unspecified, wire::Verification::None] {
            let settings = requested_settings(of(asked)).unwrap();
            assert_eq!(settings.mapper.verification.method, VerificationMethod::None, "{asked:?}");
            assert_eq!(settings_message(&settings).verification(), wire::Verification::None);
        }
        for asked in [wire::Verification::Similarity, wire::Verification::Epipolar] {
            let refused = requested_settings(of(asked)).unwrap_err().to_string();
            assert!(refused.contains("keeps words alone"), "{asked:?}: {refused}");
        }
    }

    #[test]
    fn half_a_detector_is_refused() {
        let message = v1::MapSettings { true_positive_rate: Some(0.4), ..v1::MapSettings::default() };
        assert!(matches!(requested_settings(message), Err(ServiceError::InvalidArgument { .. })));
    }
}
