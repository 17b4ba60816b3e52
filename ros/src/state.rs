//! What is known of the robot, the map and the server, shared by all tasks.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use waypost_bags::{CameraInfo, live::Mountings};
use waypost_client::v1;

use waypost_ros_messages::Pose;

/// Messages of one topic.
#[derive(Clone, Debug, Default)]
pub(crate) struct Received {
    pub(crate) count: u64,
    pub(crate) left_out: u64,
    /// Why the latest that was left out was.
    pub(crate) problem: Option<String>,
    pub(crate) last: Option<Instant>,
}

impl Received {
    pub(crate) fn good(&mut self) {
        self.count += 1;
        self.last = Some(Instant::now());
    }

    /// True for the first of its kind, which is worth a line in the log.
    pub(crate) fn bad(&mut self, problem: String) -> bool {
        self.left_out += 1;
        let is_new = self.problem.is_none();
        self.problem = Some(problem);
        is_new
    }

    pub(crate) fn age(&self) -> Option<Duration> {
        self.last.map(|last| last.elapsed())
    }
}

/// The robot's clock, by its latest stamp.
#[derive(Clone, Copy, Debug)]
struct Clock {
    stamp_ns: i64,
    at: Instant,
}

/// Where odometry is told, and of what.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct OdometryFrames {
    pub(crate) odom: String,
    pub(crate) base: String,
}

/// What is to be declared of the camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) enum Declared {
    /// Not known yet.
    #[default]
    Waiting,
    /// With what the server is told; none where a camera was not to be declared.
    As(Option<v1::Camera>),
}

/// Where the map has the robot.
#[derive(Clone, Debug)]
pub(crate) struct Placed {
    pub(crate) part: u32,
    pub(crate) robot: Pose,
    pub(crate) map_to_odom: Pose,
    /// When it was told.
    pub(crate) at: Instant,
}

/// Frames, by what became of them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Frames {
    pub(crate) sent: u64,
    pub(crate) answered: u64,
    pub(crate) refused: u64,
    /// They made way for newer ones while the server was away.
    pub(crate) dropped: u64,
    /// They came while no session was wanted.
    pub(crate) unwanted: u64,
    /// Left out, since there are more a second than wanted.
    pub(crate) thinned: u64,
    pub(crate) without_odometry: u64,
    /// Whether the latest is one of these.
    pub(crate) lacks_odometry: bool,
    pub(crate) closures: u64,
    /// When the server last took or answered something while it had something to answer.
    pub(crate) last_heard: Option<Instant>,
    pub(crate) refusal: Option<String>,
}

/// What became of a turn of the plan.
#[derive(Clone, Debug)]
pub(crate) struct Turned {
    pub(crate) turn: u64,
    /// The name of the session that was opened, or of the one that was finished; or why there is none.
    pub(crate) to: Result<String, String>,
}

/// What is known.
#[derive(Default)]
pub(crate) struct State {
    pub(crate) images: Received,
    pub(crate) camera_infos: Received,
    pub(crate) odometry: Received,
    pub(crate) tf_static: Received,
    pub(crate) mountings: Mountings,
    pub(crate) camera_info: Option<CameraInfo>,
    /// Why the camera is declared as it is, if not as wished.
    pub(crate) camera_problem: Option<String>,
    pub(crate) declared: Declared,
    pub(crate) odometry_frames: Option<OdometryFrames>,
    pub(crate) frames: Frames,
    pub(crate) session: Option<String>,
    /// What became of the session that was wanted at the plan's turn, once it is known.
    pub(crate) turned: Option<Turned>,
    pub(crate) placed: Option<Placed>,
    pub(crate) navigation: Option<v1::Guidance>,
    pub(crate) goal_problem: Option<String>,
    clock: Option<Clock>,
    last_tf_ns: i64,
}

/// How long the robot's clock is taken to go on without a stamp. A simulation that is paused, or a robot that is
/// silent, would be overtaken else, and look as if its clock had been set back when it goes on.
const SILENT: Duration = Duration::from_millis(500);

/// A clock that went back by more than this was set anew.
const CLOCK_RESET_NS: i64 = 1_000_000_000;

impl State {
    /// A stamp of the robot that has just come.
    pub(crate) fn tick(&mut self, stamp_ns: i64) {
        self.clock = Some(Clock { stamp_ns, at: Instant::now() });
    }

    /// Now, by the robot's clock, half a second after its latest stamp at most; none before its first.
    pub(crate) fn robot_now_ns(&self) -> Option<i64> {
        self.clock.map(|clock| {
            let since = clock.at.elapsed().min(SILENT);
            clock.stamp_ns.saturating_add(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
        })
    }

    /// A stamp for a transform at a time: stamps rise, unless the robot's clock was set back.
    pub(crate) fn tf_stamp_ns(&mut self, wanted_ns: i64) -> i64 {
        let was_reset = wanted_ns < self.last_tf_ns - CLOCK_RESET_NS;
        self.last_tf_ns = if was_reset { wanted_ns } else { wanted_ns.max(self.last_tf_ns + 1) };
        self.last_tf_ns
    }
}

/// The state, in the hands of all tasks.
#[derive(Clone, Default)]
pub(crate) struct Shared(Arc<Mutex<State>>);

impl Shared {
    pub(crate) fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_of_transforms_rise_unless_the_clock_was_set_back() {
        let mut state = State::default();
        assert_eq!(state.tf_stamp_ns(5_000_000_000), 5_000_000_000);
        assert_eq!(state.tf_stamp_ns(4_900_000_000), 5_000_000_001);
        assert_eq!(state.tf_stamp_ns(1_000_000_000), 1_000_000_000);
    }

    #[test]
    fn the_robots_clock_goes_on_between_its_stamps() {
        let mut state = State::default();
        assert_eq!(state.robot_now_ns(), None);
        state.tick(1_000);
        std::thread::sleep(Duration::from_millis(2));
        assert!(state.robot_now_ns().unwrap() > 2_000_000);
        // For a while: a simulation may have been paused.
        state.clock = state.clock.map(|clock| Clock { at: clock.at - Duration::from_secs(9), ..clock });
        assert_eq!(state.robot_now_ns(), Some(500_001_000));
    }
}
