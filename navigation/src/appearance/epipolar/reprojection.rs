//! How far two rays are from meeting in a point before both cameras.

use std::f64::consts::{PI, SQRT_2};

use nalgebra::{Rotation3, Unit, Vector3};

use super::RayPair;

/// How far a pair is from one that a motion explains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reprojection {
    /// The least turns of both rays that make them meet in a point before both cameras, or far
    /// away: root of the sum of both squares, in radians.
    pub error_rad: f64,
    /// By how much the ray from the target is nearer to the way than the robot's, in radians: so
    /// far they part instead of meeting. 0 if they meet.
    pub behind_rad: f64,
}

/// How far a pair is from one that is explained by the rotation R and the way towards the target,
/// in current axes.
///
/// Rays meet if they lie in one half plane that the way bounds, and the one from the target is
/// further away from the way's direction than the robot's. The least of these turns brings them
/// there:
/// - into the nearest plane through the way, where they meet in it as they are. Its sum of squared
///   sines is λ = (p² + q² - √((p² - q²)² + 4 (p·q)²)) / 2, with p and q the parts of the rays
///   across the way: the smaller eigenvalue of p pᵀ + q qᵀ;
/// - halfway towards each other: parallel rays meet far away;
/// - the robot's ray onto the way, or the target's onto its other end.
#[must_use]
pub fn reprojection(rotation: &Rotation3<f64>, way: &Unit<Vector3<f64>>, pair: &RayPair) -> Reprojection {
    let x = pair.current;
    let y = rotation * pair.target;
    let along_x = x.dot(way);
    let along_y = y.dot(way);
    let across = x.dot(&y) - along_x * along_y;
    let p = (1.0 - along_x * along_x).max(0.0);
    let q = (1.0 - along_y * along_y).max(0.0);
    let from_x = p.sqrt().atan2(along_x);
    let from_y = q.sqrt().atan2(along_y);
    let parallel = x.cross(&y).norm().atan2(x.dot(&y)) / SQRT_2;
    let mut error_rad = parallel.min(from_x).min(PI - from_y);
    if across >= 0.0 && from_x <= from_y {
        let difference = p - q;
        let squared = (p + q - (difference * difference + 4.0 * across * across).sqrt()) / 2.0;
        error_rad = error_rad.min(squared.max(0.0).sqrt());
    }
    Reprojection { error_rad, behind_rad: (from_x - from_y).max(0.0) }
}
