//! Time, and all that happens in it.

mod barrier;
mod recording;

use std::sync::Arc;

use crate::light::Light;
use crate::people::{Behaviour, Person, PersonError, Walker};
use crate::pose::{Pose, wrapped};
use crate::random::derived_seed;
use crate::range::{self, OutOfRange};
use crate::range_sensor::{RangeScan, RangeSensor, Reflex, ReflexSettings};
use crate::render::{CameraRig, Shot};
use crate::robot::{Body, Command, OdometryReading, Robot, WheelErrors};
use crate::scene::Scene;

use barrier::Barrier;
pub use barrier::HeldWheels;
pub use recording::{DriveError, Recording};

/// A robot in a building with people in it. It advances by a fixed period; commands are given in
/// between.
#[derive(Clone, Debug)]
pub struct Simulation {
    scene: Arc<Scene>,
    settings: SimulationSettings,
    now_ns: i64,
    robot: Robot,
    people: Vec<Walker>,
    reflex: Option<Reflex>,
    scan: RangeScan,
    last_frame: Option<LastFrame>,
    frames: u64,
    collisions: u64,
    touches: Touch,
    barrier: Option<Barrier>,
}

/// What a [`Simulation`] starts from, besides building and place.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulationSettings {
    /// What the robot sees with.
    pub rig: CameraRig,
    /// When it takes an image.
    pub trigger: CameraTrigger,
    /// What it is like.
    pub body: Body,
    /// How wrong its wheels are.
    pub wheels: WheelErrors,
    /// What it feels its way with.
    pub range_sensor: RangeSensor,
    /// When it ignores commands; `None` if it always obeys.
    pub reflex: Option<ReflexSettings>,
    /// How the building is lit.
    pub light: Light,
    /// From step to step, in nanoseconds, from 1 ms to 1 s.
    pub period_ns: i64,
    /// Of all chance.
    pub seed: u64,
}

/// When the camera takes an image. The first one is taken at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraTrigger {
    /// After so much way or turn since the last one, by the wheels.
    Moved {
        /// Metres.
        distance_m: f64,
        /// Radians.
        angle_rad: f64,
    },
    /// After so many nanoseconds since the last one.
    Period {
        /// From image to image.
        period_ns: i64,
    },
}

/// Settings that make no simulation.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// A number of the robot, its wheels, its sensors or of time.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
    /// The robot would stand in a wall or in furniture.
    #[error("the robot does not fit at ({x_m:.2}, {y_m:.2}); start it elsewhere")]
    NoRoom {
        /// Where, in metres.
        x_m: f64,
        /// Where, in metres.
        y_m: f64,
    },
}

/// What is known after a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// When, in nanoseconds since the start.
    pub stamp_ns: i64,
    /// Where the robot really is.
    pub truth: Pose,
    /// Where its wheels say it is, in a frame that started at (0, 0, 0).
    pub odometry: OdometryReading,
    /// Whether it obeys commands.
    pub obedience: Obedience,
    /// The image that it takes now, if any.
    pub frame: Option<CameraFrame>,
}

/// Whether a robot obeys commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Obedience {
    /// It does.
    Commanded,
    /// It has no command that still holds: it stops.
    Idle,
    /// Its reflex has taken over.
    Reflex,
}

/// An image before it is rendered: [`Scene::render`] does that, here or on another thread.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFrame {
    /// From 0.
    pub number: u64,
    /// When, in nanoseconds since the start.
    pub stamp_ns: i64,
    /// Where the wheels said the robot was.
    pub odometry: OdometryReading,
    /// All that the image depends on, the true pose among it.
    pub shot: Shot,
}

