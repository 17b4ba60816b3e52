//! What a camera sees: rays through each column, and from each of its pixels the first surface.

mod column;

use rayon::prelude::*;

use crate::camera::{Camera, RowSlope};
use crate::image::GreyImage;
use crate::light::Light;
use crate::people::Person;
use crate::pose::Pose;
use crate::random::derived_seed;
use crate::range::{self, OutOfRange};
use crate::scene::Scene;

/// A camera on a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraRig {
    camera: Camera,
    mount: Mount,
    sensor: Sensor,
}

/// Where on the robot the camera is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// Ahead of the robot's axle, in metres.
    pub forward_m: f64,
    /// Above the floor, in metres.
    pub height_m: f64,
    /// The way it looks, counter-clockwise from ahead, in radians.
    pub yaw_rad: f64,
}

/// What the camera's electronics and lens make of the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// How long light falls in, in seconds: what moves meanwhile is blurred.
    pub exposure_s: f64,
    /// Standard deviation of the noise of a pixel, in grey values.
    pub noise_sigma: f64,
    /// Share of a pixel's light that falls on each of its four neighbours' sides, in [0, 0.25].
    pub softness: f64,
}

/// All that an image depends on, besides scene and camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Of the robot, in the middle of the exposure.
    pub pose: Pose,
    /// Metres a second ahead, and radians a second to the left, during the exposure.
    pub speed: [f64; 2],
    /// Who is about.
    pub people: Vec<Person>,
    /// How it is lit.
    pub light: Light,
    /// Of the noise.
    pub seed: u64,
}

impl Default for Mount {
    fn default() -> Self {
        Self { forward_m: 0.0, height_m: 1.0, yaw_rad: 0.0 }
    }
}

impl Default for Sensor {
    fn default() -> Self {
        Self { exposure_s: 0.01, noise_sigma: 2.0, softness: 0.08 }
    }
}

impl CameraRig {
    /// # Errors
    /// [`OutOfRange`] if a number is out of its range.
    pub fn new(camera: Camera, mount: Mount, sensor: Sensor) -> Result<Self, OutOfRange> {
        range::check(&[
            ("forward_m", mount.forward_m, -2.0, 2.0),
            ("height_m", mount.height_m, 0.05, 1.4),
            ("yaw_rad", mount.yaw_rad, -std::f64::consts::TAU, std::f64::consts::TAU),
            ("exposure_s", sensor.exposure_s, 0.0, 0.5),
            ("noise_sigma", sensor.noise_sigma, 0.0, 64.0),
            ("softness", sensor.softness, 0.0, 0.25),
        ])?;
        Ok(Self { camera, mount, sensor })
    }

    /// Its pixels and rays.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Where it is on the robot.
    #[must_use]
    pub fn mount(&self) -> &Mount {
        &self.mount
    }

    /// The camera's pose when the robot is at `robot`.
    #[must_use]
    pub fn pose(&self, robot: &Pose) -> Pose {
        robot.compose(&Pose::new(self.mount.forward_m, 0.0, self.mount.yaw_rad))
    }

    /// Poses of the robot during the exposure, one for each pixel that the image moves, and their
    /// weight.
    fn exposure(&self, shot: &Shot) -> Vec<Pose> {
        let [forward, turn] = shot.speed.map(|speed| speed * self.sensor.exposure_s);
        // Things are a metre away or more, mostly.
        let moved_px = (turn.abs() + forward.abs() / 2.0) * self.camera.pixels_per_rad();
        let poses = (moved_px.ceil() as usize).clamp(1, MAX_EXPOSURES);
        let share = |index: usize| (index as f64 + 0.5) / poses as f64 - 0.5;
        (0..poses).map(|index| shot.pose.driven(share(index) * forward, share(index) * turn)).collect()
    }
}

const MAX_EXPOSURES: usize = 8;

/// Columns that a thread takes at once.
const COLUMNS: usize = 32;

impl Scene {
    /// The image of a shot. The same on any number of threads.
    #[must_use]
    pub fn render(&self, rig: &CameraRig, shot: &Shot) -> GreyImage {
        let (width, height) = (rig.camera.width_px() as usize, rig.camera.height_px() as usize);
        let slopes = rig.camera.row_slopes();
        let exposure = rig.exposure(shot);
        let views: Vec<Pose> = exposure.iter().map(|robot| rig.pose(robot)).collect();
        // Column by column.
        let mut light = vec![0.0; width * height];
        light.par_chunks_mut(COLUMNS * height).enumerate().for_each(|(block, light)| {
            for (column, light) in light.chunks_mut(height).enumerate() {
                self.expose_column(rig, shot, &views, &slopes, block * COLUMNS + column, light);
            }
        });
        let light = softened(light, height, rig.sensor.softness as f32);
        develop(&light, rig, shot)
    }

