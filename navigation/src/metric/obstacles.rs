//! What a robot does that something holds, and what counts as seeing nothing known.

use posegraph::PlanarPose;

use super::Navigator;
use super::following::{Motion, is_motion};
use super::guidance::{Driver, Obstacle, Reason};
use super::localization::{Closure, Sight};
use super::settings::NavigationSettings;
use super::supervision::Shown;
use super::tasks::Task;

impl Navigator {
    /// What it does in place of what it should, and why, if something holds it.
    pub(super) fn held(
        &mut self,
        motions: ([f64; 2], [f64; 2]),
        now: (i64, &PlanarPose),
        elapsed_s: f64,
    ) -> Option<([f64; 2], Reason)> {
        let NavigationSettings { supervision, steering, .. } = self.settings;
        let (obeyed, wanted) = motions;
        let blind = self.blind_for_ns(now.0).filter(|_| is_motion(wanted));
        let wanted = if blind.is_some() { [0.0; 2] } else { wanted };
        match self.watch.judge((obeyed, wanted), now, &supervision, steering.valid_ns) {
            Motion::Free => blind.map(|for_ns| {
                self.slip.forget();
                self.steering.reset();
                ([0.0; 2], Reason::NoFrames { for_ns })
            }),
            Motion::Waiting(obstacle) => {
                self.slip.forget();
                self.steering.reset();
                Some(([0.0; 2], Reason::Held(obstacle)))
            }
            Motion::BackingOff(obstacle, back_to) => {
                self.slip.forget();
                let backwards = self.backwards(&back_to, elapsed_s);
                if backwards.is_none() {
                    self.watch.is_back();
                    self.steering.reset();
                }
                backwards.map(|motion| (motion, Reason::BackingOff(obstacle)))
            }
        }
    }

    /// How long no frame came, if that is too long to drive on by wheels alone.
    fn blind_for_ns(&mut self, stamp_ns: i64) -> Option<i64> {
        let for_ns = stamp_ns.saturating_sub(*self.seen_ns.get_or_insert(stamp_ns));
        (for_ns >= self.settings.supervision.blind_ns).then_some(for_ns)
    }

    /// What a frame without a closure counts as. One that shows too little counts while the robot is on its way: one that
    /// stands in the dark is still where it was.
    pub(super) fn unrecognised(&self, sight: &Sight) -> Option<Shown> {
        match (sight, &self.task) {
            (Sight::Unknown, _) => Some(Shown::Something),
            (Sight::TooLittle, Task::Follow(_)) => Some(Shown::TooLittle),
            (
                Sight::TooLittle,
                Task::Nothing | Task::LookAround(_) | Task::Plan { .. } | Task::Face { .. } | Task::Arrived,
            )
            | (Sight::Closure(_), _) => None,
        }
    }

    /// What is seen says where the robot was; whether that goes by as the wheels say.
    pub(super) fn watch_slip(&mut self, (stamp_ns, odometry): (i64, &PlanarPose), seen: &Closure) {
        let is_driven = self.driver == Driver::Commands && matches!(self.task, Task::Follow(_));
        if !is_driven || self.watch.is_recovering() {
            self.slip.forget();
        } else if self.slip.slips(odometry, seen) {
            self.slip.forget();
            self.watch.hold(Obstacle::WheelsSlip, (stamp_ns, odometry), &self.settings.supervision);
        }
    }
}
