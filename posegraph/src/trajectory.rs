//! Trajectories as text, for tools that judge them: TUM and KITTI.

use std::fmt::Write;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

/// A pose, and when it was so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Nanoseconds since the epoch of the recording.
    pub stamp_ns: i64,
    /// The pose in the trajectory's frame, in metres.
    pub pose: Isometry3<f64>,
}

/// Why a text is no trajectory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TumError {
    /// A line is not UTF-8.
    #[error("line {line} is not text; give a trajectory in TUM's format")]
    NotText {
        /// Its number, from 1.
        line: usize,
    },
    /// A line has too few or too many columns.
    #[error("line {line} has {found} columns; write timestamp tx ty tz qx qy qz qw, separated by blanks")]
    Columns {
        /// Its number, from 1.
        line: usize,
        /// Columns that it has.
        found: usize,
    },
    /// A column is no finite number.
    #[error("line {line}: {text} is not a finite number; write numbers like -1.25e-3, with a point")]
    NotANumber {
        /// Its number, from 1.
        line: usize,
        /// The column.
        text: String,
    },
    /// A stamp cannot be counted in nanoseconds.
    #[error(
        "line {line}: {text} is no time in seconds; write seconds with at most 9 decimals, like 1317384506.400000000"
    )]
    NotAStamp {
        /// Its number, from 1.
        line: usize,
        /// The column.
        text: String,
    },
    /// A quaternion has no direction.
    #[error("line {line}: the quaternion is zero; write 0 0 0 1 for no rotation")]
    NoRotation {
        /// Its number, from 1.
        line: usize,
    },
}

/// TUM's format: a line `timestamp tx ty tz qx qy qz qw` for each pose. Stamps are seconds with
/// nine decimals, exact; other numbers read back bit for bit.
#[must_use]
pub fn to_tum(poses: &[StampedPose]) -> Vec<u8> {
    let mut text = String::new();
    for StampedPose { stamp_ns, pose } in poses {
        let sign = if *stamp_ns < 0 { "-" } else { "" };
        let seconds = stamp_ns.unsigned_abs() / BILLION;
        let nanoseconds = stamp_ns.unsigned_abs() % BILLION;
        // Writing to a string cannot fail.
        let _ = write!(text, "{sign}{seconds}.{nanoseconds:09}");
        append(&mut text, pose.translation.vector.iter().chain(pose.rotation.coords.iter()));
    }
    text.into_bytes()
}

/// KITTI's format: a line of twelve numbers for each pose, the upper three rows of its matrix, row
/// by row. It has no stamps.
#[must_use]
pub fn to_kitti(poses: &[StampedPose]) -> Vec<u8> {
    let mut text = String::new();
    for StampedPose { pose, .. } in poses {
        // Where something is 0 it has no sign.
        let matrix = pose.to_homogeneous().map(|value| value + 0.0);
        let rows = matrix.fixed_rows::<3>(0).transpose();
        let mut numbers = rows.iter();
        if let Some(first) = numbers.next() {
            let _ = write!(text, "{first:?}");
        }
        append(&mut text, numbers);
    }
    text.into_bytes()
}

/// Reads what [`to_tum`] writes, and what others write like it: blank lines and whatever follows a
/// `#` do not count.
///
/// # Errors
/// [`TumError`], which names the line.
pub fn from_tum(text: &[u8]) -> Result<Vec<StampedPose>, TumError> {
    let mut poses = Vec::new();
    for (index, bytes) in text.split(|&byte| byte == b'\n').enumerate() {
        let line = index + 1;
        let content = std::str::from_utf8(bytes).map_err(|_| TumError::NotText { line })?;
        let columns: Vec<&str> = content.split('#').next().unwrap_or_default().split_whitespace().collect();
        let [stamp, numbers @ ..] = columns.as_slice() else { continue };
        if numbers.len() != 7 {
            return Err(TumError::Columns { line, found: columns.len() });
        }
        let stamp_ns =
            nanoseconds(stamp).ok_or_else(|| TumError::NotAStamp { line, text: (*stamp).to_owned() })?;
        let mut values = [0.0; 7];
        for (value, text) in values.iter_mut().zip(numbers) {
            *value = text
                .parse()
                .ok()
                .filter(|value: &f64| value.is_finite())
                .ok_or_else(|| TumError::NotANumber { line, text: (*text).to_owned() })?;
        }
        let [x, y, z, i, j, k, w] = values;
        let rotation = unit(Quaternion::new(w, i, j, k)).ok_or(TumError::NoRotation { line })?;
        poses.push(StampedPose {
            stamp_ns,
            pose: Isometry3::from_parts(Translation3::new(x, y, z), rotation),
        });
    }
    Ok(poses)
}

