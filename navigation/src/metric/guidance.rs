//! What a robot reports, and what it is told.

use std::fmt;

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
    /// Why it stands, waits, searches or looks around; `None` where it is on its way or there.
    pub reason: Option<Reason>,
}

/// Why a robot goes as it does, and what it waits for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reason {
    /// Nobody sent it anywhere.
    NoGoal,
    /// It is known where it is, and the way is being planned.
    Planning,
    /// Its own reflex drives.
    Reflex,
    /// It is on its way by wheels.
    Searching {
        /// Since the last closure, by the robot's clock, in nanoseconds.
        since_closure_ns: i64,
        /// Driven since then, in metres.
        since_closure_m: f64,
    },
    /// No frame comes, and nobody sees where it goes.
    NoFrames {
        /// For how long, by the robot's clock, in nanoseconds.
        for_ns: i64,
    },
    /// It stands before something, or is held.
    Held(Obstacle),
    /// The same, and it goes back a little the way that it came.
    BackingOff(Obstacle),
    /// It does not know where it is.
    Lost(LostBecause),
}

/// How a robot is found to be held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Obstacle {
    /// Its wheels do not do what they are told to.
    WheelsStand,
    /// They turn, and what it recognises stays where it was.
    WheelsSlip,
}

/// Why a robot does not know where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LostBecause {
    /// It has recognised nothing so far.
    NotFoundYet,
    /// Frames showed something, and not what is known there.
    UnknownLooks {
        /// How many.
        frames: u32,
    },
    /// It drove for long without recognising anything.
    NothingRecognised {
        /// Frames since the last closure.
        frames: u32,
        /// Driven since then, in nanoseconds of the robot's clock.
        driven_ns: i64,
    },
    /// It drove far without recognising anything.
    Far {
        /// Since the last closure, in metres.
        driven_m: f64,
    },
    /// It recognised again and again what is elsewhere.
    CarriedOff,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoGoal => f.write_str("it has no goal: it stands until it is given one"),
            Self::Planning => f.write_str("it stands while the way to its goal is planned"),
            Self::Reflex => f.write_str(
                "its own reflex drives, and commands are not obeyed: it goes on when the reports say that the reflex is over",
            ),
            Self::Searching { since_closure_ns, since_closure_m } => write!(
                f,
                "nothing was recognised for {:.1} s and {since_closure_m:.1} m: it goes on by its wheels",
                *since_closure_ns as f64 * 1e-9
            ),
            Self::NoFrames { for_ns } => write!(
                f,
                "no frame came for {:.1} s, by their stamps and those of the wheels: it stands until one comes; see that \
                 the camera delivers and that its frames are sent",
                *for_ns as f64 * 1e-9
            ),
            Self::Held(obstacle) => write!(f, "{obstacle}: it stands, and then goes back a little and tries again"),
            Self::BackingOff(obstacle) => {
                write!(f, "{obstacle}: it goes back a little the way that it came, and then tries again")
            }
            Self::Lost(because) => {
                write!(f, "{because}: it looks around until frames in agreement say where it is")
            }
        }
    }
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::WheelsStand => {
                "it is told to move and its wheels do not: something holds it, or it does not obey commands"
            }
            Self::WheelsSlip => {
                "its wheels turn and what it sees stays the same: something holds it, and the wheels slip"
            }
        })
    }
}

impl fmt::Display for LostBecause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFoundYet => f.write_str("it has recognised no place of the map yet"),
            Self::UnknownLooks { frames } => {
                write!(f, "{frames} frames in a row did not show what is known where it should be")
            }
            Self::NothingRecognised { frames, driven_ns } => write!(
                f,
                "it drove for {:.1} s without recognising anything in {frames} frames",
                *driven_ns as f64 * 1e-9
            ),
            Self::Far { driven_m } => write!(f, "it drove {driven_m:.1} m without recognising anything"),
            Self::CarriedOff => {
                f.write_str("it recognised again and again what is elsewhere: it was carried off")
            }
        }
    }
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
