//! How far it is to the next thing all around, and the reflex that keeps a robot from running into
//! it.

use std::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::Vector2;

use crate::floor_plan::{FloorPlan, Thing};
use crate::people::Person;
use crate::pose::{Pose, wrapped};
use crate::random::{derived_seed, unit};
use crate::range::{self, OutOfRange};

/// A sensor that looks around in the plane at one height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeSensor {
    /// Beams all around, evenly; the first looks ahead, the others follow to the left. At least 8.
    pub beams: u32,
    /// What is further is seen there, in metres.
    pub max_m: f64,
    /// Above the floor, in metres.
    pub height_m: f64,
    /// A range is off by this at most, evenly, in metres.
    pub noise_m: f64,
}

/// What a [`RangeSensor`] saw.
#[derive(Clone, Debug, PartialEq)]
pub struct RangeScan {
    /// Metres from the sensor, by beam.
    pub ranges_m: Vec<f64>,
}

impl Default for RangeSensor {
    fn default() -> Self {
        Self { beams: 90, max_m: 8.0, height_m: 0.3, noise_m: 0.01 }
    }
}

impl RangeSensor {
    pub(crate) fn check(&self) -> Result<(), OutOfRange> {
        range::check(&[
            ("beams", f64::from(self.beams), 8.0, 4096.0),
            ("max_m", self.max_m, 0.1, 1000.0),
            ("height_m", self.height_m, 0.01, 2.5),
            ("noise_m", self.noise_m, 0.0, 1.0),
        ])
    }

    /// A look around from the middle of a robot.
    #[must_use]
    pub fn scan(&self, plan: &FloorPlan, robot: &Pose, people: &[Person], seed: u64) -> RangeScan {
        let range = |beam: u32| {
            let angle = robot.heading_rad + TAU * f64::from(beam) / f64::from(self.beams);
            let direction = Vector2::new(angle.cos(), angle.sin());
            let far = self.range_to_plan(plan, robot.position(), direction);
            let bodies =
                people.iter().filter_map(|person| range_to_person(person, robot.position(), direction));
            let nearest = bodies.fold(far, f64::min);
            let noise = self.noise_m * (2.0 * unit(derived_seed(seed, u64::from(beam))) - 1.0);
            (nearest + noise).clamp(0.0, self.max_m)
        };
        RangeScan { ranges_m: (0..self.beams).map(range).collect() }
    }

    fn range_to_plan(&self, plan: &FloorPlan, from: Vector2<f64>, direction: Vector2<f64>) -> f64 {
        let parts = plan.parts();
        let mut nearest = self.max_m;
        plan.obstacles().cast(parts, from, direction, |hit| {
            let (bottom, top) = match hit.thing {
                Thing::Wall(index) => (parts.walls[index].bottom_m, parts.walls[index].top_m),
                Thing::Furniture(index) => (parts.furniture[index].bottom_m, parts.furniture[index].top_m),
            };
            if (bottom..=top).contains(&self.height_m) {
                nearest = nearest.min(hit.enters);
            }
            nearest
        });
        nearest
    }
}

fn range_to_person(person: &Person, from: Vector2<f64>, direction: Vector2<f64>) -> Option<f64> {
    let offset = from - person.pose.position();
    let half = offset.dot(&direction);
    let inside = half * half - offset.norm_squared() + Person::RADIUS_M * Person::RADIUS_M;
    (inside > 0.0 && half < 0.0).then(|| (-half - inside.sqrt()).max(0.0))
}

impl RangeScan {
    /// Metres that the hull of a round robot can go straight ahead before it touches what was seen.
    #[must_use]
    pub fn room_ahead_m(&self, radius_m: f64) -> f64 {
        let touches = |(x, y): (f64, f64)| {
            let inside = radius_m * radius_m - y * y;
            (x > 0.0 && inside > 0.0).then(|| (x - inside.sqrt()).max(0.0))
        };
        self.points().filter_map(touches).fold(f64::INFINITY, f64::min)
    }

