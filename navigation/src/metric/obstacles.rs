//! What a robot does that something holds, and what counts as seeing nothing known.

use posegraph::PlanarPose;

use super::Navigator;
use super::following::Motion;
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
        match self.watch.judge(motions, now, &supervision, steering.valid_ns) {
            Motion::Free => None,
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
