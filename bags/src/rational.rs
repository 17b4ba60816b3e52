//! The rational distortion model as Brown and Conrady's, where both are as good as the same over an image.

/// The largest error at which one stands for the other, in pixels: below what corners of a calibration are found to.
pub(crate) const MOST_ERROR_PX: f64 = 0.5;
/// Points along the longer and the shorter side.
const GRID: (u32, u32) = (65, 49);
const MOST_STEPS: usize = 50;
/// Where the inverse is found, in units of the focal length.
const TOLERANCE: f64 = 1e-9;

/// A distortion that stands for another.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Fit {
    /// k1, k2, p1, p2, k3.
    pub(crate) distortion: [f64; 5],
    /// How far both are apart at most, over the image.
    pub(crate) error_px: f64,
}

/// The rational model of OpenCV (k1, k2, p1, p2, k3, k4, k5, k6), of points on the plane at distance 1.
fn distorted([k1, k2, p1, p2, k3, k4, k5, k6]: [f64; 8], [x, y]: [f64; 2]) -> [f64; 2] {
    let r2 = x * x + y * y;
    let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
    let across = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
    let down = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
    [x * radial + across, y * radial + down]
}

/// The point that is distorted to another, by Newton's method; none where there is none near.
fn undistorted(parameters: [f64; 8], wanted: [f64; 2]) -> Option<[f64; 2]> {
    const STEP: f64 = 1e-6;
    let mut point = wanted;
    for _ in 0..MOST_STEPS {
        let at = distorted(parameters, point);
        let (miss_x, miss_y) = (wanted[0] - at[0], wanted[1] - at[1]);
        if miss_x.hypot(miss_y) < TOLERANCE {
            return Some(point);
        }
        let along_x = distorted(parameters, [point[0] + STEP, point[1]]);
        let along_y = distorted(parameters, [point[0], point[1] + STEP]);
        let (a, c) = ((along_x[0] - at[0]) / STEP, (along_x[1] - at[1]) / STEP);
        let (b, d) = ((along_y[0] - at[0]) / STEP, (along_y[1] - at[1]) / STEP);
        let determinant = a * d - b * c;
        // Where it folds, the image shows nothing that is one point.
        if determinant.is_nan() || determinant <= 0.0 {
            return None;
        }
        point[0] += (d * miss_x - b * miss_y) / determinant;
        point[1] += (a * miss_y - c * miss_x) / determinant;
    }
    None
}

/// The distortion of five parameters that is nearest over an image, by least squares; none where the model has no inverse in
/// it. The five are linear in what they do to a point, so one solution of normal equations is the best.
///
/// `camera` is its focal lengths and its middle: fx, fy, cx, cy.
pub(crate) fn fit(parameters: [f64; 8], camera: [f64; 4], (width, height): (u32, u32)) -> Option<Fit> {
    let [fx_px, fy_px, cx_px, cy_px] = camera;
    let (across, down) = if width >= height { GRID } else { (GRID.1, GRID.0) };
    let at =
        |index: u32, count: u32, length: u32| f64::from(index) / f64::from(count - 1) * f64::from(length);
    let mut points = Vec::new();
    for row in 0..down {
        for column in 0..across {
            let (u, v) = (at(column, across, width), at(row, down, height));
            points.push(undistorted(parameters, [(u - cx_px) / fx_px, (v - cy_px) / fy_px])?);
        }
    }
    let mut normal = [[0.0; 6]; 5];
    for &point in &points {
        let moved = distorted(parameters, point);
        for (axis, focal_px) in [(0, fx_px), (1, fy_px)] {
            let effects = effects(point, axis).map(|effect| effect * focal_px);
            let wanted = (moved[axis] - point[axis]) * focal_px;
            for (row, effect) in normal.iter_mut().zip(effects) {
                for (cell, other) in row.iter_mut().zip(effects.into_iter().chain([wanted])) {
                    *cell += effect * other;
                }
            }
        }
    }
    let distortion = solved(normal)?;
    let error_px = |&point: &[f64; 2]| {
        let moved = distorted(parameters, point);
        let miss = |axis: usize, focal_px: f64| {
            let effect: f64 =
                effects(point, axis).iter().zip(distortion).map(|(effect, value)| effect * value).sum();
            (moved[axis] - point[axis] - effect) * focal_px
        };
        miss(0, fx_px).hypot(miss(1, fy_px))
    };
    let error_px = points.iter().map(error_px).fold(0.0, f64::max);
    error_px.is_finite().then_some(Fit { distortion, error_px })
}

/// What k1, k2, p1, p2 and k3 of 1 add to a coordinate of a point.
fn effects([x, y]: [f64; 2], axis: usize) -> [f64; 5] {
    let r2 = x * x + y * y;
    let own = if axis == 0 { x } else { y };
    let (along, crossed) = (r2 + 2.0 * own * own, 2.0 * x * y);
    let (p1, p2) = if axis == 0 { (crossed, along) } else { (along, crossed) };
    [own * r2, own * r2 * r2, p1, p2, own * r2 * r2 * r2]
}

/// Gauss's elimination with the largest pivot.
fn solved(mut rows: [[f64; 6]; 5]) -> Option<[f64; 5]> {
    for column in 0..5 {
        let pivot = (column..5)
            .max_by(|one, other| rows[*one][column].abs().total_cmp(&rows[*other][column].abs()))?;
        rows.swap(column, pivot);
        if rows[column][column] == 0.0 {
            return None;
        }
        let pivot = rows[column];
        for (_, row) in rows.iter_mut().enumerate().filter(|(row, _)| *row != column) {
            let factor = row[column] / pivot[column];
            row.iter_mut().zip(pivot).for_each(|(cell, of_pivot)| *cell -= factor * of_pivot);
        }
    }
    Some(std::array::from_fn(|row| rows[row][5] / rows[row][row]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(focal_px: f64) -> [f64; 4] {
        [focal_px, focal_px, 322.0, 238.0]
    }

    #[test]
    fn five_parameters_fit_themselves() {
        let five = [0.1, -0.05, 0.001, -0.002, 0.01];
        let [k1, k2, p1, p2, k3] = five;
        let fit = fit([k1, k2, p1, p2, k3, 0.0, 0.0, 0.0], camera(500.0), (640, 480)).unwrap();
        assert!(fit.error_px < 1e-6, "{fit:?}");
        assert!(fit.distortion.iter().zip(five).all(|(one, other)| (one - other).abs() < 1e-6), "{fit:?}");
    }

    #[test]
    fn a_denominator_is_fitted_as_far_as_it_can_be() {
        let parameters = [0.5, -0.2, 0.0005, -0.0003, 0.02, 0.45, -0.1, 0.01];
        let near = fit(parameters, camera(600.0), (640, 480)).unwrap();
        assert!(near.error_px < 0.05, "{near:?}");
        // A view of 130 degrees needs more than five.
        let wide = [8.0, 4.0, 0.0, 0.0, 0.2, 8.5, 7.0, 1.2];
        let far = fit(wide, camera(230.0), (640, 480));
        assert!(far.as_ref().is_none_or(|fit| fit.error_px > MOST_ERROR_PX), "{far:?}");
        // One that folds has no inverse.
        assert_eq!(fit([-3.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0], camera(300.0), (640, 480)), None);
    }
}
