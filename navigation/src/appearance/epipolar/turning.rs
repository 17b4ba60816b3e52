//! A robot that has at most turned on the spot: every ray turns by one angle about the upright
//! axis, near or far.

use nalgebra::Rotation3;

use super::RayPair;

/// By how much a view is turned, and how many pairs say so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// R of [`super::Motion::rotation`]: takes directions of the target's axes to the current ones,
    /// to the left, in (-π, π].
    pub rotation_rad: f64,
    /// Pairs that it explains without any way between the two.
    pub agreeing: usize,
}

/// The turn on the spot that most pairs agree with, each to `tolerance_rad`: of the turns that some
/// pair names. `None` without pairs.
#[must_use]
pub fn turn(pairs: &[RayPair], tolerance_rad: f64) -> Option<Turn> {
    let named = pairs.iter().map(|pair| {
        let [now, then] = [pair.current, pair.target].map(|ray| ray.y.atan2(ray.x));
        let rotation_rad = (now - then).sin().atan2((now - then).cos());
        Turn { rotation_rad, agreeing: agreeing(pairs, rotation_rad, tolerance_rad) }
    });
    // Of equals the first.
    named.reduce(|best, turn| if turn.agreeing > best.agreeing { turn } else { best })
}

fn agreeing(pairs: &[RayPair], rotation_rad: f64, tolerance_rad: f64) -> usize {
    let rotation = Rotation3::from_euler_angles(0.0, 0.0, rotation_rad);
    let least_cosine = tolerance_rad.cos();
    pairs.iter().filter(|pair| (rotation * pair.target).dot(&pair.current) >= least_cosine).count()
}