    /// The heading nearest to the wanted one, within a quarter turn, in which a round hull has room
    /// for 35 cm and 5 cm to either side; the wanted one if there is none. What a camera sees past,
    /// a robot may not get past: a corner of a wall, a table's. From straight ahead to the left, in
    /// (-π, π].
    #[must_use]
    pub fn free_heading_rad(&self, wanted_rad: f64, radius_m: f64) -> f64 {
        const ROOM_M: f64 = 0.35;
        const MARGIN_M: f64 = 0.05;
        let radius_m = radius_m + MARGIN_M;
        let room_m = |heading: f64| {
            let (sin, cos) = heading.sin_cos();
            let turned = self.points().map(|(x, y)| (x * cos + y * sin, y * cos - x * sin));
            let gaps = turned.filter_map(|(along, aside)| {
                let inside = radius_m * radius_m - aside * aside;
                (along > 0.0 && inside > 0.0).then(|| along - inside.sqrt())
            });
            gaps.fold(f64::INFINITY, f64::min)
        };
        let around = (0..=36).map(|step| {
            let aside = FRAC_PI_2 * f64::from((step + 1) / 2) / 18.0;
            wanted_rad + if step % 2 == 0 { aside } else { -aside }
        });
        let free = around.into_iter().find(|&heading| room_m(heading) >= ROOM_M);
        wrapped(free.unwrap_or(wanted_rad))
    }

    /// 1.0 if there is more room to the left, -1.0 if to the right.
    fn roomier_side(&self) -> f64 {
        let quarter = self.ranges_m.len() / 3;
        let left: f64 = self.ranges_m[1..=quarter].iter().sum();
        let right: f64 = self.ranges_m[self.ranges_m.len() - quarter..].iter().sum();
        if left >= right { 1.0 } else { -1.0 }
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        let beams = self.ranges_m.len() as f64;
        self.ranges_m.iter().enumerate().map(move |(beam, range)| {
            let angle = TAU * beam as f64 / beams;
            (range * angle.cos(), range * angle.sin())
        })
    }
}

/// Stops a robot before it touches something, turns it to where there is room and drives it there
/// for a moment. It lets commands through that do not go ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflex {
    settings: ReflexSettings,
    state: ReflexState,
}

/// When a [`Reflex`] acts, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReflexSettings {
    /// It acts when the hull would touch something within this way ahead, in metres.
    pub stop_m: f64,
    /// Room to each side of the hull that it wants, in metres.
    pub margin_m: f64,
    /// How fast it turns, in radians a second.
    pub turn_rad_s: f64,
    /// How long it goes ahead when there is room again, in nanoseconds, and how fast, in m/s.
    pub ahead_ns: i64,
    /// See `ahead_ns`.
    pub ahead_m_s: f64,
}

impl ReflexSettings {
    pub(crate) fn check(&self) -> Result<(), OutOfRange> {
        range::check(&[
            ("stop_m", self.stop_m, 0.0, 10.0),
            ("margin_m", self.margin_m, 0.0, 1.0),
            ("turn_rad_s", self.turn_rad_s, 0.01, 10.0),
            ("ahead_ns", self.ahead_ns as f64, 0.0, 60e9),
            ("ahead_m_s", self.ahead_m_s, 0.01, 10.0),
        ])
    }
}

