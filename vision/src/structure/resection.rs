//! Where three landmarks are seen from: the minimal problem of a robot on a plane.

use nalgebra::{Matrix3x4, Vector3};
use posegraph::PlanarPose;

/// A point of the plane, and the direction in which it is seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bearing {
    pub(super) x_m: f64,
    pub(super) y_m: f64,
    /// Counter-clockwise from the observer's heading, in radians.
    pub(super) azimuth_rad: f64,
}

/// The pose of the observer that sees all three in their directions; `None` if there is none, or
/// they lie so that it is not determined.
///
/// With the heading's cosine c and sine s, p = c x + s y and q = s x - c y, each landmark (X, Y)
/// seen along (a, b) gives the linear c (b X - a Y) + s (a X + b Y) - b p - a q = 0. Three of them
/// leave one direction, whose length follows from c² + s² = 1.
pub(super) fn observer_of(bearings: &[Bearing; 3]) -> Option<PlanarPose> {
    let mut rows = Matrix3x4::zeros();
    for (row, bearing) in bearings.iter().enumerate() {
        let (b, a) = bearing.azimuth_rad.sin_cos();
        let (x, y) = (bearing.x_m, bearing.y_m);
        rows.set_row(row, &nalgebra::RowVector4::new(b * x - a * y, a * x + b * y, -b, -a));
    }
    // The generalised cross product of the three rows.
    let minor = |without: usize| {
        let columns: Vec<usize> = (0..4).filter(|&column| column != without).collect();
        let column = |index: usize| -> Vector3<f64> { rows.column(columns[index]).into_owned() };
        let sign = if without.is_multiple_of(2) { 1.0 } else { -1.0 };
        sign * column(0).dot(&column(1).cross(&column(2)))
    };
    let [cosine, sine, p, q] = [minor(0), minor(1), minor(2), minor(3)];
    let length = cosine.hypot(sine);
    if length.is_nan() || length <= 1e-9 * p.hypot(q).max(1.0) {
        return None;
    }
    let scaled = [cosine, sine, p, q].map(|value| value / length);
    // Two observers see the landmarks on the same lines: one of them behind itself.
    let pose = |[cosine, sine, p, q]: [f64; 4]| {
        PlanarPose::new(cosine * p + sine * q, sine * p - cosine * q, sine.atan2(cosine))
    };
    [pose(scaled), pose(scaled.map(|value| -value))]
        .into_iter()
        .find(|pose| pose.is_finite_and_sees(bearings))
}

trait Observer {
    fn is_finite_and_sees(&self, bearings: &[Bearing; 3]) -> bool;
}

impl Observer for PlanarPose {
    fn is_finite_and_sees(&self, bearings: &[Bearing; 3]) -> bool {
        use posegraph::Pose;
        let ahead = |bearing: &Bearing| {
            let (sine, cosine) = (bearing.azimuth_rad + self.heading_rad()).sin_cos();
            (bearing.x_m - self.x_m()) * cosine + (bearing.y_m - self.y_m()) * sine > 0.0
        };
        self.is_finite() && bearings.iter().all(ahead)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posegraph::Pose;
    use proptest::prelude::*;

    /// How far a point is from the circle through three others, as a share of its radius.
    fn off_circle([a, b, c]: [(f64, f64); 3], point: (f64, f64)) -> f64 {
        let square = |(x, y): (f64, f64)| x * x + y * y;
        let twice_area = 2.0 * (a.0 * (b.1 - c.1) + b.0 * (c.1 - a.1) + c.0 * (a.1 - b.1));
        let center_x =
            (square(a) * (b.1 - c.1) + square(b) * (c.1 - a.1) + square(c) * (a.1 - b.1)) / twice_area;
        let center_y =
            (square(a) * (c.0 - b.0) + square(b) * (a.0 - c.0) + square(c) * (b.0 - a.0)) / twice_area;
        let distance = |(x, y): (f64, f64)| (x - center_x).hypot(y - center_y);
        (distance(point) / distance(a) - 1.0).abs()
    }

    proptest! {
        #[test]
        fn the_observer_is_found(
            x in -3.0..3.0f64, y in -3.0..3.0f64, heading in -3.1..3.1f64,
            landmarks in prop::array::uniform3((-6.0..6.0f64, -6.0..6.0f64)),
        ) {
            let observer = PlanarPose::new(x, y, heading);
            let bearing = |(x_m, y_m): (f64, f64)| {
                let azimuth_rad = (y_m - y).atan2(x_m - x) - heading;
                Bearing { x_m, y_m, azimuth_rad }
            };
            let bearings = landmarks.map(bearing);
            // On one circle with the observer, or in one line, nothing is determined.
            let far = |a: usize, b: usize| (bearings[a].azimuth_rad - bearings[b].azimuth_rad).sin().abs() > 0.05;
            prop_assume!(far(0, 1) && far(1, 2) && far(0, 2));
            prop_assume!(off_circle(landmarks, (x, y)) > 0.05);
            let found = observer_of(&bearings);
            prop_assert!(found.is_some(), "nobody for {observer:?}");
            let found = found.unwrap();
            let error = PlanarPose::error(&observer, &PlanarPose::identity(), &found).norm();
            prop_assert!(error < 1e-6, "{found:?} for {observer:?}");
        }
    }

    #[test]
    fn three_corners_of_a_room_say_where_one_stands() {
        let observer = PlanarPose::new(1.0, 2.0, 0.3);
        let bearing =
            |[x_m, y_m]: [f64; 2]| Bearing { x_m, y_m, azimuth_rad: (y_m - 2.0_f64).atan2(x_m - 1.0) - 0.3 };
        let found = observer_of(&[[5.0, 0.0], [5.0, 4.0], [3.0, 6.0]].map(bearing)).unwrap();
        assert!(PlanarPose::error(&observer, &PlanarPose::identity(), &found).norm() < 1e-9, "{found:?}");
    }
}
