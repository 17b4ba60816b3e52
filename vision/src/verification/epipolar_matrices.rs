//! Matrices that relate two views of one scene, from matches, and motions from matrices.
//! Numbers of equations and sections are those of Hartley & Zisserman, Multiple View Geometry.

use nalgebra::{Complex, Matrix3, SMatrix, SVD, SVector, U3, UnitQuaternion, UnitVector3, Vector3};

use super::correspondence::Correspondence;

/// Matches that fix a fundamental matrix up to three solutions.
pub(super) const SAMPLE: usize = 7;

/// First-order distance of a match, with a sign, from the pairs that obey x'ᵀ F x = 0. Eq. (11.9).
pub(super) fn sampson(matrix: &Matrix3<f64>, pair: &Correspondence) -> f64 {
    let (x, y) = (homogeneous(pair.earlier), homogeneous(pair.current));
    let (line, back) = (matrix * x, matrix.tr_mul(&y));
    y.dot(&line) / (line.xy().norm_squared() + back.xy().norm_squared()).max(f64::MIN_POSITIVE).sqrt()
}

fn homogeneous(point: Complex<f64>) -> Vector3<f64> {
    Vector3::new(point.re, point.im, 1.0)
}

/// x'ᵀ F x as a product with the entries of F, row by row. Eq. (11.2).
fn coefficients(pair: &Correspondence) -> SVector<f64, 9> {
    let (x, y) = (homogeneous(pair.earlier), homogeneous(pair.current));
    SVector::from_fn(|entry, _| y[entry / 3] * x[entry % 3])
}

/// The one to three matrices of rank 2 that seven matches obey. Section 11.1.2.
pub(super) fn seven_point(pairs: [&Correspondence; SAMPLE]) -> Vec<Matrix3<f64>> {
    let equations = SMatrix::<f64, SAMPLE, 9>::from_fn(|row, entry| coefficients(pairs[row])[entry]);
    let Some([a, b]) = null_space(equations) else { return Vec::new() };
    // det(a + z b) is a cubic in z: its ends are known, the middle follows from z = 1 and -1.
    let at = |z: f64| (a + b * z).determinant();
    let constant = a.determinant();
    let cubic = b.determinant();
    let square = (at(1.0) + at(-1.0)) / 2.0 - constant;
    let linear = (at(1.0) - at(-1.0)) / 2.0 - cubic;
    roots([constant, linear, square, cubic]).into_iter().map(|z| a + b * z).collect()
}

/// Two matrices that span what seven equations leave open, by elimination with full pivoting.
fn null_space(mut rows: SMatrix<f64, SAMPLE, 9>) -> Option<[Matrix3<f64>; 2]> {
    let mut entries: [usize; 9] = std::array::from_fn(|entry| entry);
    for step in 0..SAMPLE {
        let rest = rows.view_range(step.., step..);
        let (row, column) = rest.icamax_full();
        if rest[(row, column)].abs() < 1e-10 {
            return None;
        }
        rows.swap_rows(step, step + row);
        rows.swap_columns(step, step + column);
        entries.swap(step, step + column);
        for below in step + 1..SAMPLE {
            let factor = rows[(below, step)] / rows[(step, step)];
            for column in step..9 {
                rows[(below, column)] -= factor * rows[(step, column)];
            }
        }
    }
    let spanned_by = |free: usize| {
        let mut solution = [0.0; 9];
        solution[free] = 1.0;
        for step in (0..SAMPLE).rev() {
            let known: f64 = (step + 1..9).map(|column| rows[(step, column)] * solution[column]).sum();
            solution[step] = -known / rows[(step, step)];
        }
        let mut matrix = Matrix3::zeros();
        for (&entry, value) in entries.iter().zip(solution) {
            matrix[(entry / 3, entry % 3)] = value;
        }
        matrix.normalize()
    };
    Some([spanned_by(SAMPLE), spanned_by(SAMPLE + 1)])
}

