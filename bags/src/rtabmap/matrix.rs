//! RTAB-Map's transforms: the upper three rows of a matrix, row by row, as 32-bit floats.

use crate::messages::Pose;

/// How many numbers a transform has, and bytes.
pub(super) const NUMBERS: usize = 12;
pub(super) const BYTES: usize = NUMBERS * 4;

/// How far from a rotation the numbers may be, which are rounded to 32 bits.
const TOLERANCE: f64 = 1e-2;

/// A pose of its bytes; none of nothing, of zeros (RTAB-Map's "null": no pose is known) and of what is no rotation.
pub(super) fn pose_of_bytes(bytes: &[u8]) -> Option<Pose> {
    let numbers: Vec<f32> =
        bytes.chunks_exact(4).map(|part| f32::from_le_bytes([part[0], part[1], part[2], part[3]])).collect();
    pose_of(<&[f32; NUMBERS]>::try_from(numbers.as_slice()).ok().filter(|_| bytes.len() == BYTES)?)
}

/// A pose of its numbers; none of zeros and of what is no rotation.
pub(super) fn pose_of(numbers: &[f32; NUMBERS]) -> Option<Pose> {
    let at = |row: usize, column: usize| f64::from(numbers[row * 4 + column]);
    let rows: [[f64; 3]; 3] = std::array::from_fn(|row| std::array::from_fn(|column| at(row, column)));
    let position_m: [f64; 3] = std::array::from_fn(|row| at(row, 3));
    if !is_rotation(&rows) || !position_m.iter().all(|part| part.is_finite()) {
        return None;
    }
    Pose { position_m, orientation: quaternion(&rows) }.checked().ok()
}

/// Rows of length 1, each at a right angle to the others, and no mirror.
fn is_rotation(rows: &[[f64; 3]; 3]) -> bool {
    let dot = |one: [f64; 3], other: [f64; 3]| -> f64 {
        one.iter().zip(other).map(|(one, other)| one * other).sum()
    };
    let [x, y, z] = *rows;
    let across = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
    let close = |value: f64, wanted: f64| (value - wanted).abs() <= TOLERANCE;
    [x, y, z].iter().all(|row| close(dot(*row, *row), 1.0))
        && close(dot(x, y), 0.0)
        && close(dot(across, z), 1.0)
}

/// The unit quaternion of a rotation, as x, y, z, w: by its largest part, which no rounding makes a zero (Shepperd, 1978).
fn quaternion([[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]]: &[[f64; 3]; 3]) -> [f64; 4] {
    let squares = [1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz, 1.0 + xx + yy + zz];
    let largest = (0..4).max_by(|one, other| squares[*one].total_cmp(&squares[*other])).unwrap_or(3);
    let parts = match largest {
        0 => [squares[0], yx + xy, xz + zx, zy - yz],
        1 => [yx + xy, squares[1], zy + yz, xz - zx],
        2 => [xz + zx, zy + yz, squares[2], yx - xy],
        _ => [zy - yz, xz - zx, yx - xy, squares[3]],
    };
    let length = parts.iter().map(|part| part * part).sum::<f64>().sqrt();
    parts.map(|part| part / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(one: [f64; 4], other: [f64; 4]) -> bool {
        let dot: f64 = one.iter().zip(other).map(|(one, other)| one * other).sum();
        (dot.abs() - 1.0).abs() < 1e-9
    }

    #[test]
    fn rotations_about_every_axis_are_quaternions() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let cases: [([f32; 9], [f64; 4]); 7] = [
            ([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]),
            ([0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, half, half]),
            ([1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0], [half, 0.0, 0.0, half]),
            ([0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0], [0.0, half, 0.0, half]),
            ([1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0], [1.0, 0.0, 0.0, 0.0]),
            ([-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], [0.0, 1.0, 0.0, 0.0]),
            // Of an optical frame in its camera's own, as robot descriptions have it.
            ([0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0], [-0.5, 0.5, -0.5, 0.5]),
        ];
        for (rows, expected) in cases {
            let mut numbers = [0.0; NUMBERS];
            for (index, value) in rows.iter().enumerate() {
                numbers[index / 3 * 4 + index % 3] = *value;
            }
            (numbers[3], numbers[7], numbers[11]) = (1.0, -2.0, 0.5);
            let pose = pose_of(&numbers).unwrap();
            assert!(close(pose.orientation, expected), "{rows:?}: {pose:?}");
            assert_eq!(pose.position_m, [1.0, -2.0, 0.5]);
        }
    }

    #[test]
    fn zeros_mirrors_and_other_lengths_are_no_poses() {
        assert_eq!(pose_of(&[0.0; NUMBERS]), None);
        let mirror = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0];
        assert_eq!(pose_of(&mirror), None);
        let mut far = mirror;
        (far[10], far[3]) = (1.0, f32::NAN);
        assert_eq!(pose_of(&far), None);
        far[3] = 1e30;
        assert!(pose_of(&far).is_some());
        assert_eq!(pose_of_bytes(&[0; 40]), None);
        assert_eq!(pose_of_bytes(&[]), None);
    }
}
