//! A robot that is led along a line, without pictures: kinematics, closures as they would be measured, and time.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking, helpers included")]

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use topomap::navigation::localization::Glimpses;
use topomap::navigation::planning::{PlanError, Travel, Waypoint};
use topomap::navigation::{
    Closure, Driver, Goal, Guidance, Look, MapPosition, NavigationSettings, Navigator, Route, Seen, Sight,
    Status, VelocityCommand, WheelReport,
};
use topomap::odometry::Odometry;
use topomap::relaxation::{PlanarPose, Pose};
use topomap::verification::VerificationSettings;

const STEP_NS: i64 = 50_000_000;
const STEPS_PER_FRAME: u64 = 10;

/// What closures say of where the robot is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fixes {
    /// The truth.
    Perfect,
    /// The truth, off by up to so many metres and half as many radians.
    Noisy(f64),
    /// The place on the line beside which the robot is; its offset turns the heading, as what is so many metres away would
    /// be shifted in the image.
    OfTheLine { depth_m: f64 },
}

/// A robot whose wheels are off, a line of 12 m along x, and a link.
#[derive(Clone)]
struct World {
    /// Of each closure.
    evidence: f64,
    /// Whether it sees what was taught.
    knows: bool,
    driver: Driver,
    truth: PlanarPose,
    wheels: PlanarPose,
    drift_rad_per_m: f64,
    scale: f64,
    fixes: Fixes,
    delay_steps: u64,
    navigator: Navigator,
    on_the_way: VecDeque<(u64, VelocityCommand)>,
    reports: VecDeque<(u64, WheelReport)>,
    looks: VecDeque<(u64, Look)>,
    command: Option<(u64, VelocityCommand)>,
    step: u64,
    chance: u64,
    commands: Vec<VelocityCommand>,
    path: Vec<PlanarPose>,
    last: Option<Guidance>,
}

const LENGTH_M: f64 = 12.0;

const NOTHING: Glimpses = [None; VerificationSettings::MAX_CANDIDATES];

fn route() -> Route {
    let waypoint = |place: u32| {
        let pose = PlanarPose::new(0.5 * f64::from(place), 0.0, 0.0);
        Waypoint { place, pose, travel: Travel::Along }
    };
    Route { part: 0, waypoints: (0..=24).map(waypoint).collect(), length_m: LENGTH_M }
}

fn odometry(pose: &PlanarPose) -> Odometry {
    let (sin, cos) = (pose.heading_rad() / 2.0).sin_cos();
    Odometry::new([pose.x_m(), pose.y_m(), 0.0], [0.0, 0.0, sin, cos], None).unwrap()
}

impl World {
    fn new(start: PlanarPose, fixes: Fixes) -> Self {
        let mut navigator = Navigator::new(NavigationSettings::default()).unwrap();
        navigator.go_to(Goal::Place(24));
        Self {
            evidence: 100.0,
            knows: true,
            driver: Driver::Commands,
            truth: start,
            wheels: PlanarPose::identity(),
            drift_rad_per_m: 0.0,
            scale: 0.0,
            fixes,
            delay_steps: 0,
            navigator,
            on_the_way: VecDeque::new(),
            reports: VecDeque::new(),
            looks: VecDeque::new(),
            command: None,
            step: 0,
            chance: 1,
            commands: Vec::new(),
            path: Vec::new(),
            last: None,
        }
    }

    /// In [-1, 1].
    fn draw(&mut self) -> f64 {
        self.chance =
            self.chance.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.chance >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
    }

    fn closure(&mut self) -> Closure {
        let [x_m, y_m, heading_rad] = [self.truth.x_m(), self.truth.y_m(), self.truth.heading_rad()];
        let pose = match self.fixes {
            Fixes::Perfect => self.truth,
            Fixes::Noisy(most) => {
                let [along, across, turn] = [self.draw(), self.draw(), self.draw()].map(|draw| draw * most);
                PlanarPose::new(x_m + along, y_m + across, heading_rad + turn / 2.0)
            }
            Fixes::OfTheLine { depth_m } => PlanarPose::new(x_m, 0.0, heading_rad + (y_m / depth_m).atan()),
        };
        let covariance = Matrix3::from_diagonal(&Vector3::new(0.02, 0.006, 0.0012));
        let (at, from_view) = (MapPosition { part: 0, pose }, PlanarPose::identity());
        let place = (2.0 * x_m).max(0.0) as u32;
        Closure {
            place,
            frame: 1,
            at,
            from_view,
            covariance,
            probability: 0.99,
            evidence: Some(self.evidence),
        }
    }

    fn stamp_ns(&self) -> i64 {
        self.step as i64 * STEP_NS
    }

