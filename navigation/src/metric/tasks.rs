//! What a robot is at, and how it is to move for that.

use std::sync::Arc;

use nalgebra::Vector2;

use super::Navigator;
use super::guidance::{LostBecause, Reason, Status};
use super::path::{GlobalPath, LocalPath};
use super::planning::Goal;
use posegraph::{PlanarPose, Pose};

/// What the robot is at.
#[derive(Clone, Debug)]
pub(super) enum Task {
    Nothing,
    /// It is not known where the robot is.
    LookAround(LookAround),
    /// It is known, and a way is wanted.
    Plan {
        goal: Goal,
    },
    Follow(Box<Journey>),
    /// It is there, and turns to where it is to look.
    Face {
        goal: Goal,
        heading_rad: f64,
    },
    Arrived,
}

/// It looks, goes back to where it knew, and turns.
#[derive(Clone, Copy, Debug)]
pub(super) struct LookAround {
    pub(super) goal: Goal,
    pub(super) because: LostBecause,
    pub(super) since_ns: Option<i64>,
    /// Where it last recognised something, by its wheels, until it is there.
    pub(super) back_to: Option<PlanarPose>,
    pub(super) turned_rad: f64,
}

/// A way, and how far the robot has come.
#[derive(Clone, Debug)]
pub(super) struct Journey {
    pub(super) goal: Goal,
    pub(super) path: Arc<GlobalPath>,
    pub(super) local: LocalPath,
    /// The point of the path that the robot is nearest to.
    pub(super) progress: usize,
    /// Whether it has been so near to the path that it should recognise what it sees.
    pub(super) joined: bool,
}

/// A robot that is so near to where it went back to is there.
const BACK_M: f64 = 0.1;

/// A robot looks to where it should within this.
const FACED_RAD: f64 = 0.03;

/// Less than this is no turn.
const TURNED_RAD: f64 = 0.2;

impl Navigator {
    /// Speed ahead and turn to the left, and why.
    pub(super) fn wanted_motion(
        &mut self,
        elapsed_s: f64,
        [_, turned_rad]: [f64; 2],
        stamp_ns: i64,
    ) -> ([f64; 2], Status, Option<f64>) {
        match &self.task {
            Task::Nothing => ([0.0; 2], Status::Idle, None),
            Task::Arrived => ([0.0; 2], Status::Arrived, None),
            Task::Plan { .. } => ([0.0; 2], self.following(), None),
            Task::LookAround(looks) => {
                let mut looks = *looks;
                let motion = self.look_around(&mut looks, elapsed_s, turned_rad, stamp_ns);
                self.task = Task::LookAround(looks);
                (motion, Status::Lost, None)
            }
            Task::Follow(_) => self.steer(elapsed_s),
            Task::Face { heading_rad, .. } => self.face(*heading_rad, elapsed_s),
        }
    }

    /// Stands, goes back to where it knew, and turns: slowly where something speaks for a place.
    fn look_around(
        &mut self,
        looks: &mut LookAround,
        elapsed_s: f64,
        turned_rad: f64,
        stamp_ns: i64,
    ) -> [f64; 2] {
        let supervision = &self.settings.supervision;
        let looked_ns = stamp_ns.saturating_sub(*looks.since_ns.get_or_insert(stamp_ns));
        looks.turned_rad += turned_rad;
        let promising = self.evidence >= supervision.promising_evidence || self.filter.is_confirming();
        if looked_ns < supervision.look_first_ns {
            return [0.0; 2];
        }
        if let (Some(back_to), false) = (looks.back_to, promising)
            && let Some(backwards) = self.backwards(&back_to, elapsed_s)
        {
            return backwards;
        }
        looks.back_to = None;
        let supervision = &self.settings.supervision;
        // On as it turned on the way back, so that it sees first what it has not seen.
        let to_the_right = looks.turned_rad < -TURNED_RAD;
        let turn_rad_s = if looks.turned_rad.abs() >= supervision.spin_rad {
            0.0
        } else if promising {
            supervision.confirming_rad_s
        } else {
            supervision.spin_rad_s
        };
        [0.0, if to_the_right { -turn_rad_s } else { turn_rad_s }]
    }