impl Default for ReflexSettings {
    fn default() -> Self {
        Self { stop_m: 0.25, margin_m: 0.04, turn_rad_s: 0.8, ahead_ns: 1_000_000_000, ahead_m_s: 0.25 }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum ReflexState {
    Resting,
    Turning { side: f64 },
    GoingAhead { side: f64, until_ns: i64 },
}

impl Reflex {
    /// How much more room there must be than what made it act, in metres.
    const RELIEF_M: f64 = 0.15;

    /// A reflex at rest.
    #[must_use]
    pub fn new(settings: ReflexSettings) -> Self {
        Self { settings, state: ReflexState::Resting }
    }

    /// What it wants instead of driving ahead at `forward_m_s`: m/s ahead and rad/s to the left.
    /// `None` while it rests.
    pub fn react(
        &mut self,
        scan: &RangeScan,
        radius_m: f64,
        forward_m_s: f64,
        now_ns: i64,
    ) -> Option<[f64; 2]> {
        let ReflexSettings { stop_m, margin_m, turn_rad_s, ahead_ns, ahead_m_s } = self.settings;
        let room_m = scan.room_ahead_m(radius_m + margin_m);
        self.state = match self.state {
            ReflexState::Resting if forward_m_s > 0.0 && room_m < stop_m => {
                ReflexState::Turning { side: scan.roomier_side() }
            }
            ReflexState::Turning { side } if room_m >= stop_m + Self::RELIEF_M => {
                ReflexState::GoingAhead { side, until_ns: now_ns + ahead_ns }
            }
            ReflexState::GoingAhead { side, .. } if room_m < stop_m => ReflexState::Turning { side },
            ReflexState::GoingAhead { until_ns, .. } if now_ns >= until_ns => ReflexState::Resting,
            state => state,
        };
        match self.state {
            ReflexState::Resting => None,
            ReflexState::Turning { side } => Some([0.0, side * turn_rad_s]),
            ReflexState::GoingAhead { .. } => Some([ahead_m_s, 0.0]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::worlds::NamedWorld;

    #[test]
    fn ranges_are_those_of_the_plan_and_of_people() {
        let plan = NamedWorld::Loop.plan(1);
        let sensor = RangeSensor { noise_m: 0.0, height_m: 2.3, max_m: 20.0, beams: 360 };
        // Above all furniture, in the south corridor, 13.5 m long and 2 m wide.
        let scan = sensor.scan(&plan, &Pose::new(5.0, 0.8, 0.0), &[], 0);
        let expected = [(0, 8.5), (90, 1.2), (180, 5.0), (270, 0.8)];
        assert!(
            expected.iter().all(|&(beam, range): &(usize, f64)| (scan.ranges_m[beam] - range).abs() < 1e-9)
        );
        let person = Person { pose: Pose::new(7.0, 0.8, 0.0), look: 0 };
        let scan = sensor.scan(&plan, &Pose::new(5.0, 0.8, 0.0), &[person], 0);
        assert!((scan.ranges_m[0] - (2.0 - Person::RADIUS_M)).abs() < 1e-9);
        assert!((scan.room_ahead_m(0.2) - (2.0 - Person::RADIUS_M - 0.2)).abs() < 0.02);
        assert_eq!(scan.ranges_m[180], 5.0);
    }

    #[test]
    fn a_robot_slides_along_what_is_in_its_way() {
        let free = |ranges_m: Vec<f64>, wanted| RangeScan { ranges_m }.free_heading_rad(wanted, 0.2);
        // A wall half a metre to one side, an open floor else.
        let beside_a_wall = |wall_rad: f64| {
            let range = |beam: u32| {
                let along = (TAU * f64::from(beam) / 90.0 - wall_rad).cos();
                if along > 0.07 { (0.3 / along).min(8.0) } else { 8.0 }
            };
            (0..90).map(range).collect::<Vec<f64>>()
        };
        for wanted in [-2.0, 0.0, 1.0] {
            assert!((free(vec![3.0; 90], wanted) - wanted).abs() < 1e-9);
            let turned = wrapped(free(beside_a_wall(wanted + 0.3), wanted) - wanted);
            assert!(turned < -0.5 && turned > -FRAC_PI_2 - 0.1, "{turned}, away from the wall");
        }
        // Walled in, there is no better heading than the wanted one.
        assert!((free(vec![0.28; 90], 0.4) - 0.4).abs() < 1e-9);
    }

    #[test]
    fn the_reflex_rests_where_there_is_room_or_no_way_ahead_is_wanted() {
        let settings = ReflexSettings::default();
        let mut reflex = Reflex::new(settings);
        let mut scan = RangeScan { ranges_m: vec![3.0; 90] };
        assert_eq!(reflex.react(&scan, 0.2, 0.4, 0), None);
        scan.ranges_m[0] = 0.3;
        assert_eq!(reflex.react(&scan, 0.2, 0.0, 0), None);
        scan.ranges_m[20] = 1.0;
        assert_eq!(reflex.react(&scan, 0.2, 0.4, 0), Some([0.0, -settings.turn_rad_s]));
        scan.ranges_m[0] = 3.0;
        assert_eq!(reflex.react(&scan, 0.2, 0.4, 1), Some([settings.ahead_m_s, 0.0]));
        assert_eq!(reflex.react(&scan, 0.2, 0.4, 1 + settings.ahead_ns), None);
    }
}