/// Real roots of c₀ + c₁ z + c₂ z² + c₃ z³; none if it is no cubic.
fn roots([c0, c1, c2, c3]: [f64; 4]) -> Vec<f64> {
    if c3.abs() <= 1e-12 * (c0.abs() + c1.abs() + c2.abs()) {
        return Vec::new();
    }
    // Depressed by z = u - a/3: u³ - 3 q u + 2 r = 0, Viète's and Cardano's solutions.
    let (a, b, c) = (c2 / c3, c1 / c3, c0 / c3);
    let q = (a * a - 3.0 * b) / 9.0;
    let r = (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0;
    let below = r * r - q * q * q;
    if below < 0.0 {
        let angle = (r / q.powf(1.5)).clamp(-1.0, 1.0).acos();
        let third =
            |turn: f64| -2.0 * q.sqrt() * ((angle + turn * std::f64::consts::TAU) / 3.0).cos() - a / 3.0;
        vec![third(0.0), third(1.0), third(2.0)]
    } else {
        let u = -r.signum() * (r.abs() + below.sqrt()).cbrt();
        vec![u + if u == 0.0 { 0.0 } else { q / u } - a / 3.0]
    }
}

/// The matrix with the least sum of squares over eight or more matches, on coordinates of mean 0
/// and mean square distance 2. Section 11.2.
pub(super) fn eight_point(pairs: &[Correspondence]) -> Option<Matrix3<f64>> {
    if pairs.len() < 8 {
        return None;
    }
    let (earlier_mean, earlier_factor) = normaliser(pairs.iter().map(|pair| pair.earlier));
    let (current_mean, current_factor) = normaliser(pairs.iter().map(|pair| pair.current));
    let mut moments = SMatrix::<f64, 9, 9>::zeros();
    for pair in pairs {
        let row = coefficients(&Correspondence {
            earlier: (pair.earlier - earlier_mean) * earlier_factor,
            current: (pair.current - current_mean) * current_factor,
            ..*pair
        });
        moments += row * row.transpose();
    }
    let eigen = moments.symmetric_eigen();
    let least = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let matrix = of_rank_two(Matrix3::from_row_slice(least.as_slice()))?;
    let normalising = |mean: Complex<f64>, factor: f64| {
        Matrix3::new(factor, 0.0, -factor * mean.re, 0.0, factor, -factor * mean.im, 0.0, 0.0, 1.0)
    };
    let from = normalising(earlier_mean, earlier_factor);
    let to = normalising(current_mean, current_factor);
    Some(to.transpose() * matrix * from)
}

fn normaliser(points: impl Iterator<Item = Complex<f64>> + Clone) -> (Complex<f64>, f64) {
    let count = points.clone().count() as f64;
    let mean = points.clone().sum::<Complex<f64>>() / count;
    let mean_square = points.map(|point| (point - mean).norm_sqr()).sum::<f64>() / count;
    (mean, (2.0 / mean_square.max(f64::MIN_POSITIVE)).sqrt())
}

/// The nearest matrix of rank 2.
pub(super) fn of_rank_two(matrix: Matrix3<f64>) -> Option<Matrix3<f64>> {
    with_singular_values(matrix, |[first, second, _]| [first, second, 0.0])
}

/// The nearest essential matrix of norm √2: two equal singular values and a 0.
pub(super) fn essential_part(matrix: Matrix3<f64>) -> Option<Matrix3<f64>> {
    with_singular_values(matrix, |_| [1.0, 1.0, 0.0])
}

fn with_singular_values(matrix: Matrix3<f64>, values: fn([f64; 3]) -> [f64; 3]) -> Option<Matrix3<f64>> {
    let mut svd = decomposed(matrix)?;
    let [first, second, third] = values(svd.singular_values.into());
    svd.singular_values = Vector3::new(first, second, third);
    svd.recompose().ok()
}

/// With the singular values in descending order; `None` if they are no numbers, as of features that a
/// robot puts beyond all images.
fn decomposed(matrix: Matrix3<f64>) -> Option<SVD<f64, U3, U3>> {
    let mut svd = matrix.try_svd(true, true, f64::EPSILON, 100)?;
    if svd.singular_values.iter().any(|value| !value.is_finite()) {
        return None;
    }
    svd.sort_by_singular_values();
    Some(svd)
}

/// Of the four motions that an essential matrix leaves open, the one that puts most points before
/// both cameras. Section 9.6.
pub(super) fn decompose(
    matrix: &Matrix3<f64>,
    inliers: &[Correspondence],
) -> Option<(UnitQuaternion<f64>, UnitVector3<f64>)> {
    let svd = decomposed(*matrix)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let quarter = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let translation = u.column(2).into_owned();
    let mut best: Option<(usize, Matrix3<f64>, Vector3<f64>)> = None;
    for turn in [quarter, quarter.transpose()] {
        let rotation = u * turn * v_t;
        let rotation = rotation * rotation.determinant().signum();
        for direction in [translation, -translation] {
            let before = inliers.iter().filter(|pair| is_before_both(&rotation, &direction, pair)).count();
            // Where no point says anything, because none has moved: the least turn, which has the
            // greatest trace.
            let is_better = |&(most, other, _): &(usize, Matrix3<f64>, Vector3<f64>)| {
                before > most || (before == most && rotation.trace() > other.trace())
            };
            if best.as_ref().is_none_or(is_better) {
                best = Some((before, rotation, direction));
            }
        }
    }
    let (_, rotation, direction) = best?;
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(rotation);
    Some((UnitQuaternion::from_rotation_matrix(&rotation), UnitVector3::new_normalize(direction)))
}

/// Depths d, d' of a point with d' x' = d R x + t, in the least-squares sense, are both positive.
fn is_before_both(rotation: &Matrix3<f64>, direction: &Vector3<f64>, pair: &Correspondence) -> bool {
    let (from, to) = (rotation * homogeneous(pair.earlier), homogeneous(pair.current));
    // Crossing with either ray removes one of the depths.
    let depth = -to.cross(direction).dot(&to.cross(&from));
    let other_depth = from.cross(direction).dot(&from.cross(&to));
    depth > 0.0 && other_depth > 0.0
}
