//! What a robot reports, and what it is told.

use fabmap::appearance::PlaceId;
use topomap::metric::Odometry;

use super::planning::{Goal, MapPosition};
use super::steering::VelocityCommand;

/// What a robot's wheels say.
#[derive(Clone, Debug, PartialEq)]
pub struct WheelReport {
    /// When, by the robot's clock.
    pub stamp_ns: i64,
    /// Where they put the robot.
    pub odometry: Odometry,
    /// [`VelocityCommand::number`] of the command that the robot then obeyed; `None` if it does not
    /// say. With it, late commands are allowed for.
    pub obeyed: Option<u64>,
    /// Who drives.
    pub driver: Driver,
}

/// Who decides what a robot does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Driver {
    /// The commands.
    Commands,
    /// Its own reflex, for a moment.
    Reflex,
}

/// What a robot is to do, and what is known of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guidance {
    /// What to do until the next one.
    pub command: VelocityCommand,
    /// How it goes.
    pub status: Status,
    /// Where it is; `None` if that is not known.
    pub localization: Option<Localization>,
    /// What is left of the way, in metres, if there is one.
    pub remaining_m: Option<f64>,
    /// Where to the robot should look, in the map's frame, in radians, if it is led along a way.
    pub heading_to_target_rad: Option<f64>,
}

/// How it goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Status {
    /// There is no goal: the robot stands.
    Idle,
    /// It is on its way.
    Following,
    /// It is on its way by wheels: nothing was recognised for a while.
    Searching,
    /// It does not know where it is, and looks around.
    Lost,
    /// It is there.
    Arrived,
    /// It is to move and does not, or its reflex drives.
    Blocked,
}

/// Where a robot is on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Localization {
    /// The place that was recognised last.
    pub node: PlaceId,
    /// Where the robot is now.
    pub at: MapPosition,
    /// Standard deviation of its position in the direction in which it is largest, in metres.
    pub position_sigma_m: f64,
    /// The same of its heading, in radians.
    pub heading_sigma_rad: f64,
    /// In [0, 1]: the probability of the last closure, times what is left of it as the position's
    /// deviation grows; 0 where the robot would be given up for lost.
    pub confidence: f64,
    /// Since the last closure, by the robot's clock, in nanoseconds.
    pub since_closure_ns: i64,
    /// Driven since then, in metres.
    pub since_closure_m: f64,
}

/// What to plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WantedRoute {
    /// Where the robot is.
    pub from: MapPosition,
    /// Where it is to go.
    pub goal: Goal,
}
