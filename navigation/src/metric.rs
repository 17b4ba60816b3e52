//! How a robot is led along a map by its camera and its wheels. Bazeille, Battesti and Filliat
//! 2011, section 4.
//!
//! Frames come in now and then and say where the robot is ([`Lookout`], beside the map); odometry
//! comes in often and is answered with a command ([`Navigator::drive`]). In between is a plan
//! ([`planning::plan`]). The navigator itself knows no map: its holder looks at frames and
//! plans, when [`Navigator::wanted_route`] asks for it.

mod commands;
mod following;
mod guidance;
pub mod localization;
mod obstacles;
pub mod path;
pub mod planning;
mod pose_filter;
mod search;
pub mod settings;
pub mod steering;
mod supervision;
mod tasks;

use std::sync::Arc;

use self::commands::CommandsOnTheWay;
use self::following::{MotionWatch, SlipWatch};
pub use self::guidance::{
    Driver, Guidance, Localization, LostBecause, Obstacle, Reason, Status, WantedRoute, WheelReport,
};
pub use self::localization::{Closure, Look, Lookout, Sight};
use self::path::GlobalPath;
pub use self::planning::{Goal, MapPosition, PlanError, Route};
pub use self::pose_filter::Seen;
use self::pose_filter::{Estimate, PoseFilter};
pub use self::settings::{NavigationSettings, NavigationSettingsError};
use self::steering::Steering;
pub use self::steering::VelocityCommand;
use self::supervision::UnknownLooks;
use self::tasks::{Journey, LookAround, Task};
use posegraph::{PlanarPose, Pose};

/// Leads one robot. Time is the robot's alone, by the stamps of what it sends, in nanoseconds: its
/// clock never goes back, and may run at any speed. The same calls give the same commands.
#[derive(Clone, Debug)]
pub struct Navigator {
    settings: NavigationSettings,
    filter: PoseFilter,
    /// The last odometry.
    wheels: Option<Reading>,
    /// Who drove then.
    driver: Driver,
    /// Odometry of the last closure.
    closed_at: Option<PlanarPose>,
    /// Driven since then, in metres.
    since_closure_m: f64,
    /// Frames since then that showed something, and nothing known.
    unknown: UnknownLooks,
    /// Of the last frame.
    evidence: f64,
    episode: u64,
    task: Task,
    /// Where the robot is to look at its goal, in the map's frame.
    facing_rad: Option<f64>,
    steering: Steering,
    commands: CommandsOnTheWay,
    watch: MotionWatch,
    slip: SlipWatch,
    /// Stamp of the latest frame; of the first report, until one came.
    seen_ns: Option<i64>,
}

/// Wheels that turn slower than this stand, in m/s.
const CREEPING_M_S: f64 = 0.02;

#[derive(Clone, Copy, Debug, PartialEq)]
struct Reading {
    stamp_ns: i64,
    odometry: PlanarPose,
}

impl Navigator {
    /// A robot that may be anywhere, and has no goal.
    ///
    /// # Errors
    /// [`NavigationSettingsError`] if a setting is out of its range.
    pub fn new(settings: NavigationSettings) -> Result<Self, NavigationSettingsError> {
        settings.check()?;
        Ok(Self {
            filter: PoseFilter::new(&settings.localization),
            settings,
            wheels: None,
            driver: Driver::Commands,
            closed_at: None,
            since_closure_m: 0.0,
            unknown: UnknownLooks::default(),
            evidence: 0.0,
            episode: 0,
            task: Task::Nothing,
            facing_rad: None,
            steering: Steering::default(),
            commands: CommandsOnTheWay::default(),
            watch: MotionWatch::default(),
            slip: SlipWatch::default(),
            seen_ns: None,
        })
    }

    /// Sends the robot to a goal, in place of where it was going.
    pub fn go_to(&mut self, goal: Goal) {
        (self.task, self.facing_rad) = (self.start(goal), None);
    }

