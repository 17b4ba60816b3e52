//! How far two rays are from meeting in a point before both cameras.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Unit, Vector3};

use super::RayPair;

/// The least turns of both rays that make them meet in a point before both cameras, or far away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reprojection {
    /// Turn into one plane with the way, root of the sum of both squares, in radians.
    pub off_plane_rad: f64,
    /// Angle within that plane by which the rays part instead of meeting, in radians; 0 if they
    /// meet.
    pub behind_rad: f64,
}

impl Reprojection {
    /// Root of the sum of both rays' squared turns, in radians.
    #[must_use]
    pub fn error_rad(&self) -> f64 {
        // Both rays share the turn that makes them parallel.
        self.off_plane_rad.hypot(self.behind_rad / std::f64::consts::SQRT_2)
    }
}

/// How far a pair is from one that is explained by the rotation R and the way towards the target,
/// in current axes.
///
/// The plane through the way that is nearest to both rays has the sum of squared sines
/// λ = (p² + q² - √((p² - q²)² + 4 (p·q)²)) / 2, with p and q the parts of the rays across the way:
/// the smaller eigenvalue of p pᵀ + q qᵀ. Within it, the ray from the target must be further away from the
/// way's direction than the robot's.
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
    if across < 0.0 {
        return on_either_side([from_x, from_y]);
    }
    let difference = p - q;
    let squared = (p + q - (difference * difference + 4.0 * across * across).sqrt()) / 2.0;
    Reprojection { off_plane_rad: squared.max(0.0).sqrt(), behind_rad: (from_x - from_y).max(0.0) }
}

/// Rays to either side of the way: the one that is nearer to the way, or to its other end, is
/// turned there.
fn on_either_side([from_x, from_y]: [f64; 2]) -> Reprojection {
    let [pole_x, pole_y] = [from_x, from_y].map(|angle| if angle > PI / 2.0 { PI } else { 0.0 });
    let turn_x = (from_x - pole_x).abs();
    let turn_y = (from_y - pole_y).abs();
    let (off_plane_rad, [x, y]) =
        if turn_x <= turn_y { (turn_x, [pole_x, from_y]) } else { (turn_y, [from_x, pole_y]) };
    Reprojection { off_plane_rad, behind_rad: (x - y).max(0.0) }
}