    /// How to go backwards to a pose of the wheels; `None` once the robot is there.
    pub(super) fn backwards(&mut self, back_to: &PlanarPose, elapsed_s: f64) -> Option<[f64; 2]> {
        let robot = self.allowing_for_commands(&self.wheels?.odometry);
        let way = robot.inverse().compose(back_to);
        if way.x_m().hypot(way.y_m()) <= BACK_M {
            return None;
        }
        // The way that it came: it turns enough as it is.
        let error_rad = (-way.y_m()).atan2(-way.x_m());
        let [speed_m_s, turn_rad_s] = self.steering.steer(error_rad, elapsed_s, &self.settings.steering);
        Some([-speed_m_s, turn_rad_s])
    }

    /// Why it is not on its way, as far as its task says.
    pub(super) fn reason(&self, status: Status) -> Option<Reason> {
        match &self.task {
            Task::Nothing => Some(Reason::NoGoal),
            Task::Plan { .. } => Some(Reason::Planning),
            Task::LookAround(looks) => Some(Reason::Lost(looks.because)),
            Task::Follow(_) | Task::Face { .. } if status == Status::Searching => {
                let now = self.localization()?;
                let since_closure_ns = now.since_closure_ns;
                let since_closure_m = now.since_closure_m;
                Some(Reason::Searching { since_closure_ns, since_closure_m })
            }
            Task::Follow(_) | Task::Face { .. } | Task::Arrived => None,
        }
    }

    /// At the first point of the local path that is far enough away.
    fn steer(&mut self, elapsed_s: f64) -> ([f64; 2], Status, Option<f64>) {
        let status = self.following();
        let Some(estimate) = self.estimate() else { return ([0.0; 2], Status::Lost, None) };
        let robot = self.allowing_for_commands(&estimate.pose);
        let Task::Follow(journey) = &mut self.task else { return ([0.0; 2], status, None) };
        let settings = &self.settings.path;
        let nearest = journey.path.nearest(&robot, journey.progress, settings.window_m);
        journey.progress = journey.progress.max(nearest);
        let here = Vector2::new(robot.x_m(), robot.y_m());
        let end_m = journey.path.points().last().map_or(0.0, |end| (end - here).norm());
        if journey.path.remaining_m(journey.progress) <= settings.arrived_m && end_m <= settings.rejoin_m {
            let goal = journey.goal;
            self.steering.reset();
            return if let Some(heading_rad) = self.facing_rad {
                self.task = Task::Face { goal, heading_rad };
                ([0.0; 2], status, Some(heading_rad))
            } else {
                self.task = Task::Arrived;
                ([0.0; 2], Status::Arrived, None)
            };
        }
        let to_target = journey.local.target(&robot, settings.target_m) - here;
        let heading_rad = to_target.y.atan2(to_target.x);
        let error_rad = PlanarPose::new(0.0, 0.0, heading_rad - robot.heading_rad()).heading_rad();
        let motion = self.steering.steer(error_rad, elapsed_s, &self.settings.steering);
        (motion, status, Some(heading_rad))
    }

    /// Turns on the spot.
    fn face(&mut self, heading_rad: f64, elapsed_s: f64) -> ([f64; 2], Status, Option<f64>) {
        let status = self.following();
        let Some(estimate) = self.estimate() else { return ([0.0; 2], Status::Lost, None) };
        let robot = self.allowing_for_commands(&estimate.pose);
        let error_rad = PlanarPose::new(0.0, 0.0, heading_rad - robot.heading_rad()).heading_rad();
        if error_rad.abs() <= FACED_RAD {
            self.task = Task::Arrived;
            return ([0.0; 2], Status::Arrived, None);
        }
        let [_, turn_rad_s] = self.steering.steer(error_rad, elapsed_s, &self.settings.steering);
        ([0.0, turn_rad_s], status, Some(heading_rad))
    }

    fn following(&self) -> Status {
        let supervision = &self.settings.supervision;
        let recent = self.localization().is_some_and(|now| {
            now.since_closure_m <= supervision.searching_m && now.since_closure_ns <= supervision.searching_ns
        });
        if recent { Status::Following } else { Status::Searching }
    }
}
