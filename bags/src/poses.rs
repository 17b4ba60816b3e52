//! Where a robot was, by time.

use std::collections::VecDeque;

use crate::messages::Pose;
use crate::succession::{AGREEING, Astray, Step, Succession};

/// The two poses around a time are at most this far apart.
pub const MOST_GAP_NS: i64 = 1_000_000_000;

/// Poses in the order of their stamps. [`Succession`] decides which of them count.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Poses {
    poses: VecDeque<(i64, Pose)>,
    /// Stamp of the first pose that counts, which may be forgotten.
    first_ns: Option<i64>,
    order: Succession<Pose>,
}

/// Why there is no pose at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lack {
    /// The two poses around it are more than [`MOST_GAP_NS`] apart.
    Gap,
    /// It is before the first pose, or after the last.
    Outside,
    /// Poses of that time were there, or were to come, but not together with what needs one.
    Apart,
}

impl Poses {
    /// Adds a pose. One that follows the last is used at once. A single one that does not is left out and counted; where the
    /// clock was set back, all begins anew, and poses from before are gone ([`Succession`] has the rule).
    pub fn push(&mut self, stamp_ns: i64, pose: Pose) {
        self.push_after(0, stamp_ns, pose);
    }

    /// The same of one that came so long after the one before it by another clock.
    pub(crate) fn push_after(&mut self, passed_ns: i64, stamp_ns: i64, pose: Pose) {
        let items = match self.order.push_after(passed_ns, stamp_ns, pose) {
            Step::Follows(pose) => vec![(stamp_ns, pose)],
            Step::Held | Step::Repeats => return,
            Step::GoOn(items) => items,
            Step::InPlaceOfLast(items) => {
                self.poses.pop_back();
                items
            }
            Step::InPlaceOfAll(items) | Step::Anew(items) => {
                self.poses.clear();
                self.first_ns = None;
                items
            }
        };
        self.extend(items);
    }

    /// No more poses come.
    pub fn end(&mut self) {
        let items = self.order.end();
        self.extend(items);
    }

    fn extend(&mut self, items: Vec<(i64, Pose)>) {
        self.first_ns = self.first_ns.or(items.first().map(|(stamp_ns, _)| *stamp_ns));
        self.poses.extend(items);
    }

    /// Stamp of the last pose.
    #[must_use]
    pub fn last_ns(&self) -> Option<i64> {
        self.poses.back().map(|(last_ns, _)| *last_ns)
    }

    /// What was left out so far, and whether the clock was set back.
    #[must_use]
    pub fn astray(&self) -> Astray {
        self.order.astray()
    }

    /// Whether the latest poses lie behind the last that counts, and it is not decided yet whether the clock was set back.
    pub(crate) fn is_behind(&self) -> bool {
        self.order.is_behind()
    }

    /// Whether nothing speaks for the first poses but themselves.
    pub(crate) fn is_brief(&self) -> bool {
        self.order.length() < AGREEING
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
    ///
    /// # Errors
    /// Why there is none.
    pub fn at(&self, stamp_ns: i64) -> Result<Pose, Lack> {
        let after = self.poses.partition_point(|(pose_ns, _)| *pose_ns < stamp_ns);
        let &(after_ns, after_pose) = self.poses.get(after).ok_or(Lack::Outside)?;
        if after_ns == stamp_ns {
            return Ok(after_pose);
        }
        let before = after.checked_sub(1).and_then(|before| self.poses.get(before));
        let is_forgotten = self.first_ns.is_some_and(|first_ns| first_ns <= stamp_ns);
        let &(before_ns, before_pose) =
            before.ok_or(if is_forgotten { Lack::Apart } else { Lack::Outside })?;
        let gap_ns = after_ns.checked_sub(before_ns).filter(|gap_ns| *gap_ns <= MOST_GAP_NS);
        let share = (stamp_ns - before_ns) as f64 / gap_ns.ok_or(Lack::Gap)? as f64;
        Ok(between(before_pose, after_pose, share))
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
    fn a_clock_that_is_set_back_leaves_no_pose_from_before() {
        let mut poses = Poses::default();
        (5..10).for_each(|stamp_ns| poses.push(stamp_ns, heading(1.0, 0.0)));
        poses.push(9, heading(3.0, 0.0));
        assert_eq!((poses.at(9), poses.last_ns()), (Ok(heading(1.0, 0.0)), Some(9)));
        [1, 2].into_iter().for_each(|stamp_ns| poses.push(stamp_ns, heading(2.0, 0.0)));
        assert!(poses.is_behind() && poses.at(6).is_ok() && poses.at(1) == Err(Lack::Outside));
        poses.push(3, heading(2.0, 0.0));
        assert_eq!((poses.at(2), poses.at(6)), (Ok(heading(2.0, 0.0)), Err(Lack::Outside)));
        assert_eq!((poses.astray().left_out, poses.astray().set_back), (1, 1));
    }

    #[test]
    fn the_same_rotation_with_the_other_sign_is_no_turn() {
        let one = heading(0.0, 0.3);
        let other = Pose { orientation: one.orientation.map(|part| -part), ..one };
        let middle = between(one, other, 0.5);
        assert!((middle.orientation[2] - one.orientation[2]).abs() < 1e-12, "{middle:?}");
    }
}
