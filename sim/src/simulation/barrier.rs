//! Something that holds a robot back, and that neither its camera nor its range sensor sees.

use crate::pose::Pose;
use crate::robot::Command;

/// What the wheels of a robot that is held back do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeldWheels {
    /// They stand.
    Stand,
    /// They turn on, and slip.
    Slip,
}

/// Upright, across the way that the robot looked when it came up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Barrier {
    pub(super) at: Pose,
    pub(super) wheels: HeldWheels,
}

/// A robot that is so near to it touches it, in metres.
const TOUCHES_M: f64 = 0.005;

impl Barrier {
    /// How far before it a pose is; below 0 behind it.
    fn ahead_m(&self, pose: &Pose) -> f64 {
        -self.at.relative(pose).x_m
    }

    pub(super) fn touches(&self, pose: &Pose) -> bool {
        self.ahead_m(pose) <= TOUCHES_M
    }

    /// Whether it keeps a robot that is here from there.
    pub(super) fn stops(&self, here: &Pose, next: &Pose) -> bool {
        self.touches(here) && self.ahead_m(next) < self.ahead_m(here)
    }

    /// What is left of a command for wheels that cannot turn forwards; none for those that slip.
    pub(super) fn limited(&self, here: &Pose, command: Option<&Command>) -> Option<[f64; 2]> {
        let command = command.filter(|_| self.wheels == HeldWheels::Stand && self.touches(here))?;
        Some([command.forward_m_s.min(0.0), command.turn_rad_s])
    }
}
