//! What lamps and the hour of day make of a building.

use crate::random::{Draws, derived_seed, unit};
use crate::range::{self, OutOfRange};

/// Light and the camera's answer to it: grey value 255 (l v / 255)^gamma for a surface of grey
/// value v, with l the gain, times the room's lamp, times 1 + directed cos (angle between the
/// surface's normal and where the light comes from).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    settings: LightSettings,
}

/// Numbers of a [`Light`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSettings {
    /// Brightness of everything, in (0, 4]; 1 for textures as they are painted.
    pub gain: f64,
    /// In [0.25, 4]; above 1 darkens the middle greys.
    pub gamma: f64,
    /// Lamps of rooms are between 1 - spread and 1 + spread, in [0, 0.9].
    pub lamp_spread: f64,
    /// How much brighter surfaces are that face the light than those that stand across, in [0,
    /// 0.9].
    pub directed: f64,
    /// Where the light comes from, seen from above, in radians.
    pub from_rad: f64,
    /// Which room's lamp is how bright.
    pub seed: u64,
}

impl Default for Light {
    /// Lamps all alike, with a little more light from one side, so that corners show.
    fn default() -> Self {
        let settings =
            LightSettings { gain: 1.0, gamma: 1.0, lamp_spread: 0.0, directed: 0.15, from_rad: 0.7, seed: 0 };
        Self { settings }
    }
}

impl Light {
    /// # Errors
    /// [`OutOfRange`] if a number is out of its range.
    pub fn new(settings: LightSettings) -> Result<Self, OutOfRange> {
        let LightSettings { gain, gamma, lamp_spread, directed, from_rad, seed: _ } = settings;
        range::check(&[
            ("gain", gain, 0.01, 4.0),
            ("gamma", gamma, 0.25, 4.0),
            ("lamp_spread", lamp_spread, 0.0, 0.9),
            ("directed", directed, 0.0, 0.9),
            ("from_rad", from_rad, -100.0, 100.0),
        ])?;
        Ok(Self { settings })
    }

    /// Some hour of some day: gain ±30 %, gamma 0.8 to 1.25, lamps ±25 %, light from anywhere.
    #[must_use]
    pub fn drawn(seed: u64) -> Self {
        let mut draws = Draws::new(derived_seed(seed, 0x11_9417));
        let settings = LightSettings {
            gain: draws.between(0.7, 1.3),
            gamma: draws.between(0.8, 1.25),
            lamp_spread: 0.25,
            directed: draws.between(0.05, 0.3),
            from_rad: draws.between(0.0, std::f64::consts::TAU),
            seed,
        };
        Self { settings }
    }

    pub(crate) fn settings(&self) -> &LightSettings {
        &self.settings
    }

    /// How bright a room's lamp is.
    pub(crate) fn lamp(&self, room: usize) -> f32 {
        let LightSettings { lamp_spread, seed, .. } = self.settings;
        (1.0 + lamp_spread * (2.0 * unit(derived_seed(seed, room as u64)) - 1.0)) as f32
    }
}
