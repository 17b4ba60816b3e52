//! A robot that drives along a line as it is told: kinematics, closures, and time.

use std::collections::VecDeque;

use fabmap::PlaceId;
use nalgebra::{Matrix3, Vector3};
use posegraph::{PlanarPose, Pose};
use topomap::evidence::VerificationSettings;
use topomap::metric::Odometry;
use waypost_navigation::metric::localization::Glimpses;
use waypost_navigation::metric::planning::{Travel, Waypoint};
use waypost_navigation::metric::{
    Closure, Driver, Goal, Guidance, Look, MapPosition, NavigationSettings, Navigator, Route, Sight, Status,
    VelocityCommand, WheelReport,
};

pub(crate) const STEP_NS: i64 = 50_000_000;
pub(crate) const STEPS_PER_FRAME: u64 = 10;

/// What closures say of where the robot is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fixes {
    /// The truth.
    Perfect,
    /// The truth, off by up to so many metres and half as many radians.
    Noisy(f64),
    /// The place on the line beside which the robot is; its offset turns the heading, as what is so
    /// many metres away would be shifted in the image.
    OfTheLine { depth_m: f64 },
}

/// A robot whose wheels are off, a line of 12 m along x, and a link.
#[derive(Clone)]
pub(crate) struct World {
    /// Of each closure.
    pub(crate) evidence: f64,
    /// Whether it sees what was taught.
    pub(crate) knows: bool,
    /// Whether its frames show too little to say anything.
    pub(crate) sees_bare_walls: bool,
    /// Whether its wheels turn and it stays where it is.
    pub(crate) slips: bool,
    /// Whether what it sees is taken for no place, since its wheels speak against it.
    pub(crate) doubts_what_it_sees: bool,
    /// Variance along the way of what it sees.
    pub(crate) along_m2: f64,
    pub(crate) driver: Driver,
    pub(crate) truth: PlanarPose,
    pub(crate) wheels: PlanarPose,
    pub(crate) drift_rad_per_m: f64,
    pub(crate) scale: f64,
    pub(crate) fixes: Fixes,
    pub(crate) delay_steps: u64,
    pub(crate) navigator: Navigator,
    pub(crate) on_the_way: VecDeque<(u64, VelocityCommand)>,
    pub(crate) reports: VecDeque<(u64, WheelReport)>,
    pub(crate) looks: VecDeque<(u64, Look)>,
    pub(crate) command: Option<(u64, VelocityCommand)>,
    pub(crate) step: u64,
    pub(crate) chance: u64,
    pub(crate) commands: Vec<VelocityCommand>,
    pub(crate) path: Vec<PlanarPose>,
    pub(crate) last: Option<Guidance>,
}

pub(crate) const LENGTH_M: f64 = 12.0;

pub(crate) const NOTHING: Glimpses = [None; VerificationSettings::MAX_CANDIDATES];

pub(crate) fn route() -> Route {
    let waypoint = |place: u32| {
        let pose = PlanarPose::new(0.5 * f64::from(place), 0.0, 0.0);
        Waypoint { place: PlaceId::new(place), pose, travel: Travel::Along }
    };
    Route { part: PlaceId::new(0), waypoints: (0..=24).map(waypoint).collect(), length_m: LENGTH_M }
}

pub(crate) fn odometry(pose: &PlanarPose) -> Odometry {
    let (sin, cos) = (pose.heading_rad() / 2.0).sin_cos();
    Odometry::new([pose.x_m(), pose.y_m(), 0.0], [0.0, 0.0, sin, cos], None).unwrap()
}