    /// A step of 50 ms.
    fn advance(&mut self, sees: bool, moves: bool) {
        self.step += 1;
        let valid =
            self.command.filter(|(since, command)| ((self.step - since) as i64) * STEP_NS < command.valid_ns);
        let seconds = STEP_NS as f64 * 1e-9;
        if let Some((_, command)) = valid.filter(|_| moves) {
            let (way_m, turn_rad) = (command.forward_m_s * seconds, command.turn_rad_s * seconds);
            let arc = |way_m: f64, turn_rad: f64| {
                let half = PlanarPose::new(0.0, 0.0, turn_rad / 2.0);
                half.compose(&PlanarPose::new(way_m, 0.0, 0.0)).compose(&half)
            };
            self.truth = self.truth.compose(&arc(way_m, turn_rad));
            let felt_rad = turn_rad + self.drift_rad_per_m * way_m;
            self.wheels = self.wheels.compose(&arc(way_m * (1.0 + self.scale), felt_rad));
        }
        self.path.push(self.truth);
        let obeyed = self.command.map(|(_, command)| command.number);
        let report = WheelReport {
            stamp_ns: self.stamp_ns(),
            odometry: odometry(&self.wheels),
            obeyed,
            driver: self.driver,
        };
        self.reports.push_back((self.step + self.delay_steps, report));
        if sees && self.step.is_multiple_of(STEPS_PER_FRAME) {
            let sight = if self.knows { Sight::Closure(self.closure()) } else { Sight::Unknown };
            let evidence = if self.knows { 100.0 } else { 0.0 };
            let episode = self.navigator.episode();
            let (stamp_ns, odometry) = (self.stamp_ns(), Some(self.wheels));
            self.looks.push_back((
                self.step + self.delay_steps,
                Look { stamp_ns, odometry, sight, evidence, glimpses: NOTHING, episode },
            ));
        }
        self.serve();
        while let Some((_, command)) = self.on_the_way.pop_front_if(|(due, _)| *due <= self.step) {
            self.command = Some((self.step, command));
        }
    }

    fn serve(&mut self) {
        while let Some((_, look)) = self.looks.pop_front_if(|(due, _)| *due <= self.step) {
            self.navigator.see(&look);
            if self.navigator.wanted_route().is_some() {
                self.navigator.follow(&route());
            }
        }
        while let Some((_, report)) = self.reports.pop_front_if(|(due, _)| *due <= self.step) {
            // The server's clock is another one.
            let guidance = self.navigator.drive(&report, 77_000_000_000 + self.stamp_ns());
            self.commands.push(guidance.command);
            self.on_the_way.push_back((self.step + self.delay_steps, guidance.command));
            self.last = Some(guidance);
        }
    }

    fn status(&self) -> Status {
        self.last.map_or(Status::Idle, |guidance| guidance.status)
    }

    fn run(&mut self, steps: u64) {
        for _ in 0..steps {
            self.advance(true, true);
            if self.status() == Status::Arrived {
                break;
            }
        }
    }

