//! map -> odom at a steady rate, whatever the server does.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::bus::Outgoing;
use crate::state::Shared;
use waypost_ros_messages::{Header, TransformStamped, Transforms};

/// 20 Hz.
const PERIOD: Duration = Duration::from_millis(50);
/// Transforms are dated ahead, so that a reader may ask for the present between two of them.
const AHEAD_NS: i64 = 100_000_000;

/// Publishes the transform on a thread of its own, which no decoding of images delays.
pub(crate) struct TfThread {
    ends: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl TfThread {
    pub(crate) fn start(
        shared: Shared,
        tf: Outgoing<Transforms>,
        map_frame: String,
    ) -> std::io::Result<Self> {
        let ends = Arc::new(AtomicBool::new(false));
        let thread = std::thread::Builder::new().name("tf".to_owned()).spawn({
            let ends = ends.clone();
            move || publish(&shared, &tf, &map_frame, &ends)
        })?;
        Ok(Self { ends, thread })
    }

    /// True if it died, which it never should.
    pub(crate) fn is_over(&self) -> bool {
        self.thread.is_finished()
    }

    pub(crate) fn stop(self) {
        self.ends.store(true, Ordering::Relaxed);
        // It has told of its own panic.
        let _ = self.thread.join();
    }
}

fn publish(shared: &Shared, tf: &Outgoing<Transforms>, map_frame: &str, ends: &AtomicBool) {
    let mut due = Instant::now();
    while !ends.load(Ordering::Relaxed) {
        if let Some(transform) = transform(shared, map_frame) {
            tf.publish(Transforms { transforms: vec![transform] });
        }
        due = next_due(due, Instant::now());
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
}

/// A period later; after a time in which the machine slept, from now on.
fn next_due(due: Instant, now: Instant) -> Instant {
    let next = due + PERIOD;
    if now > next { now } else { next }
}

/// None while it is not known where the robot is, or by what odometry.
fn transform(shared: &Shared, map_frame: &str) -> Option<TransformStamped> {
    let mut state = shared.lock();
    let now_ns = state.robot_now_ns()?;
    let child_frame_id = state.odometry_frames.as_ref()?.odom.clone();
    let transform = state.placed.as_ref()?.map_to_odom;
    let stamp_ns = state.tf_stamp_ns(now_ns.saturating_add(AHEAD_NS));
    Some(TransformStamped { header: Header::new(stamp_ns, map_frame), child_frame_id, transform })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{OdometryFrames, Placed};
    use waypost_ros_messages::Pose;

    #[test]
    fn nothing_is_told_before_the_map_has_the_robot() {
        let shared = Shared::default();
        shared.lock().tick(1_000_000_000);
        let frames = OdometryFrames { odom: "odom".to_owned(), base: "base_link".to_owned() };
        shared.lock().odometry_frames = Some(frames);
        assert!(transform(&shared, "map").is_none());
        let pose = Pose::ORIGIN;
        let placed = Placed { part: 0, robot: pose, map_to_odom: pose, at: Instant::now() };
        shared.lock().placed = Some(placed);
        let told = transform(&shared, "map").unwrap();
        assert_eq!((told.header.frame_id.as_str(), told.child_frame_id.as_str()), ("map", "odom"));
    }

    #[test]
    fn after_a_pause_the_rate_goes_on_without_catching_up() {
        let due = Instant::now();
        assert_eq!(next_due(due, due), due + PERIOD);
        let late = due + 10 * PERIOD;
        assert_eq!(next_due(due, late), late);
    }
}
