//! How a map decides, and what its settings may be.

use std::f64::consts::FRAC_PI_2;

use fabmap::recognizer::{RecognizerError, RecognizerSettings};

use crate::evidence::{Candidate, Verdict, VerificationError, VerificationSettings};
use crate::metric::{Odometry, OdometryNoise, PlaceSpacing};

/// Frames that a session's prior looks back on, at most.
pub const MAX_PAST_FRAMES: usize = 4;

/// When a frame of a session that lets the map grow makes a place of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlaceRule {
    /// Where no place is recognised.
    #[default]
    Unrecognized,
    /// Always, unless the robot is at its last place still, by its wheels or because it sees from
    /// the same spot what the place shows all around: for maps whose images are to be seen one by
    /// one, such as an appearance graph's. Nothing closes a loop.
    EachFrame,
}

/// What the guard counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GuardMeasure {
    /// Frames, and of those that are closer together than places their share of the spacing.
    #[default]
    Way,
    /// Frames alone, as in maps that were made before ways counted.
    Frames,
}

/// How a map decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapperSettings {
    /// How places are recognised.
    pub recognizer: RecognizerSettings,
    /// Probability from which another place is accepted as a loop closure, in (0, 1]: that of
    /// [`Candidate::probability`], by words, order and geometry; where there is no geometry, the
    /// posterior.
    pub closure_threshold: f64,
    /// What geometry has to say before a loop is closed.
    pub verification: VerificationSettings,
    /// A place that the session left fewer frames ago is not a loop closure. Frames that wheels put
    /// closer together than places are count by as much of the place spacing as they are apart.
    pub guard_frames: u64,
    /// What that counts.
    pub guard_measure: GuardMeasure,
    /// Looks that a place may learn from one stay, at least 1.
    pub looks_per_stay: u32,
    /// Different words that a frame must show to be recognised or learnt.
    pub min_words: usize,
    /// Speed above which odometry must have jumped, in m/s.
    pub max_speed_m_per_s: f64,
    /// Where there is odometry: how far a robot goes before it is at another place.
    pub place_spacing: PlaceSpacing,
    /// When a frame makes a place.
    pub place_rule: PlaceRule,
    /// How far wheels can be trusted, where their own covariance does not say.
    pub odometry_noise: OdometryNoise,
    /// Earlier frames that the prior with odometry looks back on, 1 to [`MAX_PAST_FRAMES`].
    pub prior_frames: usize,
}

impl MapperSettings {
    /// Whether geometry and words hold a candidate of a frame for the same place, and why.
    #[must_use]
    pub fn verdict(&self, candidate: &Candidate) -> Verdict {
        self.verification.verdict(candidate, self.closure_threshold, &self.place_spacing)
    }

    /// The same for a frame of a robot with wheels whose camera has such a focal length, in image
    /// widths: an image that has moved further than a turn as wide as a place reaches would move it
    /// is not of that place. Where structure measures the turn, that is judged and not the image.
    #[must_use]
    pub fn for_frame(&self, odometry: Option<&Odometry>, focal_length_widths: Option<f64>) -> Self {
        let reach_rad = self.place_spacing.reach().angle_rad;
        let (Some(_), Some(focal_length), true) = (odometry, focal_length_widths, reach_rad < FRAC_PI_2)
        else {
            return *self;
        };
        let bound = self.verification.max_translation_widths.min(focal_length * reach_rad.tan());
        let verification = VerificationSettings { max_translation_widths: bound, ..self.verification };
        Self { verification, ..*self }
    }

    /// Whether what is in metres and radians is in range.
    pub(crate) fn check_metric(&self) -> Result<(), MapperError> {
        let PlaceSpacing { distance_m, angle_rad } = self.place_spacing;
        let OdometryNoise {
            translation_share,
            heading_rad_per_m,
            turn_share,
            position_floor_m,
            heading_floor_rad,
        } = self.odometry_noise;
        let above_zero = [
            ("place spacing", distance_m),
            ("angle between places", angle_rad),
            ("odometry's least position error", position_floor_m),
            ("odometry's least heading error", heading_floor_rad),
        ];
        let not_negative = [
            ("odometry's share of a distance", translation_share),
            ("odometry's heading error per metre", heading_rad_per_m),
            ("odometry's share of a turn", turn_share),
        ];
        let wrong = |value: f64| !value.is_finite() || value <= 0.0;
        if let Some(&(quantity, value)) = above_zero.iter().find(|(_, value)| wrong(*value)) {
            return Err(MapperError::Metric { quantity, value });
        }
        let wrong = |value: f64| !value.is_finite() || value < 0.0;
        if let Some(&(quantity, value)) = not_negative.iter().find(|(_, value)| wrong(*value)) {
            return Err(MapperError::Metric { quantity, value });
        }
        if !(1..=MAX_PAST_FRAMES).contains(&self.prior_frames) {
            return Err(MapperError::PriorFrames { value: self.prior_frames });
        }
        Ok(())
    }
}

impl Default for MapperSettings {
    fn default() -> Self {
        Self {
            recognizer: RecognizerSettings::default(),
            closure_threshold: 0.99,
            verification: VerificationSettings::default(),
            guard_frames: 20,
            guard_measure: GuardMeasure::default(),
            looks_per_stay: 3,
            min_words: 10,
            max_speed_m_per_s: 100.0,
            place_spacing: PlaceSpacing::default(),
            place_rule: PlaceRule::default(),
            odometry_noise: OdometryNoise::default(),
            prior_frames: MAX_PAST_FRAMES,
        }
    }
}

/// Settings and model do not make a map.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MapperError {
    /// A setting of the recognizer.
    #[error(transparent)]
    Recognizer(#[from] RecognizerError),
    /// The threshold is no probability.
    #[error("the closure threshold must be above 0 and at most 1, not {value}; leave it out for the default")]
    ClosureThreshold {
        /// The value given.
        value: f64,
    },
    /// A setting of the verification.
    #[error(transparent)]
    Verification(#[from] VerificationError),
    /// A stay that teaches nothing would leave new places empty.
    #[error("a place must learn at least 1 look from a stay; 3 is a good start")]
    LooksPerStay,
    /// The speed is not positive.
    #[error("the highest speed must be above 0 m/s, not {value}; 100 is a good start")]
    MaxSpeed {
        /// The value given.
        value: f64,
    },
    /// A length, angle or share that is none.
    #[error("the {quantity} must be a number above 0, not {value}; leave it out for the default")]
    Metric {
        /// What it is.
        quantity: &'static str,
        /// The value given.
        value: f64,
    },
    /// No frame to look back on, or more than are kept.
    #[error("the prior can look back on 1 to {max} frames, not {value}", max = MAX_PAST_FRAMES)]
    PriorFrames {
        /// The value given.
        value: usize,
    },
}
