//! Commands that a robot may not have obeyed yet.

use std::collections::VecDeque;

use super::steering::VelocityCommand;
use posegraph::{PlanarPose, Pose};

/// Commands as they were given, and those that are on the way to the robot, oldest first.
#[derive(Clone, Debug, Default)]
pub(super) struct CommandsOnTheWay {
    given: u64,
    sent: VecDeque<Sent>,
    /// What the robot was doing by command at its last report, in m/s and rad/s.
    obeyed: [f64; 2],
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sent {
    number: u64,
    /// Of the report that it answers, by the robot's clock.
    stamp_ns: i64,
    forward_m_s: f64,
    turn_rad_s: f64,
}

/// Commands that are kept for a robot that says which one it obeys, at most.
const MOST_ON_THE_WAY: usize = 256;

impl CommandsOnTheWay {
    pub(super) fn give(
        &mut self,
        [forward_m_s, turn_rad_s]: [f64; 2],
        stamp_ns: i64,
        valid_ns: i64,
    ) -> VelocityCommand {
        let number = self.given;
        self.given += 1;
        self.sent.push_back(Sent { number, stamp_ns, forward_m_s, turn_rad_s });
        while self.sent.len() > MOST_ON_THE_WAY {
            self.sent.pop_front();
        }
        VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns }
    }

    /// What the robot was doing by command when it reported, in m/s and rad/s. What it obeyed is forgotten; of a robot that
    /// does not say which command it obeyed, all are.
    pub(super) fn obey(&mut self, obeyed: Option<u64>) -> [f64; 2] {
        let command = match obeyed {
            Some(obeyed) => self.sent.iter().find(|sent| sent.number == obeyed),
            None => self.sent.back(),
        };
        if let Some(Sent { forward_m_s, turn_rad_s, .. }) = command {
            self.obeyed = [*forward_m_s, *turn_rad_s];
        }
        match obeyed {
            Some(obeyed) => self.sent.retain(|sent| sent.number > obeyed),
            None => self.sent.clear(),
        }
        self.obeyed
    }

    /// Where the robot will be when the answer to its report of `now_ns` comes to it: it does first what it was told
    /// before. How long a command is on its way shows in the robot's own stamps: it is as many reports behind.
    pub(super) fn obeyed_from(&self, pose: &PlanarPose, now_ns: i64, valid_ns: i64) -> PlanarPose {
        let mut pose = *pose;
        let ends = self.sent.iter().skip(1).map(|sent| sent.stamp_ns).chain([now_ns]);
        for (sent, end_ns) in self.sent.iter().zip(ends) {
            let seconds = end_ns.saturating_sub(sent.stamp_ns).clamp(0, valid_ns) as f64 * 1e-9;
            pose = pose.compose(&arc(sent.forward_m_s * seconds, sent.turn_rad_s * seconds));
        }
        pose
    }
}

/// Where driving so far while turning so far ends.
fn arc(way_m: f64, turn_rad: f64) -> PlanarPose {
    let half = PlanarPose::new(0.0, 0.0, turn_rad / 2.0);
    let chord = if turn_rad.abs() < 1e-6 { 1.0 } else { (turn_rad / 2.0).sin() / (turn_rad / 2.0) };
    half.compose(&PlanarPose::new(way_m * chord, 0.0, 0.0)).compose(&half)
}