    /// The same, and at the goal it turns on the spot until it looks to `heading_rad`, in the frame
    /// of the goal's part of the map.
    ///
    /// # Errors
    /// [`PlanError::NotFinite`] if that is no number; it goes on as before then.
    pub fn go_to_facing(&mut self, goal: Goal, heading_rad: f64) -> Result<(), PlanError> {
        if !heading_rad.is_finite() {
            return Err(PlanError::NotFinite);
        }
        (self.task, self.facing_rad) = (self.start(goal), Some(heading_rad));
        Ok(())
    }

    /// The robot is to stop and has no goal any more.
    pub fn cancel(&mut self) {
        self.task = Task::Nothing;
    }

    /// What is to be planned now, by [`planning::plan`]; the answer goes to [`Navigator::follow`],
    /// or an error to who set the goal, and [`Navigator::cancel`].
    #[must_use]
    pub fn wanted_route(&self) -> Option<WantedRoute> {
        let Task::Plan { goal } = self.task else { return None };
        let estimate = self.estimate()?;
        let from = MapPosition { part: estimate.part, pose: estimate.pose };
        Some(WantedRoute { from, goal })
    }

    /// Takes the route that was wanted.
    pub fn follow(&mut self, route: &Route) {
        let (Task::Plan { goal }, Some(estimate)) = (&self.task, self.estimate()) else { return };
        let path = Arc::new(GlobalPath::new(route, &self.settings.path));
        let robot = self.allowing_for_commands(&estimate.pose);
        let progress = path.nearest(&robot, 0, self.settings.path.window_m);
        let local = path.local(&robot, progress, &self.settings.path);
        self.steering.reset();
        self.task = Task::Follow(Box::new(Journey { goal: *goal, path, local, progress, joined: false }));
    }

    /// Rises whenever nothing that was seen before counts any more; [`Lookout::look`] wants it of
    /// when a frame came.
    #[must_use]
    pub fn episode(&self) -> u64 {
        self.episode
    }

    /// The points that the robot is led along, in metres in the map's frame: the whole way.
    #[must_use]
    pub fn path(&self) -> Option<&GlobalPath> {
        match &self.task {
            Task::Follow(journey) => Some(&journey.path),
            Task::Nothing | Task::LookAround(_) | Task::Plan { .. } | Task::Face { .. } | Task::Arrived => {
                None
            }
        }
    }

    /// Takes in what a frame showed. Looks may come late, in any order, or not at all.
    pub fn see(&mut self, look: &Look) -> Seen {
        self.seen_ns = self.seen_ns.max(Some(look.stamp_ns));
        if look.episode != self.episode {
            return Seen::Stale;
        }
        self.evidence = look.evidence;
        let Some(odometry) = &look.odometry else { return Seen::Nothing };
        let closure = match &look.sight {
            Sight::Closure(closure) => Some(closure),
            Sight::Unknown | Sight::TooLittle => None,
        };
        let shown = (closure, &look.glimpses);
        let seen = self.filter.see(shown, (look.stamp_ns, odometry), &self.settings.localization);
        let is_recognised = matches!(seen, Seen::Corrected | Seen::Found);
        if let Some(shown) = self.unrecognised(&look.sight).filter(|_| !is_recognised)
            && self.should_recognise(odometry)
        {
            self.unknown.add(shown, self.driver, self.since_closure_m);
            if let Some(because) = self.unknown.too_many(&self.settings.supervision) {
                self.lose(self.closed_at, because);
            }
        }
        if let Some(sighting) = SlipWatch::sighting(look, &self.settings.localization) {
            self.watch_slip((look.stamp_ns, odometry), sighting);
        }
        match seen {
            Seen::Corrected => self.closed(odometry),
            Seen::Found => {
                self.closed(odometry);
                match &self.task {
                    Task::LookAround(LookAround { goal, .. }) => self.task = Task::Plan { goal: *goal },
                    Task::Follow(journey) => self.task = Task::Plan { goal: journey.goal },
                    Task::Face { goal, .. } => self.task = Task::Plan { goal: *goal },
                    Task::Nothing | Task::Plan { .. } | Task::Arrived => {}
                }
            }
            Seen::Kidnapped => self.lose(None, LostBecause::CarriedOff),
            Seen::Unconfirmed | Seen::Stale | Seen::Nothing => {}
        }
        seen
    }

