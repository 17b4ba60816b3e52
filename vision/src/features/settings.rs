//! What to extract: which feature, how many, from images of which width.

use std::fmt;
use std::str::FromStr;

use fabmap::descriptor::DescriptorKind;

/// Everything that decides which features an image has.
///
/// Words made from different settings do not mean the same, so a model stores and hashes the text
/// form, `rootsift features=500 width=640`: there is exactly one text per settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FeatureSettings {
    feature: Feature,
    max_features: u32,
    image_width: u32,
}

impl FeatureSettings {
    /// Fewest features an image may be asked for.
    pub const MIN_FEATURES: u32 = 1;
    /// Most features an image may be asked for.
    pub const MAX_FEATURES: u32 = 10_000;
    /// Narrowest width to shrink to, in pixels.
    pub const MIN_IMAGE_WIDTH: u32 = 64;
    /// Widest width to shrink to, in pixels.
    pub const MAX_IMAGE_WIDTH: u32 = 4096;

    /// Up to `max_features` of `feature` from images shrunk to `image_width` pixels.
    ///
    /// # Errors
    /// [`SettingsError::FeatureCount`] or [`SettingsError::ImageWidth`] if a number is out of
    /// range.
    pub fn new(feature: Feature, max_features: u32, image_width: u32) -> Result<Self, SettingsError> {
        if !(Self::MIN_FEATURES..=Self::MAX_FEATURES).contains(&max_features) {
            return Err(SettingsError::FeatureCount { found: max_features });
        }
        if !(Self::MIN_IMAGE_WIDTH..=Self::MAX_IMAGE_WIDTH).contains(&image_width) {
            return Err(SettingsError::ImageWidth { found: image_width });
        }
        Ok(Self { feature, max_features, image_width })
    }

    /// What is looked for.
    #[must_use]
    pub fn feature(&self) -> Feature {
        self.feature
    }

    /// Most features kept per image.
    #[must_use]
    pub fn max_features(&self) -> u32 {
        self.max_features
    }

    /// Width that images are shrunk to, in pixels; narrower ones keep their size.
    #[must_use]
    pub fn image_width(&self) -> u32 {
        self.image_width
    }
}

impl Default for FeatureSettings {
    fn default() -> Self {
        Self { feature: Feature::RootSift, max_features: 500, image_width: 640 }
    }
}

impl fmt::Display for FeatureSettings {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { feature, max_features, image_width } = self;
        write!(formatter, "{feature} features={max_features} width={image_width}")
    }
}

impl FromStr for FeatureSettings {
    type Err = SettingsError;

    fn from_str(text: &str) -> Result<Self, SettingsError> {
        let malformed = || SettingsError::Malformed { found: text.to_owned() };
        let (feature, numbers) = text.split_once(" features=").ok_or_else(malformed)?;
        let (max_features, image_width) = numbers.split_once(" width=").ok_or_else(malformed)?;
        let settings = Self::new(
            feature.parse()?,
            max_features.parse().map_err(|_| malformed())?,
            image_width.parse().map_err(|_| malformed())?,
        )?;
        // "+500" and "0500" are numbers too, but would be a second name for the same settings.
        if settings.to_string() == text { Ok(settings) } else { Err(malformed()) }
    }
}

/// A local feature: what is looked for and how it is described.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Feature {
    /// SIFT (Lowe, IJCV 60(2) 2004): 128 gradient sums of one byte each.
    Sift,
    /// SIFT compared by the Hellinger kernel (Arandjelović & Zisserman, CVPR 2012): the square
    /// roots of the L1-normalised SIFT descriptor, times [`Feature::ROOT_SIFT_SCALE`].
    RootSift,
    /// RootSIFT described as the camera stands, not turned to each feature's own orientation: for cameras that do not
    /// roll. What looks alike but for its turn stays apart, and one orientation instead of several leaves room for
    /// more features.
    UprightRootSift,
    /// ORB (Rublee et al., ICCV 2011): 256 brightness comparisons.
    Orb,
    /// AKAZE with its M-LDB descriptor (Alcantarilla et al., BMVC 2013): 486 comparisons.
    Akaze,
}

impl Feature {
    /// All features, in the order of their definition.
    pub const ALL: [Feature; 5] =
        [Feature::Sift, Feature::RootSift, Feature::UprightRootSift, Feature::Orb, Feature::Akaze];

    /// Length of a RootSIFT descriptor before it is rounded to bytes. On 3 million values from real
    /// corridors and streets the largest byte was 176 and rounding moved descriptors by 0.6% of
    /// their length; twice the scale clips one value in 200, moving them by up to 3%.
    pub const ROOT_SIFT_SCALE: f64 = 512.0;

    /// How its descriptors are compared.
    #[must_use]
    pub fn descriptor_kind(self) -> DescriptorKind {
        match self {
            Feature::Sift | Feature::RootSift | Feature::UprightRootSift => DescriptorKind::Float,
            Feature::Orb | Feature::Akaze => DescriptorKind::Binary,
        }
    }

