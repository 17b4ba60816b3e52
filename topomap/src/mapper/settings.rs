use fabmap::recognizer::RecognizerSettings;

use crate::verification::VerificationSettings;

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
        }
    }
}
