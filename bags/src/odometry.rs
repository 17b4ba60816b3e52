//! Images and poses that come beside each other, joined by time.

use std::collections::VecDeque;

use crate::messages::Pose;
use crate::poses::{Lack, Poses};
use crate::succession::Astray;

/// How long images wait for the poses around them, and poses for images that come late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patience {
    /// The longest wait of an image, by the times of recording; and how long poses are kept, by their stamps.
    pub most_ns: i64,
    /// The most images that wait.
    pub most_images: usize,
    /// The most bytes of images that wait.
    pub most_bytes: usize,
}

/// Where a robot waits for answers, odometry that comes later is of no use.
pub const LIVE: Patience = Patience { most_ns: 5_000_000_000, most_images: 64, most_bytes: 64 << 20 };
/// Recordings are joined by stamps, however late odometry was recorded, in bounded memory.
pub const RECORDED: Patience = Patience { most_ns: 60_000_000_000, most_images: 4096, most_bytes: 128 << 20 };

/// Poses are kept at least as long as this, by their stamps, for images that come late.
const KEPT_NS: i64 = 30_000_000_000;
/// Bounds the poses.
const MOST_POSES: usize = 100_000;

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
pub struct Joining {
    patience: Patience,
    poses: Poses,
    waiting: VecDeque<Waiting>,
    waiting_bytes: usize,
    /// How many of those that wait came before poses did that lie behind others.
    before_doubt: usize,
    log_ns: i64,
    /// When the last pose was recorded.
    pose_log_ns: Option<i64>,
    is_over: bool,
    lacks: Lacks,
}

/// In their order, each with the time of its recording.
struct Waiting {
    log_ns: i64,
    frame: Frame,
    /// The clock of the poses was set back since: none comes any more.
    is_vain: bool,
}

/// How many images had no pose, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lacks {
    /// See [`Lack::Gap`].
    pub gap: u64,
    /// See [`Lack::Outside`].
    pub outside: u64,
    /// See [`Lack::Apart`].
    pub apart: u64,
}

impl Lacks {
    /// Counts one more.
    pub fn add(&mut self, lack: Lack) {
        *match lack {
            Lack::Gap => &mut self.gap,
            Lack::Outside => &mut self.outside,
            Lack::Apart => &mut self.apart,
        } += 1;
    }

    /// How many there are of all reasons.
    #[must_use]
    pub fn all(&self) -> u64 {
        self.gap + self.outside + self.apart
    }
}

impl Default for Joining {
    /// As a robot does that runs.
    fn default() -> Self {
        Self::new(LIVE)
    }
}

impl Joining {
    /// Nothing waits yet.
    #[must_use]
    pub fn new(patience: Patience) -> Self {
        Self {
            patience,
            poses: Poses::default(),
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            before_doubt: 0,
            log_ns: 0,
            pose_log_ns: None,
            is_over: false,
            lacks: Lacks::default(),
        }
    }

    /// Takes an image, with the time at which it was recorded or came.
    pub fn add_image(&mut self, log_ns: i64, frame: Frame) {
        self.log_ns = self.log_ns.max(log_ns);
        self.waiting_bytes += frame.image.len();
        self.waiting.push_back(Waiting { log_ns, frame, is_vain: false });
    }

