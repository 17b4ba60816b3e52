//! Images and poses that come beside each other, joined by time.

use std::collections::VecDeque;

use crate::messages::Pose;
use crate::poses::Poses;

/// An image that waited for poses as long as this, by the times of recording, has none.
const LONGEST_WAIT_NS: i64 = 5_000_000_000;
/// Poses are kept as long as this, by their stamps, for images that come late.
const KEPT_NS: i64 = 30_000_000_000;
/// Bounds of what waits.
const MOST_POSES: usize = 100_000;
const MOST_WAITING: usize = 64;
const MOST_WAITING_BYTES: usize = 64 << 20;

/// An image with the pose of the robot that took it.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Of the image in its topic, from 1.
    pub number: u64,
    /// When it was taken.
    pub stamp_ns: i64,
    /// A JPEG or PNG.
    pub image: Vec<u8>,
    /// The robot's base by odometry; none where no poses are around the stamp.
    pub pose: Option<Pose>,
}

/// Images that wait for the poses around them, in bounded memory.
#[derive(Default)]
pub struct Joining {
    poses: Poses,
    /// In their order, each with the time of its recording.
    waiting: VecDeque<(i64, Frame)>,
    waiting_bytes: usize,
    log_ns: i64,
    is_over: bool,
}

impl Joining {
    /// Takes an image, with the time at which it was recorded or came.
    pub fn add_image(&mut self, log_ns: i64, frame: Frame) {
        self.log_ns = self.log_ns.max(log_ns);
        self.waiting_bytes += frame.image.len();
        self.waiting.push_back((log_ns, frame));
    }

    /// Takes a pose, with the time at which it was recorded or came. One whose stamp is not above the last is not taken.
    pub fn add_pose(&mut self, log_ns: i64, stamp_ns: i64, pose: Pose) {
        self.log_ns = self.log_ns.max(log_ns);
        if !self.poses.push(stamp_ns, pose) {
            return;
        }
        let needed_ns = self.waiting.front().map_or(i64::MAX, |(_, frame)| frame.stamp_ns);
        self.poses.forget_before(needed_ns.min(stamp_ns.saturating_sub(KEPT_NS)), MOST_POSES);
    }

    /// No more poses come.
    pub fn end(&mut self) {
        self.is_over = true;
    }

    /// The next image that need not wait any longer.
    #[expect(clippy::should_implement_trait, reason = "none now does not mean none later")]
    pub fn next(&mut self) -> Option<Frame> {
        let (log_ns, frame) = self.waiting.front()?;
        let is_passed = self.poses.last_ns().is_some_and(|last_ns| last_ns >= frame.stamp_ns);
        let is_late = self.log_ns.saturating_sub(*log_ns) > LONGEST_WAIT_NS;
        let is_much = self.waiting.len() > MOST_WAITING || self.waiting_bytes > MOST_WAITING_BYTES;
        if !(is_passed || is_late || is_much || self.is_over) {
            return None;
        }
        let (_, mut frame) = self.waiting.pop_front()?;
        self.waiting_bytes -= frame.image.len();
        frame.pose = self.poses.at(frame.stamp_ns);
        Some(frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::poses::MOST_GAP_NS;

    fn heading(x_m: f64, yaw_rad: f64) -> Pose {
        let (z, w) = (yaw_rad / 2.0).sin_cos();
        Pose { position_m: [x_m, 0.0, 0.0], orientation: [0.0, 0.0, z, w] }
    }

    fn image(number: u64, stamp_ns: i64) -> Frame {
        Frame { number, stamp_ns, image: vec![0; 10], pose: None }
    }

    #[test]
    fn a_pose_lies_between_its_neighbours() {
        let mut joining = Joining::default();
        joining.add_pose(0, 100, heading(1.0, 0.2));
        joining.add_image(0, image(1, 175));
        assert_eq!(joining.next(), None);
        joining.add_pose(0, 200, heading(2.0, 0.6));
        let pose = joining.next().unwrap().pose.unwrap();
        let yaw_rad = 2.0 * pose.orientation[2].atan2(pose.orientation[3]);
        assert!((pose.position_m[0] - 1.75).abs() < 1e-12 && (yaw_rad - 0.5).abs() < 1e-12, "{pose:?}");
        // One that is there is taken as it is.
        joining.add_image(0, image(2, 200));
        assert_eq!(joining.next().unwrap().pose, Some(heading(2.0, 0.6)));
    }

    #[test]
    fn no_pose_is_made_up_over_a_gap_or_before_the_first() {
        let mut joining = Joining::default();
        joining.add_pose(0, 100, heading(1.0, 0.0));
        joining.add_image(0, image(1, 50));
        joining.add_image(0, image(2, 150));
        joining.add_pose(0, 100 + MOST_GAP_NS + 1, heading(2.0, 0.0));
        assert_eq!([joining.next().unwrap().pose, joining.next().unwrap().pose], [None, None]);
    }

    #[test]
    fn what_waits_is_bounded() {
        let mut joining = Joining::default();
        for number in 1..=200 {
            joining.add_image(0, image(number, number as i64));
            while joining.next().is_some() {}
        }
        assert_eq!(joining.waiting.len(), MOST_WAITING);
        joining.add_image(LONGEST_WAIT_NS + 1, image(201, 201));
        let released = std::iter::from_fn(|| joining.next()).count();
        assert_eq!((released, joining.waiting.len()), (MOST_WAITING, 1));
        joining.end();
        assert_eq!(joining.next().unwrap().number, 201);
        for stamp_ns in 0..300_000 {
            joining.add_pose(0, stamp_ns, heading(0.0, 0.0));
        }
        assert!(joining.poses.len() <= MOST_POSES, "{}", joining.poses.len());
    }
}