    /// Largest distance to the line from `x_m` on.
    fn across_m(&self, x_m: f64) -> f64 {
        self.path.iter().filter(|pose| pose.x_m() >= x_m).map(|pose| pose.y_m().abs()).fold(0.0, f64::max)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn it_comes_back_to_the_line_and_arrives(
        across_m in -0.5..0.5f64, heading_rad in -1.0..1.0f64, drift in -0.1..0.1f64, scale in -0.08..0.08f64,
    ) {
        let mut world = World::new(PlanarPose::new(0.2, across_m, heading_rad), Fixes::Perfect);
        (world.drift_rad_per_m, world.scale) = (drift, scale);
        world.run(1500);
        prop_assert_eq!(world.status(), Status::Arrived);
        prop_assert!((world.truth.x_m() - LENGTH_M).abs() < 0.15, "{:?}", world.truth);
        prop_assert!(world.across_m(3.0) < 0.06, "{} m", world.across_m(3.0));
        let settings = NavigationSettings::default().steering;
        for command in &world.commands {
            prop_assert!((0.0..=settings.speed_m_s).contains(&command.forward_m_s));
            prop_assert!(command.turn_rad_s.abs() <= settings.max_turn_rad_s && command.valid_ns == settings.valid_ns);
        }
        prop_assert!(world.commands.windows(2).all(|pair| pair[1].number == pair[0].number + 1));
    }

    /// A view cannot tell an offset from a turn: the turn that is believed leads back.
    #[test]
    fn an_offset_that_is_taken_for_a_turn_leads_back(across_m in -0.4..0.4f64, depth_m in 2.0..5.0f64, drift in -0.05..0.05f64) {
        let mut world = World::new(PlanarPose::new(0.2, across_m, 0.0), Fixes::OfTheLine { depth_m });
        world.drift_rad_per_m = drift;
        world.run(1500);
        prop_assert_eq!(world.status(), Status::Arrived);
        // After two depths an eighth is left of it, and what the drift has added until it was learnt.
        prop_assert!(world.across_m(0.2 + 2.0 * depth_m) < 0.2 * across_m.abs() + 0.08, "{} m", world.across_m(2.0 * depth_m));
    }

    #[test]
    fn noise_late_answers_and_late_commands_are_borne(
        across_m in -0.3..0.3f64, drift in -0.1..0.1f64, delay_steps in 0..10u64, chance in any::<u64>(),
    ) {
        let mut world = World::new(PlanarPose::new(0.2, across_m, 0.0), Fixes::Noisy(0.12));
        (world.drift_rad_per_m, world.delay_steps, world.chance) = (drift, delay_steps, chance);
        world.run(2000);
        prop_assert_eq!(world.status(), Status::Arrived);
        prop_assert!(world.across_m(3.0) < 0.25, "{} m", world.across_m(3.0));
    }
}

#[test]
fn the_same_calls_give_the_same_commands() {
    let drive = || {
        let mut world = World::new(PlanarPose::new(0.2, 0.3, 0.4), Fixes::Noisy(0.1));
        world.drift_rad_per_m = 0.05;
        world.run(600);
        world.commands
    };
    assert_eq!(drive(), drive());
}

#[test]
fn without_vision_it_goes_on_is_less_and_less_sure_and_at_last_looks_around() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(80);
    assert_eq!(world.status(), Status::Following);
    let mut before = world.last.unwrap().localization.unwrap();
    // Five seconds, two metres.
    for _ in 0..5 {
        (0..20).for_each(|_| world.advance(false, true));
        let now = world.last.unwrap().localization.unwrap();
        assert!(now.position_sigma_m > before.position_sigma_m && now.confidence < before.confidence);
        assert!(
            now.since_closure_m > before.since_closure_m && now.since_closure_ns > before.since_closure_ns
        );
        before = now;
    }
    assert_eq!(world.status(), Status::Searching);
    assert!(world.truth.y_m().abs() < 0.05);
    let lost_m = NavigationSettings::default().supervision.lost_m;
    let steps = (lost_m / 0.4 / 0.05) as usize;
    (0..steps).for_each(|_| world.advance(false, true));
    assert_eq!(world.status(), Status::Lost);
    assert_eq!(world.last.unwrap().localization, None);
    // It stands, and then turns on the spot, until it sees again.
    let stood = world.truth;
    (0..60).for_each(|_| world.advance(false, true));
    assert!(
        (world.truth.x_m() - stood.x_m()).abs() < 0.1 && world.truth.heading_rad() != stood.heading_rad()
    );
    world.run(1500);
    assert_eq!(world.status(), Status::Arrived);
}

#[test]
fn carried_off_to_where_views_are_clear_it_plans_anew_at_once() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(100);
    world.truth = PlanarPose::new(9.0, 0.1, 0.5);
    for _ in 0..400 {
        world.advance(true, true);
        assert_ne!(world.status(), Status::Lost);
    }
    assert_eq!(world.status(), Status::Arrived);
    assert!(world.truth.x_m() > 9.0);
}

#[test]
fn carried_off_it_forgets_finds_out_and_wants_another_plan() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(100);
    let episode = world.navigator.episode();
    world.truth = PlanarPose::new(9.0, 0.1, 0.5);
    // Views that show that it is elsewhere, and not clearly where.
    world.evidence = 40.0;
    while world.status() != Status::Lost {
        assert_ne!(world.status(), Status::Arrived);
        world.advance(true, true);
    }
    assert!(world.navigator.episode() > episode && world.navigator.localization().is_none());
    world.evidence = 100.0;
    world.run(400);
    assert_eq!(world.status(), Status::Arrived);
    // What was under way from before is not listened to.
    let sight = Sight::Closure(world.closure());
    let (stamp_ns, odometry) = (1 << 50, Some(world.wheels));
    let old = Look { stamp_ns, odometry, sight, evidence: 0.0, glimpses: NOTHING, episode };
    assert_eq!(world.navigator.see(&old), Seen::Stale);
}

#[test]
fn a_robot_that_does_not_move_is_blocked_and_tries_again() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(60);
    let mut statuses = Vec::new();
    for _ in 0..120 {
        world.advance(true, false);
        statuses.push(world.last.unwrap());
    }
    let blocked: Vec<_> = statuses.iter().filter(|guidance| guidance.status == Status::Blocked).collect();
    assert!(!blocked.is_empty());
    assert!(
        blocked
            .iter()
            .all(|guidance| guidance.command.forward_m_s == 0.0 && guidance.command.turn_rad_s == 0.0)
    );
    let first = statuses.iter().position(|guidance| guidance.status == Status::Blocked).unwrap();
    assert!(statuses[first..].iter().any(|guidance| guidance.command.forward_m_s > 0.0));
    world.run(1500);
    assert_eq!(world.status(), Status::Arrived);
}