impl World {
    pub(crate) fn new(start: PlanarPose, fixes: Fixes) -> Self {
        let mut navigator = Navigator::new(NavigationSettings::default()).unwrap();
        navigator.go_to(Goal::Place(PlaceId::new(24)));
        Self {
            evidence: 100.0,
            knows: true,
            sees_bare_walls: false,
            slips: false,
            doubts_what_it_sees: false,
            along_m2: 0.02,
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
    pub(crate) fn draw(&mut self) -> f64 {
        self.chance =
            self.chance.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.chance >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
    }

    pub(crate) fn closure(&mut self) -> Closure {
        let [x_m, y_m, heading_rad] = [self.truth.x_m(), self.truth.y_m(), self.truth.heading_rad()];
        let pose = match self.fixes {
            Fixes::Perfect => self.truth,
            Fixes::Noisy(most) => {
                let [along, across, turn] = [self.draw(), self.draw(), self.draw()].map(|draw| draw * most);
                PlanarPose::new(x_m + along, y_m + across, heading_rad + turn / 2.0)
            }
            Fixes::OfTheLine { depth_m } => PlanarPose::new(x_m, 0.0, heading_rad + (y_m / depth_m).atan()),
        };
        let covariance = Matrix3::from_diagonal(&Vector3::new(self.along_m2, 0.3 * self.along_m2, 0.0012));
        let (at, from_view) = (MapPosition { part: PlaceId::new(0), pose }, PlanarPose::identity());
        let place = (2.0 * x_m).max(0.0) as u32;
        Closure {
            place: PlaceId::new(place),
            frame: 1,
            at,
            from_view,
            covariance,
            probability: 0.99,
            evidence: Some(self.evidence),
        }
    }

    pub(crate) fn stamp_ns(&self) -> i64 {
        self.step as i64 * STEP_NS
    }

    /// A step of 50 ms.
    pub(crate) fn advance(&mut self, sees: bool, moves: bool) {
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
            if !self.slips {
                self.truth = self.truth.compose(&arc(way_m, turn_rad));
            }
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
            let mut glimpses = NOTHING;
            let sight = match (self.sees_bare_walls, self.knows, self.doubts_what_it_sees) {
                (true, _, _) => Sight::TooLittle,
                (false, true, false) => Sight::Closure(self.closure()),
                (false, true, true) => {
                    glimpses[0] = Some(self.closure());
                    Sight::Unknown
                }
                (false, false, _) => Sight::Unknown,
            };
            let evidence = if self.knows { 100.0 } else { 0.0 };
            let episode = self.navigator.episode();
            let (stamp_ns, odometry) = (self.stamp_ns(), Some(self.wheels));
            self.looks.push_back((
                self.step + self.delay_steps,
                Look { stamp_ns, odometry, sight, evidence, glimpses, episode },
            ));
        }
        self.serve();
        while let Some((_, command)) = self.on_the_way.pop_front_if(|(due, _)| *due <= self.step) {
            self.command = Some((self.step, command));
        }
    }

    pub(crate) fn serve(&mut self) {
        while let Some((_, look)) = self.looks.pop_front_if(|(due, _)| *due <= self.step) {
            self.navigator.see(&look);
            if self.navigator.wanted_route().is_some() {
                self.navigator.follow(&route());
            }
        }
        while let Some((_, report)) = self.reports.pop_front_if(|(due, _)| *due <= self.step) {
            let guidance = self.navigator.drive(&report);
            self.commands.push(guidance.command);
            self.on_the_way.push_back((self.step + self.delay_steps, guidance.command));
            self.last = Some(guidance);
        }
    }

    pub(crate) fn status(&self) -> Status {
        self.last.map_or(Status::Idle, |guidance| guidance.status)
    }

    pub(crate) fn run(&mut self, steps: u64) {
        for _ in 0..steps {
            self.advance(true, true);
            if self.status() == Status::Arrived {
                break;
            }
        }
    }

    /// Largest distance to the line from `x_m` on.
    pub(crate) fn across_m(&self, x_m: f64) -> f64 {
        self.path.iter().filter(|pose| pose.x_m() >= x_m).map(|pose| pose.y_m().abs()).fold(0.0, f64::max)
    }
}
