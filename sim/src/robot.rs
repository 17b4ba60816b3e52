//! A robot on two driven wheels.

mod wheel_odometry;

use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::pose::Pose;
use crate::random::derived_seed;
use crate::range::{self, OutOfRange};

pub use wheel_odometry::{OdometryReading, WheelErrors, WheelOdometry};

/// What a robot is commanded to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Metres a second; below 0 backwards.
    pub forward_m_s: f64,
    /// Radians a second, to the left.
    pub turn_rad_s: f64,
    /// How long after it has come it holds, in nanoseconds; then the robot stops.
    pub valid_ns: i64,
}

/// What a robot can do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Of its round hull, in metres.
    pub radius_m: f64,
    /// Between its wheels, in metres.
    pub track_m: f64,
    /// Metres a second.
    pub max_forward_m_s: f64,
    /// Radians a second.
    pub max_turn_rad_s: f64,
    /// Metres a second, a second.
    pub max_acceleration_m_s2: f64,
    /// Radians a second, a second.
    pub max_turn_acceleration_rad_s2: f64,
}

impl Default for Body {
    fn default() -> Self {
        Self {
            radius_m: 0.2,
            track_m: 0.32,
            max_forward_m_s: 0.8,
            max_turn_rad_s: 1.5,
            max_acceleration_m_s2: 1.5,
            max_turn_acceleration_rad_s2: 6.0,
        }
    }
}

/// The robot: what it really does, and what its wheels say.
#[derive(Clone, Debug)]
pub struct Robot {
    body: Body,
    pose: Pose,
    forward_m_s: f64,
    turn_rad_s: f64,
    command: Option<(Command, i64)>,
    odometry: WheelOdometry,
    slip: Slip,
}

/// One wheel that turns without grip.
#[derive(Clone, Debug)]
struct Slip {
    random: ChaCha8Rng,
    left_m: f64,
    wheel: usize,
}

impl Robot {
    /// A robot that stands at `pose`. Its odometry starts at (0, 0, 0).
    ///
    /// # Errors
    /// [`OutOfRange`] if body or wheels have a number that is out of its range.
    pub fn new(body: Body, pose: Pose, errors: WheelErrors, seed: u64) -> Result<Self, OutOfRange> {
        range::check(&[
            ("radius_m", body.radius_m, 0.05, 2.0),
            ("track_m", body.track_m, 0.05, 4.0),
            ("max_forward_m_s", body.max_forward_m_s, 0.01, 10.0),
            ("max_turn_rad_s", body.max_turn_rad_s, 0.01, 10.0),
            ("max_acceleration_m_s2", body.max_acceleration_m_s2, 0.01, 100.0),
            ("max_turn_acceleration_rad_s2", body.max_turn_acceleration_rad_s2, 0.01, 100.0),
        ])?;
        let slip = Slip { random: ChaCha8Rng::seed_from_u64(derived_seed(seed, 0)), left_m: 0.0, wheel: 0 };
        let odometry = WheelOdometry::new(errors, derived_seed(seed, 1))?;
        Ok(Self { body, pose, forward_m_s: 0.0, turn_rad_s: 0.0, command: None, odometry, slip })
    }

    /// Its measures.
    #[must_use]
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// Where it really is.
    #[must_use]
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Metres a second ahead and radians a second to the left, as its wheels turn.
    #[must_use]
    pub fn speed(&self) -> [f64; 2] {
        [self.forward_m_s, self.turn_rad_s]
    }

    /// What its wheels say.
    #[must_use]
    pub fn odometry(&self) -> &WheelOdometry {
        &self.odometry
    }

    /// Takes a command that has come at `now_ns`; it holds from then on. One that is not a number
    /// is not obeyed: the robot stops.
    pub fn command(&mut self, command: Command, now_ns: i64) {
        let is_finite = command.forward_m_s.is_finite() && command.turn_rad_s.is_finite();
        self.command = is_finite.then_some((command, now_ns.saturating_add(command.valid_ns)));
    }

    /// The command that holds at `now_ns`.
    #[must_use]
    pub fn command_at(&self, now_ns: i64) -> Option<&Command> {
        self.command.as_ref().filter(|(_, until_ns)| now_ns < *until_ns).map(|(command, _)| command)
    }

    /// Drives for some seconds as it was commanded, or as `reflex` wants ([m/s, rad/s]), if it
    /// wants something. Where that ends; the robot does not go there by itself, because something
    /// may be in the way.
    pub(crate) fn drive(&mut self, now_ns: i64, seconds: f64, reflex: Option<[f64; 2]>) -> Pose {
        let commanded =
            self.command_at(now_ns).map_or([0.0; 2], |command| [command.forward_m_s, command.turn_rad_s]);
        let [forward, turn] = reflex.unwrap_or(commanded);
        let body = &self.body;
        let approach = |now: f64, wanted: f64, most: f64, change: f64| {
            now + (wanted.clamp(-most, most) - now).clamp(-change * seconds, change * seconds)
        };
        self.forward_m_s =
            approach(self.forward_m_s, forward, body.max_forward_m_s, body.max_acceleration_m_s2);
        self.turn_rad_s =
            approach(self.turn_rad_s, turn, body.max_turn_rad_s, body.max_turn_acceleration_rad_s2);
        let distance_m = self.forward_m_s * seconds;
        let turn_rad = self.turn_rad_s * seconds;
        self.odometry.add(distance_m, turn_rad);
        let [distance_m, turn_rad] =
            self.slip.gripped(distance_m, turn_rad, body.track_m, self.odometry.errors());
        self.pose.driven(distance_m, turn_rad)
    }

    /// Puts it somewhere, its odometry unaware: what moves it there, or keeps it there, are not its
    /// wheels.
    pub(crate) fn put(&mut self, pose: Pose) {
        self.pose = pose;
    }
}

impl Slip {
    /// What is left of a motion when one wheel may slip.
    fn gripped(&mut self, distance_m: f64, turn_rad: f64, track_m: f64, errors: &WheelErrors) -> [f64; 2] {
        let way_m = distance_m.abs();
        if self.left_m <= 0.0 && self.random.random::<f64>() < errors.slips_per_m * way_m {
            self.left_m = errors.slip_m;
            self.wheel = usize::from(self.random.random::<f64>() < 0.5);
        }
        if self.left_m <= 0.0 {
            return [distance_m, turn_rad];
        }
        let mut wheels = [distance_m - turn_rad * track_m / 2.0, distance_m + turn_rad * track_m / 2.0];
        self.left_m -= wheels[self.wheel].abs();
        wheels[self.wheel] = 0.0;
        [(wheels[0] + wheels[1]) / 2.0, (wheels[1] - wheels[0]) / track_m]
    }
}