    /// Answers the robot's odometry with a command.
    pub fn drive(&mut self, report: &WheelReport) -> Guidance {
        let odometry = PlanarPose::seen_from_above(report.odometry.pose());
        let (elapsed_s, moved) = self.take(report.stamp_ns, odometry);
        self.driver = report.driver;
        let obeyed = self.commands.obey(report.obeyed);
        if let Some(driven_m) = self.is_too_unsure() {
            self.lose(self.closed_at, LostBecause::Far { driven_m });
        }
        if let (Task::LookAround(looks), Driver::Reflex) = (&mut self.task, report.driver) {
            looks.back_to = None;
        }
        let (wanted, status, heading_to_target_rad) = self.wanted_motion(elapsed_s, moved, report.stamp_ns);
        let reason = self.reason(status);
        let obeyed = match report.driver {
            Driver::Commands => obeyed,
            Driver::Reflex => [0.0; 2],
        };
        let (motion, mut status, mut reason) = self
            .held((obeyed, wanted), (report.stamp_ns, &odometry), elapsed_s)
            .map_or((wanted, status, reason), |(motion, held)| (motion, Status::Blocked, Some(held)));
        if report.driver == Driver::Reflex && status != Status::Idle {
            (status, reason) = (Status::Blocked, Some(Reason::Reflex));
        }
        let localization = self.localization();
        let remaining_m = match &self.task {
            Task::Follow(journey) => Some(journey.path.remaining_m(journey.progress)),
            Task::Face { .. } | Task::Arrived => Some(0.0),
            Task::Nothing | Task::LookAround(_) | Task::Plan { .. } => None,
        };
        let command = self.commands.give(motion, report.stamp_ns, self.settings.steering.valid_ns);
        Guidance { command, status, localization, remaining_m, heading_to_target_rad, reason }
    }

    /// Where the robot is now, if that is known.
    #[must_use]
    pub fn localization(&self) -> Option<Localization> {
        let estimate = self.estimate()?;
        let position_sigma_m = estimate.position_sigma_m();
        let sure = 1.0 - position_sigma_m / self.settings.supervision.lost_sigma_m;
        Some(Localization {
            node: estimate.node,
            at: MapPosition { part: estimate.part, pose: estimate.pose },
            position_sigma_m,
            heading_sigma_rad: estimate.heading_sigma_rad(),
            confidence: estimate.probability * sure.clamp(0.0, 1.0),
            since_closure_ns: self.wheels.map_or(0, |wheels| (wheels.stamp_ns - estimate.closed_ns).max(0)),
            since_closure_m: self.since_closure_m,
        })
    }

    fn estimate(&self) -> Option<Estimate> {
        self.filter.at(&self.wheels?.odometry, &self.settings.localization)
    }

    fn start(&self, goal: Goal) -> Task {
        if self.estimate().is_some() {
            Task::Plan { goal }
        } else {
            let because = LostBecause::NotFoundYet;
            Task::LookAround(LookAround { goal, because, since_ns: None, back_to: None, turned_rad: 0.0 })
        }
    }

    /// Nothing that was believed counts any more. `back_to` is where the robot last knew, by its
    /// wheels.
    fn lose(&mut self, back_to: Option<PlanarPose>, because: LostBecause) {
        self.filter.forget();
        self.slip.forget();
        self.episode += 1;
        (self.since_closure_m, self.unknown, self.evidence) = (0.0, UnknownLooks::default(), 0.0);
        let goal = match &self.task {
            Task::LookAround(LookAround { goal, .. }) | Task::Plan { goal } | Task::Face { goal, .. } => {
                *goal
            }
            Task::Follow(journey) => journey.goal,
            Task::Nothing | Task::Arrived => return,
        };
        let back_to = back_to.zip(self.wheels).and_then(|(back_to, now)| {
            let way = now.odometry.inverse().compose(&back_to);
            let reach_m = self.settings.supervision.retreat_m;
            (way.x_m().hypot(way.y_m()) <= reach_m).then_some(back_to)
        });
        self.steering.reset();
        self.task = Task::LookAround(LookAround { goal, because, since_ns: None, back_to, turned_rad: 0.0 });
    }

