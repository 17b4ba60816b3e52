//! Those who are in the way.

use nalgebra::Vector2;

use crate::floor_plan::{FloorPlan, Thing};
use crate::pose::Pose;

/// Where a person is, as cameras and range sensors see it: upright cylinders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Person {
    /// Feet and the way it faces.
    pub pose: Pose,
    /// What it wears: people with the same number look the same.
    pub look: u64,
}

impl Person {
    /// Of the body, in metres.
    pub const RADIUS_M: f64 = 0.22;
    /// Where the body ends and the head begins, above the floor.
    pub const SHOULDER_M: f64 = 1.45;
    /// Of the head.
    pub const HEAD_RADIUS_M: f64 = 0.11;
    /// Where the head ends.
    pub const HEIGHT_M: f64 = 1.75;
}

/// What a person is about.
#[derive(Clone, Debug, PartialEq)]
pub enum Behaviour {
    /// Stands there.
    Standing,
    /// Walks from corner to corner and back again, and waits for a robot that is in the way.
    Walking {
        /// Where it turns, after where it starts.
        corners: Vec<Vector2<f64>>,
        /// Metres a second.
        speed_m_s: f64,
    },
    /// Comes to a robot that it sees, stands before its camera, and after a while goes back to
    /// where it was: let that be beside the robot's way, or neither gets past.
    Blocking {
        /// How near the robot has to come to be noticed, in metres.
        notice_m: f64,
        /// How long it stands before the robot, in seconds; then it leaves the robot alone for
        /// twice as long.
        patience_s: f64,
        /// Metres a second.
        speed_m_s: f64,
    },
}

/// Numbers that make no person.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PersonError {
    /// It would stand in a wall or in furniture.
    #[error("there is no room for a person at ({x_m}, {y_m}); it needs {} m around it", Person::RADIUS_M)]
    NoRoom {
        /// Where.
        x_m: f64,
        /// Where.
        y_m: f64,
    },
    /// A speed, a distance or a time that is negative or no number.
    #[error("a person's speed, distance and patience must be numbers from 0 up")]
    Number,
}

/// A person over time.
#[derive(Clone, Debug)]
pub struct Walker {
    person: Person,
    behaviour: Behaviour,
    home: Vector2<f64>,
    /// Of a walking person: the corner it goes to.
    next: usize,
    /// Of a blocking person: seconds that it has stood, and that it stays away.
    stood_s: f64,
    away_s: f64,
}

impl Walker {
    /// From a robot's hull to a person who stands before it, in metres.
    pub const DISTANCE_M: f64 = 0.2;

    /// # Errors
    /// [`PersonError`] if there is no room where it starts, or a setting is not a number.
    pub fn new(plan: &FloorPlan, person: Person, behaviour: Behaviour) -> Result<Self, PersonError> {
        let numbers: &[f64] = match &behaviour {
            Behaviour::Standing => &[],
            Behaviour::Walking { speed_m_s, .. } => &[*speed_m_s],
            Behaviour::Blocking { notice_m, patience_s, speed_m_s } => &[*notice_m, *patience_s, *speed_m_s],
        };
        if !numbers.iter().all(|&number| number.is_finite() && number >= 0.0) {
            return Err(PersonError::Number);
        }
        let home = person.pose.position();
        if plan.clearance_m(home) < Person::RADIUS_M {
            return Err(PersonError::NoRoom { x_m: home.x, y_m: home.y });
        }
        Ok(Self { person, behaviour, home, next: 0, stood_s: 0.0, away_s: 0.0 })
    }

    /// Where it is.
    #[must_use]
    pub fn person(&self) -> &Person {
        &self.person
    }

    /// Lets some seconds pass, with a robot of that radius about.
    pub fn advance(&mut self, plan: &FloorPlan, robot: &Pose, robot_radius_m: f64, seconds: f64) {
        let keep_m = robot_radius_m + Person::RADIUS_M + Self::DISTANCE_M;
        match &self.behaviour {
            Behaviour::Standing => {}
            Behaviour::Walking { corners, speed_m_s } => {
                // 0 is where it started: 0, 1, ..., n - 1, n, n - 1, ..., 1, there and back.
                let last = corners.len();
                let stop = last - self.next.abs_diff(last);
                let goal = if stop == 0 { self.home } else { corners[stop - 1] };
                if (goal - self.person.pose.position()).norm() < 0.02 {
                    self.next = (self.next + 1) % (2 * last).max(1);
                }
                let speed_m_s = *speed_m_s;
                self.step(plan, goal, robot, keep_m, speed_m_s * seconds);
            }
            &Behaviour::Blocking { notice_m, patience_s, speed_m_s } => {
                let here = self.person.pose.position();
                let distance = (robot.position() - here).norm();
                self.away_s = (self.away_s - seconds).max(0.0);
                let goal =
                    if self.away_s > 0.0 || distance > notice_m || !is_in_sight(plan, here, robot.position())
                    {
                        self.home
                    } else {
                        // Before the robot's camera, not just anywhere near it.
                        robot.position() + robot.direction() * keep_m
                    };
                if distance < keep_m + 0.3 && self.away_s == 0.0 {
                    self.stood_s += seconds;
                    if self.stood_s >= patience_s {
                        (self.stood_s, self.away_s) = (0.0, 2.0 * patience_s);
                    }
                }
                self.step(plan, goal, robot, keep_m, speed_m_s * seconds);
            }
        }
    }

    /// Goes towards a goal, but not into walls and not into the robot.
    fn step(&mut self, plan: &FloorPlan, goal: Vector2<f64>, robot: &Pose, keep_m: f64, length_m: f64) {
        let here = self.person.pose.position();
        let way = goal - here;
        let Some(direction) = way.try_normalize(1e-9) else { return };
        let wanted = here + direction * length_m.min(way.norm());
        let gap = |place: Vector2<f64>| (place - robot.position()).norm();
        // Around the robot, if it is in the way.
        let apart = |place: Vector2<f64>| {
            let aside = (place - robot.position()).try_normalize(1e-9).unwrap_or(direction);
            if gap(place) < keep_m { robot.position() + aside * keep_m } else { place }
        };
        let mut place = apart(wanted);
        let moved = place - here;
        if moved.norm() > length_m {
            place = here + moved * (length_m / moved.norm());
        }
        let nearer = gap(place) < keep_m && gap(place) < gap(here);
        if plan.clearance_m(place) >= Person::RADIUS_M && !nearer {
            self.person.pose = Pose::new(place.x, place.y, direction.y.atan2(direction.x));
        }
    }
}

fn is_in_sight(plan: &FloorPlan, from: Vector2<f64>, to: Vector2<f64>) -> bool {
    let mut is_clear = true;
    plan.obstacles().cast(plan.parts(), from, to - from, |hit| {
        let bottom_m = match hit.thing {
            Thing::Wall(index) => plan.parts().walls[index].bottom_m,
            Thing::Furniture(index) => plan.parts().furniture[index].bottom_m,
        };
        is_clear &= hit.enters > 1.0 || bottom_m > FloorPlan::HEADROOM_M;
        1.0
    });
    is_clear
}