#[derive(Clone, Debug)]
struct LastFrame {
    stamp_ns: i64,
    odometry: Pose,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Touch {
    Apart,
    Touching,
}

/// What the robot touched is left behind when it is so far away, in metres.
const APART_M: f64 = 0.03;

impl SimulationSettings {
    /// A robot with perfect wheels, an image every 50 cm or 10 degrees, 50 steps a second and a
    /// reflex.
    #[must_use]
    pub fn new(rig: CameraRig) -> Self {
        Self {
            rig,
            trigger: CameraTrigger::Moved { distance_m: 0.5, angle_rad: 10_f64.to_radians() },
            body: Body::default(),
            wheels: WheelErrors::NONE,
            range_sensor: RangeSensor::default(),
            reflex: Some(ReflexSettings::default()),
            light: Light::default(),
            period_ns: 20_000_000,
            seed: 0,
        }
    }
}

impl SimulationSettings {
    fn check(&self) -> Result<(), OutOfRange> {
        self.range_sensor.check()?;
        self.reflex.map_or(Ok(()), |reflex| reflex.check())?;
        range::check(&[("period_ns", self.period_ns as f64, 1e6, 1e9)])?;
        match self.trigger {
            CameraTrigger::Moved { distance_m, angle_rad } => range::check(&[
                ("distance_m", distance_m, 0.001, 1000.0),
                ("angle_rad", angle_rad, 0.001, 7.0),
            ]),
            CameraTrigger::Period { period_ns } => {
                range::check(&[("the camera's period_ns", period_ns as f64, 1e6, 1e12)])
            }
        }
    }
}

impl Simulation {
    /// Everything at rest, the robot at `start`.
    ///
    /// # Errors
    /// [`SimulationError`] if the settings are not those of a simulation, or there is no room at
    /// the start.
    pub fn new(
        scene: Arc<Scene>,
        start: Pose,
        settings: SimulationSettings,
    ) -> Result<Self, SimulationError> {
        settings.check()?;
        let robot = Robot::new(settings.body, start, settings.wheels, derived_seed(settings.seed, 1))?;
        if scene.plan().clearance_m(start.position()) < settings.body.radius_m {
            return Err(SimulationError::NoRoom { x_m: start.x_m, y_m: start.y_m });
        }
        let scan = settings.range_sensor.scan(scene.plan(), &start, &[], 0);
        Ok(Self {
            reflex: settings.reflex.map(Reflex::new),
            scene,
            settings,
            now_ns: 0,
            robot,
            people: Vec::new(),
            scan,
            last_frame: None,
            frames: 0,
            collisions: 0,
            touches: Touch::Apart,
            barrier: None,
        })
    }

    /// A person comes in.
    ///
    /// # Errors
    /// [`PersonError`] if there is no room for them.
    pub fn add_person(&mut self, person: Person, behaviour: Behaviour) -> Result<(), PersonError> {
        self.people.push(Walker::new(self.scene.plan(), person, behaviour)?);
        Ok(())
    }

    /// Gives the robot a command, which arrives now.
    pub fn command(&mut self, command: Command) {
        self.robot.command(command, self.now_ns);
    }

    /// Carries the robot elsewhere; its wheels do not notice.
    ///
    /// # Errors
    /// [`SimulationError::NoRoom`] if there is none.
    pub fn kidnap(&mut self, pose: Pose) -> Result<(), SimulationError> {
        if !self.has_room(&pose, 0.0) {
            return Err(SimulationError::NoRoom { x_m: pose.x_m, y_m: pose.y_m });
        }
        self.robot.put(pose);
        Ok(())
    }

    /// From now on something that no sensor sees keeps the robot from going on to where it looks.
    pub fn hold_back(&mut self, wheels: HeldWheels) {
        self.barrier = Some(Barrier { at: *self.robot.pose(), wheels });
    }

    /// Changes the light.
    pub fn set_light(&mut self, light: Light) {
        self.settings.light = light;
    }

    /// Lets a period pass.
    pub fn advance(&mut self) -> Tick {
        let seconds = self.settings.period_ns as f64 * 1e-9;
        let robot = *self.robot.pose();
        let radius_m = self.settings.body.radius_m;
        for walker in &mut self.people {
            walker.advance(self.scene.plan(), &robot, radius_m, seconds);
        }
        let people = self.people();
        let scan_seed = derived_seed(derived_seed(self.settings.seed, 2), self.now_ns as u64);
        self.scan = self.settings.range_sensor.scan(self.scene.plan(), &robot, &people, scan_seed);
        let forward_m_s = self.robot.command_at(self.now_ns).map_or(0.0, |command| command.forward_m_s);
        let reflex = self
            .reflex
            .as_mut()
            .and_then(|reflex| reflex.react(&self.scan, radius_m, forward_m_s, self.now_ns));
        let obedience = match (reflex, self.robot.command_at(self.now_ns)) {
            (Some(_), _) => Obedience::Reflex,
            (None, Some(_)) => Obedience::Commanded,
            (None, None) => Obedience::Idle,
        };
        let command = self.robot.command_at(self.now_ns);
        let held = self.barrier.and_then(|barrier| barrier.limited(&robot, command));
        let next = self.robot.drive(self.now_ns, seconds, reflex.or(held));
        self.go_to(next);
        self.now_ns += self.settings.period_ns;
        self.tick(obedience, people)
    }

