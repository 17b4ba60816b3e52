//! Whether a robot's images turn as far as its wheels do.
//!
//! They do not where the camera has another field of view than the declared one, where the wheels'
//! turns are off, or where images and odometry that are sent together are not of the same moment.
//! All three bend the depths of features and with them what closures measure.

use std::f64::consts::PI;

use nalgebra::Vector3;
use topomap::metric::{RelativePose, median};

use super::motion::Pair;
use super::nodding::Motion;
use super::robot_camera::{RobotCamera, Sighted};

/// Turns below this, in radians, say little of a scale.
const LEAST_TURN_RAD: f64 = 5.0 / 180.0 * PI;

/// Features, fewer of which say little.
const LEAST_FEATURES: usize = 12;

/// The way between two images may move a feature that is so far away, in metres, by such a share of
/// the turn.
const NEAR_M: f64 = 2.0;
const SHARE_OF_TURN: f64 = 0.1;

/// How many times as far as the wheels the images turned; `None` if the robot hardly turned, or
/// the images do not say.
///
/// Things move to the right by as much as the robot turns left. They move by the robot's way, too,
/// but hardly those that lie where it drives to: these are looked at. Epipolar geometry would know a
/// turn from noise better, but where the camera moves to its side it takes one field of view for
/// another turn.
pub(super) fn images_per_wheels(camera: &RobotCamera, pairs: &[Pair], wheels: &RelativePose) -> Option<f64> {
    let turn_rad = wheels.pose().heading_rad();
    if turn_rad.abs() < LEAST_TURN_RAD {
        return None;
    }
    let center_m = camera.center_m();
    let shift_m = Motion::level(*wheels.pose()).carried(&center_m) - center_m;
    let most_across_m = SHARE_OF_TURN * turn_rad.abs() * NEAR_M;
    let azimuth_rad = |sighted: &Sighted| {
        let ray: Vector3<f64> = camera.rotation() * sighted.ray();
        ray.y.atan2(ray.x)
    };
    let turned_rad = |pair: &Pair| {
        let azimuth_before_rad = azimuth_rad(&pair.earlier);
        let (sine, cosine) = azimuth_before_rad.sin_cos();
        let across_m = shift_m.y * cosine - shift_m.x * sine;
        (across_m.abs() <= most_across_m).then(|| wrapped(azimuth_before_rad - azimuth_rad(&pair.later)))
    };
    let mut turned_rad: Vec<f64> = pairs.iter().filter_map(turned_rad).collect();
    if turned_rad.len() < LEAST_FEATURES {
        return None;
    }
    median(&mut turned_rad).map(|turned_rad| turned_rad / turn_rad)
}

fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(2.0 * PI) - PI
}