    fn expose_column(
        &self,
        rig: &CameraRig,
        shot: &Shot,
        views: &[Pose],
        slopes: &[RowSlope],
        column: usize,
        light: &mut [f32],
    ) {
        let ray = rig.camera.column_ray(column as u32);
        for view in views {
            let slabs = self.slabs(view, ray, shot, rig.mount.height_m as f32);
            for (light, slope) in light.iter_mut().zip(slopes) {
                *light += slabs.light(*slope);
            }
        }
        let weight = 1.0 / views.len() as f32;
        light.iter_mut().for_each(|light| *light *= weight);
    }
}

/// Spreads each pixel's light over its neighbours', along columns and then along rows.
fn softened(light: Vec<f32>, height: usize, softness: f32) -> Vec<f32> {
    if softness == 0.0 {
        return light;
    }
    let spread = |before: f32, here: f32, after: f32| here + softness * (before + after - 2.0 * here);
    let mut down = Vec::with_capacity(light.len());
    for column in light.chunks(height) {
        let at = |row: usize| column[row.min(height - 1)];
        down.extend((0..height).map(|row| spread(at(row.saturating_sub(1)), at(row), at(row + 1))));
    }
    let last = down.len() - height;
    let across = |index: usize| {
        let before = if index < height { index } else { index - height };
        let after = if index >= last { index } else { index + height };
        spread(down[before], down[index], down[after])
    };
    (0..down.len()).map(across).collect()
}

/// From light by columns to grey values by rows.
fn develop(light: &[f32], rig: &CameraRig, shot: &Shot) -> GreyImage {
    let (width, height) = (rig.camera.width_px() as usize, rig.camera.height_px() as usize);
    let gain = shot.light.settings().gain as f32;
    let curve = ToneCurve::new(shot.light.settings().gamma);
    let noise = rig.sensor.noise_sigma as f32;
    let grey = |row: usize, column: usize| {
        let grey = curve.grey(gain * light[column * height + row]);
        let pixel = (row * width + column) as u64;
        (grey + 0.5 + noise * about_normal(derived_seed(shot.seed, pixel))).clamp(0.0, 255.0) as u8
    };
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| grey(row, column))).collect();
    #[expect(clippy::expect_used, reason = "a camera has as many pixels as it has columns and rows")]
    GreyImage::new(rig.camera.width_px(), rig.camera.height_px(), pixels).expect("all pixels are there")
}

/// 255 (light / 255)^gamma, from a table.
struct ToneCurve(Vec<f32>);

impl ToneCurve {
    const STEPS: usize = 512;
    /// Brightest light that it can distinguish, in grey values.
    const MOST: f32 = 1024.0;

    fn new(gamma: f64) -> Self {
        let grey = |step: usize| {
            let light = step as f64 / Self::STEPS as f64 * f64::from(Self::MOST) / 255.0;
            (255.0 * light.powf(gamma)) as f32
        };
        Self((0..=Self::STEPS + 1).map(grey).collect())
    }

    fn grey(&self, light: f32) -> f32 {
        let at = light.clamp(0.0, Self::MOST) * (Self::STEPS as f32 / Self::MOST);
        let step = at as usize;
        self.0[step] + (at - step as f32) * (self.0[step + 1] - self.0[step])
    }
}

/// Mean 0, variance 1: the sum of four uniform numbers.
fn about_normal(seed: u64) -> f32 {
    let sum: u64 = (0..4).map(|part| (seed >> (16 * part)) & 0xffff).sum();
    (sum as f32 / 65535.0 - 2.0) * 1.732_050_8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_mean_0_and_variance_1() {
        let draws: Vec<f64> =
            (0..100_000).map(|pixel| f64::from(about_normal(derived_seed(3, pixel)))).collect();
        let mean = draws.iter().sum::<f64>() / 1e5;
        let variance = draws.iter().map(|draw| draw * draw).sum::<f64>() / 1e5;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.02, "mean {mean}, variance {variance}");
    }

    #[test]
    fn the_tone_curve_is_the_formula() {
        for (gamma, light) in [(1.0, 100.0), (2.0, 100.0), (0.5, 180.0), (1.0, 255.0)] {
            let expected = 255.0 * (f64::from(light) / 255.0_f64).powf(gamma);
            assert!(
                (f64::from(ToneCurve::new(gamma).grey(light)) - expected).abs() < 0.5,
                "{gamma} of {light}"
            );
        }
    }
}