    /// What holds it back stops the robot, but it can still turn.
    fn go_to(&mut self, next: Pose) {
        let here = *self.robot.pose();
        if self.barrier.is_some_and(|barrier| barrier.stops(&here, &next)) {
            self.robot.put(Pose { heading_rad: next.heading_rad, ..here });
            return;
        }
        if self.has_room(&next, 0.0) {
            // A robot that pushes against a wall touches it once.
            if self.has_room(&next, APART_M) {
                self.touches = Touch::Apart;
            }
            self.robot.put(next);
            return;
        }
        if self.touches == Touch::Apart {
            self.collisions += 1;
        }
        self.touches = Touch::Touching;
        self.robot.put(Pose { heading_rad: next.heading_rad, ..here });
    }

    fn has_room(&self, pose: &Pose, margin_m: f64) -> bool {
        let radius_m = self.settings.body.radius_m + margin_m;
        let apart = |walker: &Walker| walker.person().pose.distance_m(pose) >= radius_m + Person::RADIUS_M;
        self.scene.plan().clearance_m(pose.position()) >= radius_m && self.people.iter().all(apart)
    }

    fn tick(&mut self, obedience: Obedience, people: Vec<Person>) -> Tick {
        let odometry = *self.robot.odometry().reading();
        let frame = self.is_frame_due(&odometry.pose).then(|| {
            self.last_frame = Some(LastFrame { stamp_ns: self.now_ns, odometry: odometry.pose });
            self.frames += 1;
            let number = self.frames - 1;
            let shot = self.shot(people, number);
            CameraFrame { number, stamp_ns: self.now_ns, odometry, shot }
        });
        Tick { stamp_ns: self.now_ns, truth: *self.robot.pose(), odometry, obedience, frame }
    }

    fn is_frame_due(&self, odometry: &Pose) -> bool {
        let Some(last) = &self.last_frame else { return true };
        match self.settings.trigger {
            CameraTrigger::Moved { distance_m, angle_rad } => {
                let turned = wrapped(odometry.heading_rad - last.odometry.heading_rad).abs();
                last.odometry.distance_m(odometry) >= distance_m || turned >= angle_rad
            }
            CameraTrigger::Period { period_ns } => self.now_ns - last.stamp_ns >= period_ns,
        }
    }

    fn shot(&self, people: Vec<Person>, number: u64) -> Shot {
        Shot {
            pose: *self.robot.pose(),
            speed: self.robot.speed(),
            people,
            light: self.settings.light,
            seed: derived_seed(derived_seed(self.settings.seed, 3), number),
        }
    }

    /// What the camera would see now; no image of the robot's own.
    #[must_use]
    pub fn look(&self) -> Shot {
        self.shot(self.people(), u64::MAX)
    }

    /// Where everybody is.
    #[must_use]
    pub fn people(&self) -> Vec<Person> {
        self.people.iter().map(|walker| *walker.person()).collect()
    }

    /// The building.
    #[must_use]
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// What it was started from.
    #[must_use]
    pub fn settings(&self) -> &SimulationSettings {
        &self.settings
    }

    /// The robot.
    #[must_use]
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// What the range sensor saw in the last step.
    #[must_use]
    pub fn scan(&self) -> &RangeScan {
        &self.scan
    }

    /// Nanoseconds since the start.
    #[must_use]
    pub fn now_ns(&self) -> i64 {
        self.now_ns
    }

    /// How often the robot ran into something.
    #[must_use]
    pub fn collisions(&self) -> u64 {
        self.collisions
    }
}