#[test]
fn a_reflex_is_told_of_and_a_cancelled_robot_stands() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(60);
    let report = WheelReport {
        stamp_ns: world.stamp_ns() + 1,
        odometry: odometry(&world.wheels),
        obeyed: None,
        driver: Driver::Reflex,
    };
    assert_eq!(world.navigator.drive(&report, 1 << 60).status, Status::Blocked);
    world.navigator.cancel();
    let guidance = world.navigator.drive(&report, (1 << 60) + 1);
    assert_eq!(
        (guidance.status, guidance.command.forward_m_s, guidance.command.turn_rad_s),
        (Status::Idle, 0.0, 0.0)
    );
    assert!(guidance.localization.is_some() && world.navigator.path().is_none());
}

#[test]
fn a_goal_may_say_where_to_look() {
    for heading_rad in [-2.5, -0.6, 0.0, 1.2, 3.1] {
        let mut world = World::new(PlanarPose::new(0.2, 0.1, 0.0), Fixes::Perfect);
        world.drift_rad_per_m = 0.05;
        world.navigator.go_to_facing(Goal::Place(24), heading_rad).unwrap();
        world.run(1500);
        (0..20).for_each(|_| world.advance(true, true));
        assert_eq!(world.status(), Status::Arrived);
        let off = PlanarPose::new(0.0, 0.0, world.truth.heading_rad() - heading_rad).heading_rad();
        assert!(off.abs() < 0.1 && (world.truth.x_m() - LENGTH_M).abs() < 0.15, "{:?}", world.truth);
    }
    let mut world = World::new(PlanarPose::new(0.2, 0.1, 0.0), Fixes::Perfect);
    assert_eq!(world.navigator.go_to_facing(Goal::Place(24), f64::NAN), Err(PlanError::NotFinite));
}

/// It looks away from what was taught as it turns to where it is to look: that is no reason to be lost.
#[test]
fn views_that_are_not_those_of_the_way_say_nothing_while_it_is_not_on_it() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.navigator.go_to_facing(Goal::Place(24), 3.0).unwrap();
    while world.truth.heading_rad().abs() < 0.5 {
        world.advance(true, true);
        assert!(world.step < 2000);
    }
    world.knows = false;
    for _ in 0..400 {
        world.advance(true, true);
        assert_ne!(world.status(), Status::Lost);
    }
    assert_eq!(world.status(), Status::Arrived);
    assert!(world.navigator.localization().is_some());
}

#[test]
fn on_its_way_it_is_lost_where_nothing_is_known_and_goes_back_as_it_came() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(150);
    world.knows = false;
    let knew_x_m = world.truth.x_m();
    while world.status() != Status::Lost {
        world.advance(true, true);
        assert!(world.step < 400);
    }
    assert!(world.truth.x_m() - knew_x_m > 0.5);
    let (first, looked_to) = (world.commands.len(), world.truth.heading_rad());
    while world.truth.x_m() > knew_x_m + 0.2 {
        world.advance(true, true);
        assert!((world.truth.heading_rad() - looked_to).abs() < 0.1 && world.step < 1000);
    }
    assert!(world.commands[first..].iter().any(|command| command.forward_m_s < 0.0));
    world.knows = true;
    world.run(1500);
    assert_eq!(world.status(), Status::Arrived);
}

#[test]
fn somebody_who_stands_before_it_for_a_while_does_not_make_it_lost() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(150);
    world.knows = false;
    let steps = |looks: u32| u64::from(looks) * STEPS_PER_FRAME;
    let standing = NavigationSettings::default().supervision.unknown_looks_standing;
    for _ in 0..steps(standing - 2) {
        world.advance(true, false);
        assert_ne!(world.status(), Status::Lost);
    }
    let mut left = world.clone();
    world.knows = true;
    world.run(1500);
    assert_eq!(world.status(), Status::Arrived);
    // Who never goes away has been mistaken for a wall.
    left.knows = false;
    for _ in 0..steps(4) {
        left.advance(true, false);
    }
    assert_eq!(left.status(), Status::Lost);
}

#[test]
fn its_reflex_may_turn_it_away_for_a_while() {
    let drive = |driver: Driver| {
        let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
        world.run(150);
        (world.knows, world.driver) = (false, driver);
        let looks = NavigationSettings::default().supervision.unknown_looks + 2;
        (0..u64::from(looks) * STEPS_PER_FRAME).for_each(|_| world.advance(true, true));
        world.navigator.localization().is_some()
    };
    assert!(drive(Driver::Reflex) && !drive(Driver::Commands));
}