    /// Seconds by the robot's clock, and metres and radians, since the odometry before.
    fn take(&mut self, stamp_ns: i64, odometry: PlanarPose) -> (f64, [f64; 2]) {
        let before = self.wheels.replace(Reading { stamp_ns, odometry });
        let Some(before) = before else { return (0.0, [0.0; 2]) };
        let moved = before.odometry.inverse().compose(&odometry);
        let way_m = moved.x_m().hypot(moved.y_m());
        self.since_closure_m += way_m;
        let elapsed_ns = stamp_ns.saturating_sub(before.stamp_ns).max(0);
        let elapsed_s = elapsed_ns as f64 * 1e-9;
        if way_m > CREEPING_M_S * elapsed_s {
            self.unknown.drive(elapsed_ns);
        }
        (elapsed_s.clamp(0.0, 1.0), [way_m, moved.heading_rad()])
    }

    /// A closure at `odometry` was believed: the local path begins where that puts the robot.
    fn closed(&mut self, odometry: &PlanarPose) {
        self.unknown = UnknownLooks::default();
        let Some(now) = self.wheels else { return };
        self.closed_at = Some(*odometry);
        let since = odometry.inverse().compose(&now.odometry);
        self.since_closure_m = since.x_m().hypot(since.y_m());
        let Some(estimate) = self.estimate() else { return };
        let robot = self.allowing_for_commands(&estimate.pose);
        if let Task::Follow(journey) = &mut self.task {
            let settings = &self.settings.path;
            journey.joined = true;
            journey.progress = journey.path.nearest(&robot, journey.progress, settings.window_m);
            journey.local = journey.path.local(&robot, journey.progress, settings);
        }
    }

    /// Whether a robot that is where it is believed to be sees there what was seen when the way was
    /// taught.
    ///
    /// One that was found off its way first comes to it; one that its reflex turned away from it
    /// has been carried off as likely as not.
    fn should_recognise(&mut self, odometry: &PlanarPose) -> bool {
        let Some(Estimate { pose, .. }) = self.filter.at(odometry, &self.settings.localization) else {
            return false;
        };
        match &mut self.task {
            Task::Follow(journey) => {
                let supervision = &self.settings.supervision;
                let window_m = self.settings.path.window_m;
                let (away_m, turned_rad) = journey.path.away(&pose, journey.progress, window_m);
                journey.joined |= away_m <= supervision.near_m && turned_rad <= supervision.near_rad;
                journey.joined
            }
            Task::Face { .. } => false,
            // It looks where it was told to.
            Task::Arrived if self.facing_rad.is_some() => false,
            Task::Nothing | Task::LookAround(_) | Task::Plan { .. } | Task::Arrived => true,
        }
    }

    /// How far it has driven without a closure, if that is too far.
    fn is_too_unsure(&self) -> Option<f64> {
        let supervision = &self.settings.supervision;
        let unsure = self.estimate()?.position_sigma_m() > supervision.lost_sigma_m;
        let driven_m = self.since_closure_m;
        let too_unsure = unsure && driven_m > supervision.searching_m || driven_m > supervision.lost_m;
        too_unsure.then_some(driven_m)
    }

    /// Where the robot will be when the next command comes to it.
    fn allowing_for_commands(&self, pose: &PlanarPose) -> PlanarPose {
        let now_ns = self.wheels.map_or(i64::MIN, |wheels| wheels.stamp_ns);
        self.commands.obeyed_from(pose, now_ns, self.settings.steering.valid_ns)
    }
}
