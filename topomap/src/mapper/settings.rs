use fabmap::recognizer::RecognizerSettings;

use super::MapperError;
use crate::map::MAX_PAST_FRAMES;
use crate::odometry_prior::PlaceSpacing;
use crate::relative_pose::OdometryNoise;
use crate::verification::VerificationSettings;

/// When a frame of a session that lets the map grow makes a place of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlaceRule {
    /// Where no place is recognised.
    #[default]
    Unrecognized,
    /// Always, unless the robot is at its last place still, by its wheels or because it sees from the same spot what the
    /// place shows all around: for maps whose images are to be seen one by one, such as an appearance graph's. Nothing closes
    /// a loop.
    EachFrame,
}

/// How a map decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapperSettings {
    /// How places are recognised.
    pub recognizer: RecognizerSettings,
    /// Posterior from which another place is accepted as a loop closure, in (0, 1], if geometry has nothing
    /// against it.
    pub closure_threshold: f64,
    /// What geometry has to say before a loop is closed.
    pub verification: VerificationSettings,
    /// A place that the session left fewer frames ago is not a loop closure.
    pub guard_frames: u64,
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
    /// Earlier frames that the prior with odometry looks back on, 1 to [`crate::map::MAX_PAST_FRAMES`].
    pub prior_frames: usize,
}

impl MapperSettings {
    /// Whether what is in metres and radians is in range.
    pub(super) fn check_metric(&self) -> Result<(), MapperError> {
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