    /// Bytes per descriptor.
    #[must_use]
    pub fn descriptor_width(self) -> usize {
        match self {
            Feature::Sift | Feature::RootSift | Feature::UprightRootSift => 128,
            Feature::Orb => 32,
            Feature::Akaze => 61,
        }
    }

    /// How far to the right and down of the truth OpenCV puts its keypoints, in pixels.
    ///
    /// OpenCV's SIFT doubles the image about its corner, which takes x to 2x + 1/2, and halves the
    /// coordinates found there without taking the 1/2 off.
    pub(super) fn opencv_offset_px(self) -> f32 {
        match self {
            Feature::Sift | Feature::RootSift | Feature::UprightRootSift => 0.25,
            Feature::Orb | Feature::Akaze => 0.0,
        }
    }

    /// Its name in settings and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Feature::Sift => "sift",
            Feature::RootSift => "rootsift",
            Feature::UprightRootSift => "upright-rootsift",
            Feature::Orb => "orb",
            Feature::Akaze => "akaze",
        }
    }
}

impl fmt::Display for Feature {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl FromStr for Feature {
    type Err = SettingsError;

    fn from_str(name: &str) -> Result<Self, SettingsError> {
        Feature::ALL
            .into_iter()
            .find(|feature| feature.name() == name)
            .ok_or_else(|| SettingsError::UnknownFeature { found: name.to_owned() })
    }
}

/// Why a text or numbers are no feature settings.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingsError {
    /// No feature of this name.
    #[error("unknown feature \"{found}\"; use sift, rootsift, upright-rootsift, orb or akaze")]
    UnknownFeature {
        /// The name given.
        found: String,
    },
    /// The number of features is out of range.
    #[error(
        "{found} features per image is out of range; use {min} to {max}",
        min = FeatureSettings::MIN_FEATURES,
        max = FeatureSettings::MAX_FEATURES
    )]
    FeatureCount {
        /// The number given.
        found: u32,
    },
    /// The image width is out of range.
    #[error(
        "an image width of {found} pixels is out of range; use {min} to {max}",
        min = FeatureSettings::MIN_IMAGE_WIDTH,
        max = FeatureSettings::MAX_IMAGE_WIDTH
    )]
    ImageWidth {
        /// The width given, in pixels.
        found: u32,
    },
    /// Not the one text form of settings.
    #[error("\"{found}\" is not feature settings; write them like \"{example}\"", example = FeatureSettings::default())]
    Malformed {
        /// The text given.
        found: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_default_settings_have_their_known_text() {
        assert_eq!(FeatureSettings::default().to_string(), "rootsift features=500 width=640");
    }

    #[test]
    fn any_other_text_is_refused() {
        for text in [
            "",
            "rootsift",
            "rootsift features=500",
            "rootsift width=640 features=500",
            "rootsift features=0500 width=640",
            "rootsift features=+500 width=640",
            "rootsift features=500 width=640 ",
            " rootsift features=500 width=640",
            "rootsift  features=500 width=640",
            "rootsift features=500 width=640 width=640",
            "rootsift features=-1 width=640",
            "rootsift features=99999999999 width=640",
        ] {
            let error = text.parse::<FeatureSettings>().unwrap_err();
            let helps = error.to_string().contains("rootsift");
            assert!(helps, "{text:?}: {error}");
        }
        let unknown = "surf features=500 width=640".parse::<FeatureSettings>();
        assert_eq!(unknown, Err(SettingsError::UnknownFeature { found: "surf".to_owned() }));
        let none = "orb features=0 width=640".parse::<FeatureSettings>();
        assert_eq!(none, Err(SettingsError::FeatureCount { found: 0 }));
        let wide = "orb features=500 width=5000".parse::<FeatureSettings>();
        assert_eq!(wide, Err(SettingsError::ImageWidth { found: 5000 }));
    }

    proptest! {
        #[test]
        fn settings_survive_their_text(
            feature in prop::sample::select(Feature::ALL.to_vec()),
            max_features in FeatureSettings::MIN_FEATURES..=FeatureSettings::MAX_FEATURES,
            image_width in FeatureSettings::MIN_IMAGE_WIDTH..=FeatureSettings::MAX_IMAGE_WIDTH,
        ) {
            let settings = FeatureSettings::new(feature, max_features, image_width).unwrap();
            prop_assert_eq!(settings.to_string().parse(), Ok(settings));
        }

        #[test]
        fn text_that_parses_is_the_only_one(text in "(sift|orb) features=[+0]?[0-9]{1,5} width=[0 ]?[0-9]{2,4}") {
            if let Ok(settings) = text.parse::<FeatureSettings>() {
                prop_assert_eq!(settings.to_string(), text);
            }
        }
    }
}