const BILLION: u64 = 1_000_000_000;

fn append<'a>(text: &mut String, numbers: impl Iterator<Item = &'a f64>) {
    for number in numbers {
        let _ = write!(text, " {number:?}");
    }
    text.push('\n');
}

/// Seconds in decimal, as nanoseconds, exactly: as a float, today's stamps would lose the last two
/// digits.
fn nanoseconds(text: &str) -> Option<i64> {
    let (sign, digits) = text.strip_prefix('-').map_or((1, text), |digits| (-1, digits));
    let (seconds, decimals) = digits.split_once('.').unwrap_or((digits, ""));
    let all_digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let significant = decimals.trim_end_matches('0');
    if seconds.is_empty() || !all_digits(seconds) || !all_digits(decimals) || significant.len() > 9 {
        return None;
    }
    let nanoseconds: i64 = format!("{significant:0<9}").parse().ok()?;
    let seconds: i64 = seconds.parse().ok()?;
    seconds.checked_mul(BILLION as i64)?.checked_add(nanoseconds)?.checked_mul(sign)
}

/// The rotation along a quaternion of any length but zero; one of unit length keeps its bits.
pub(crate) fn unit(quaternion: Quaternion<f64>) -> Option<UnitQuaternion<f64>> {
    if (quaternion.norm_squared() - 1.0).abs() <= 16.0 * f64::EPSILON {
        return Some(UnitQuaternion::new_unchecked(quaternion));
    }
    // Scaled first: the square of a tiny number is zero, that of a huge one infinite.
    let largest = quaternion.coords.amax();
    (largest > 0.0).then(|| UnitQuaternion::new_normalize(quaternion / largest))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn lines_by_hand() {
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(0.0, 0.0, 0.0, 1.0));
        let pose = Isometry3::from_parts(Translation3::new(1.0, -2.5, 0.0), rotation);
        let poses = [
            StampedPose { stamp_ns: 1_317_384_506_400_000_001, pose },
            StampedPose { stamp_ns: -5, pose: Isometry3::identity() },
        ];
        let tum =
            "1317384506.400000001 1.0 -2.5 0.0 0.0 0.0 1.0 0.0\n-0.000000005 0.0 0.0 0.0 0.0 0.0 0.0 1.0\n";
        assert_eq!(String::from_utf8(to_tum(&poses)).unwrap(), tum);
        let kitti = "-1.0 0.0 0.0 1.0 0.0 -1.0 0.0 -2.5 0.0 0.0 1.0 0.0\n1.0 0.0 0.0 0.0 0.0 1.0 0.0 0.0 0.0 0.0 1.0 0.0\n";
        assert_eq!(String::from_utf8(to_kitti(&poses)).unwrap(), kitti);
    }

    #[test]
    fn what_others_write_is_read() {
        let text = b"# timestamp tx ty tz qx qy qz qw\r\n\r\n1.5 1 2 3 0 0 0 2\n";
        let pose = Isometry3::translation(1.0, 2.0, 3.0);
        assert_eq!(from_tum(text), Ok(vec![StampedPose { stamp_ns: 1_500_000_000, pose }]));
    }

    #[test]
    fn errors_name_the_line() {
        let error = |text: &str| from_tum(text.as_bytes()).unwrap_err();
        assert_eq!(error("\n1 2 3"), TumError::Columns { line: 2, found: 3 });
        let stamp = |text: &str| TumError::NotAStamp { line: 1, text: text.to_owned() };
        for text in ["1e9", "1.0000000001", "9300000000", ".5", "now"] {
            assert_eq!(error(&format!("{text} 0 0 0 0 0 0 1")), stamp(text));
        }
        assert_eq!(error("1 0 inf 0 0 0 0 1"), TumError::NotANumber { line: 1, text: "inf".to_owned() });
        assert_eq!(error("1 0 0 0 0 0 0 0"), TumError::NoRotation { line: 1 });
        assert_eq!(from_tum(b"\xff"), Err(TumError::NotText { line: 1 }));
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back_to_the_bit(
            stamps in prop::collection::vec(i64::MIN + 1..i64::MAX, 0..5),
            position in prop::array::uniform3(-1e6..1e6f64),
            axis in prop::array::uniform3(-2.0..2.0f64),
        ) {
            let pose = Isometry3::new(Vector3::from(position), Vector3::from(axis));
            let poses: Vec<_> = stamps.into_iter().map(|stamp_ns| StampedPose { stamp_ns, pose }).collect();
            prop_assert_eq!(from_tum(&to_tum(&poses)), Ok(poses));
        }
    }
}
