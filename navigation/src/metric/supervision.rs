//! What tells that a robot is not where it is believed to be, or does not move.

use super::guidance::Driver;
use super::settings::{NavigationSettings, SupervisionSettings};
use posegraph::{PlanarPose, Pose};

/// Frames since the last closure in which something known should have been seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct UnknownLooks {
    driving: u32,
    standing: u32,
    /// Driven from the closure to the last of those while driving, in metres.
    at_m: f64,
}

impl UnknownLooks {
    pub(super) fn add(&mut self, driver: Driver, since_closure_m: f64) {
        let moved = since_closure_m - self.at_m > MOVED_M;
        self.at_m = since_closure_m;
        match driver {
            Driver::Commands if moved => self.driving += 1,
            Driver::Commands | Driver::Reflex => self.standing += 1,
        }
    }

    pub(super) fn are_too_many(&self, settings: &SupervisionSettings) -> bool {
        self.driving >= settings.unknown_looks || self.standing >= settings.unknown_looks_standing
    }
}

/// Whether the robot moves when it is told to all along.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct MotionWatch {
    /// Where it was when it last moved, or was told to stand.
    still: Option<(i64, PlanarPose)>,
    /// When it was last judged: after a pause in which commands lapsed it starts again.
    judged_ns: Option<i64>,
    waits_until_ns: Option<i64>,
}

/// What a robot may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Motion {
    /// What it was to do.
    Free,
    /// Nothing for a while: it did not move although it was told to.
    Waiting,
}

/// What counts as having moved.
const MOVED_M: f64 = 0.02;
const MOVED_RAD: f64 = 0.03;

impl MotionWatch {
    pub(super) fn judge(
        &mut self,
        [forward_m_s, turn_rad_s]: [f64; 2],
        odometry: &PlanarPose,
        now_ns: i64,
        settings: &NavigationSettings,
    ) -> Motion {
        let is_told_to_move = forward_m_s.abs() > 1e-3 || turn_rad_s.abs() > 1e-2;
        let paused = |judged_ns: i64| now_ns.saturating_sub(judged_ns) > settings.steering.valid_ns;
        if !is_told_to_move || self.judged_ns.is_some_and(paused) {
            *self = Self::default();
        }
        self.judged_ns = Some(now_ns);
        if let Some(until_ns) = self.waits_until_ns {
            if now_ns < until_ns {
                return Motion::Waiting;
            }
            (self.still, self.waits_until_ns) = (None, None);
        }
        let (since_ns, from) = *self.still.get_or_insert((now_ns, *odometry));
        let moved = from.inverse().compose(odometry);
        let has_moved = moved.x_m().hypot(moved.y_m()) > MOVED_M || moved.heading_rad().abs() > MOVED_RAD;
        if has_moved {
            self.still = Some((now_ns, *odometry));
            return Motion::Free;
        }
        if now_ns.saturating_sub(since_ns) < settings.supervision.blocked_ns {
            return Motion::Free;
        }
        self.waits_until_ns = Some(now_ns.saturating_add(settings.supervision.blocked_wait_ns));
        Motion::Waiting
    }
}