    /// Takes a pose, with the time at which it was recorded or came. Of a clock that goes wrong, [`Joining::astray`] tells.
    pub fn add_pose(&mut self, log_ns: i64, stamp_ns: i64, pose: Pose) {
        self.log_ns = self.log_ns.max(log_ns);
        let was_behind = self.poses.is_behind();
        let set_back = self.poses.astray().set_back;
        let passed_ns = self.pose_log_ns.map_or(0, |before_ns| log_ns.saturating_sub(before_ns));
        self.pose_log_ns = Some(log_ns);
        self.poses.push_after(passed_ns, stamp_ns, pose);
        if self.poses.is_behind() && !was_behind {
            self.before_doubt = self.waiting.len();
        }
        if self.poses.astray().set_back > set_back {
            for waiting in self.waiting.iter_mut().take(self.before_doubt) {
                waiting.is_vain |= waiting.frame.stamp_ns > stamp_ns;
            }
        }
        let needed_ns = self.waiting.front().map_or(i64::MAX, |waiting| waiting.frame.stamp_ns);
        let kept_ns = self.patience.most_ns.max(KEPT_NS);
        self.poses.forget_before(needed_ns.min(stamp_ns.saturating_sub(kept_ns)), MOST_POSES);
    }

    /// No more poses come.
    pub fn end(&mut self) {
        self.is_over = true;
        self.poses.end();
    }

    /// Poses that were left out so far, and whether their clock was set back.
    #[must_use]
    pub fn astray(&self) -> Astray {
        self.poses.astray()
    }

    /// Images that were handed out without a pose so far.
    #[must_use]
    pub fn lacks(&self) -> Lacks {
        self.lacks
    }

    /// The next image that need not wait any longer.
    #[expect(clippy::should_implement_trait, reason = "none now does not mean none later")]
    pub fn next(&mut self) -> Option<Frame> {
        let Waiting { log_ns, frame, is_vain } = self.waiting.front()?;
        let found = self.poses.at(frame.stamp_ns);
        let is_passed = self.poses.last_ns().is_some_and(|last_ns| last_ns >= frame.stamp_ns);
        // Of images that come while poses lie behind others, it is not known yet which of both they belong to.
        let is_doubtful = self.poses.is_behind() && self.before_doubt == 0;
        let is_answered = !is_doubtful && is_passed && (found.is_ok() || !self.poses.is_brief());
        let is_late = self.log_ns.saturating_sub(*log_ns) > self.patience.most_ns;
        let is_much =
            self.waiting.len() > self.patience.most_images || self.waiting_bytes > self.patience.most_bytes;
        if !(is_answered || is_late || is_much || *is_vain || self.is_over) {
            return None;
        }
        let is_awaited = !(is_passed || *is_vain || self.is_over);
        let Waiting { mut frame, .. } = self.waiting.pop_front()?;
        self.waiting_bytes -= frame.image.len();
        self.before_doubt = self.before_doubt.saturating_sub(1);
        match found {
            Ok(pose) => frame.pose = Some(pose),
            Err(_) if is_awaited => self.lacks.add(Lack::Apart),
            Err(lack) => self.lacks.add(lack),
        }
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
        assert_eq!(joining.next(), None);
        // A third speaks for the first: it is no single wrong stamp.
        joining.add_pose(0, 100 + MOST_GAP_NS + 2, heading(2.0, 0.0));
        joining.add_pose(0, 100 + MOST_GAP_NS + 3, heading(2.0, 0.0));
        assert_eq!([joining.next().unwrap().pose, joining.next().unwrap().pose], [None, None]);
        assert_eq!(joining.lacks(), Lacks { gap: 1, outside: 1, apart: 0 });
    }

    #[test]
    fn what_waits_is_bounded() {
        let mut joining = Joining::default();
        for number in 1..=200 {
            joining.add_image(0, image(number, number as i64));
            while joining.next().is_some() {}
        }
        assert_eq!(joining.waiting.len(), LIVE.most_images);
        joining.add_image(LIVE.most_ns + 1, image(201, 201));
        let released = std::iter::from_fn(|| joining.next()).count();
        assert_eq!((released, joining.waiting.len()), (LIVE.most_images, 1));
        joining.end();
        assert_eq!(joining.next().unwrap().number, 201);
        for stamp_ns in 0..300_000 {
            joining.add_pose(0, stamp_ns, heading(0.0, 0.0));
        }
        assert!(joining.poses.len() <= MOST_POSES, "{}", joining.poses.len());
    }
}
