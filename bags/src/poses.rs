//! Where a robot was, by time.

use std::collections::VecDeque;

use crate::messages::Pose;

/// The two poses around a time are at most this far apart.
pub const MOST_GAP_NS: i64 = 1_000_000_000;

/// Poses in the order of their stamps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Poses {
    poses: VecDeque<(i64, Pose)>,
}

impl Poses {
    /// Adds a pose. One whose stamp is not above the last is not taken, and false comes back.
    pub fn push(&mut self, stamp_ns: i64, pose: Pose) -> bool {
        let rises = self.last_ns().is_none_or(|last_ns| stamp_ns > last_ns);
        if rises {
            self.poses.push_back((stamp_ns, pose));
        }
        rises
    }

    /// Stamp of the last pose.
    #[must_use]
    pub fn last_ns(&self) -> Option<i64> {
        self.poses.back().map(|(last_ns, _)| *last_ns)
    }

    /// Drops what no time from `needed_ns` on can want, and the oldest beyond `most`.
    pub(crate) fn forget_before(&mut self, needed_ns: i64, most: usize) {
        // The last one before what is needed stays.
        while self.poses.get(1).is_some_and(|(next_ns, _)| *next_ns <= needed_ns) || self.poses.len() > most {
            self.poses.pop_front();
        }
    }

    /// The pose at a time: the one of that stamp, or else between the two around it, if those are at most
    /// [`MOST_GAP_NS`] apart.
    #[must_use]
    pub fn at(&self, stamp_ns: i64) -> Option<Pose> {
        let after = self.poses.partition_point(|(pose_ns, _)| *pose_ns < stamp_ns);
        let &(after_ns, after_pose) = self.poses.get(after)?;
        if after_ns == stamp_ns {
            return Some(after_pose);
        }
        let &(before_ns, before_pose) = self.poses.get(after.checked_sub(1)?)?;
        let gap_ns = after_ns.checked_sub(before_ns).filter(|gap_ns| *gap_ns <= MOST_GAP_NS)?;
        let share = (stamp_ns - before_ns) as f64 / gap_ns as f64;
        Some(between(before_pose, after_pose, share))
    }

    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.poses.len()
    }
}

/// The pose at a share of the way from one to another: straight, and turning evenly (slerp).
fn between(one: Pose, other: Pose, share: f64) -> Pose {
    let mix = |from: f64, to: f64| from + share * (to - from);
    let position_m = std::array::from_fn(|axis| mix(one.position_m[axis], other.position_m[axis]));
    let dot: f64 = one.orientation.iter().zip(other.orientation).map(|(one, other)| one * other).sum();
    // A quaternion and its negative are the same rotation.
    let angle = dot.abs().min(1.0).acos();
    let (from, to) = if angle < 1e-6 {
        (1.0 - share, share)
    } else {
        (((1.0 - share) * angle).sin() / angle.sin(), (share * angle).sin() / angle.sin())
    };
    let to = to.copysign(dot);
    let orientation: [f64; 4] =
        std::array::from_fn(|part| from * one.orientation[part] + to * other.orientation[part]);
    let length = orientation.iter().map(|part| part * part).sum::<f64>().sqrt();
    Pose { position_m, orientation: orientation.map(|part| part / length) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heading(x_m: f64, yaw_rad: f64) -> Pose {
        let (z, w) = (yaw_rad / 2.0).sin_cos();
        Pose { position_m: [x_m, 0.0, 0.0], orientation: [0.0, 0.0, z, w] }
    }

    #[test]
    fn stamps_rise() {
        let mut poses = Poses::default();
        assert!(poses.push(5, heading(0.0, 0.0)));
        assert!(!poses.push(5, heading(1.0, 0.0)) && !poses.push(4, heading(1.0, 0.0)));
        assert_eq!((poses.at(5), poses.at(4), poses.last_ns()), (Some(heading(0.0, 0.0)), None, Some(5)));
    }

    #[test]
    fn the_same_rotation_with_the_other_sign_is_no_turn() {
        let one = heading(0.0, 0.3);
        let other = Pose { orientation: one.orientation.map(|part| -part), ..one };
        let middle = between(one, other, 0.5);
        assert!((middle.orientation[2] - one.orientation[2]).abs() < 1e-12, "{middle:?}");
    }
}
