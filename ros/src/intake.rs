//! What comes from the robot: images joined with odometry, and its camera.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use futures::StreamExt;
use tokio::sync::{broadcast, watch};
use waypost_bags::live::{self, LiveImage};
use waypost_bags::{Frame, Joining, Kind, Pose};

use crate::camera::{DEFAULT_BASE, Known, Verdict};
use crate::outbox::Outbox;
use crate::raw::Incoming;
use crate::settings::Topics;
use crate::shown::Shown;
use crate::state::{Declared, OdometryFrames, Shared};

/// How often it is looked whether the camera can be declared, besides when something comes.
const DECLARING_PERIOD: Duration = Duration::from_secs(1);
/// The bridge says so when nothing was there after this time.
const QUIET: Duration = Duration::from_secs(10);
/// Rates are met although stamps jitter.
const THINNING_SLACK: f64 = 0.9;
/// Readings and frames that wait for the one who drives; old ones are of no use to it.
pub(crate) const DRIVING_AHEAD: usize = 16;

/// A pose by the wheels, for the one who drives.
#[derive(Clone, Debug)]
pub(crate) struct Wheels {
    pub(crate) stamp_ns: i64,
    pub(crate) pose: Pose,
}

/// Takes what comes from the robot.
pub(crate) struct Intake {
    pub(crate) shared: Shared,
    pub(crate) topics: Topics,
    pub(crate) most_hz: f64,
    pub(crate) outbox: Arc<Outbox>,
    pub(crate) declared: watch::Sender<Declared>,
    pub(crate) wheels: broadcast::Sender<Wheels>,
    pub(crate) seen: broadcast::Sender<Frame>,
    shown: Option<Shown>,
    joining: Mutex<Joining>,
    began: Instant,
}

impl Intake {
    pub(crate) fn new(
        shared: Shared,
        topics: Topics,
        most_hz: f64,
        outbox: Arc<Outbox>,
        declared: watch::Sender<Declared>,
        shown: Option<Shown>,
    ) -> Self {
        let mut joining = Joining::default();
        if topics.odometry.is_none() {
            joining.end();
        }
        let (wheels, _) = broadcast::channel(DRIVING_AHEAD);
        let (seen, _) = broadcast::channel(DRIVING_AHEAD);
        let joining = Mutex::new(joining);
        let began = Instant::now();
        Self { shared, topics, most_hz, outbox, declared, wheels, seen, shown, joining, began }
    }

    /// Images, until the topic ends.
    pub(crate) async fn images(self: Arc<Self>, mut messages: Incoming) {
        let kind = self.topics.image_kind;
        let mut taking = Taking { least_ns: least_ns(self.most_hz), number: 0, last_ns: i64::MIN };
        while let Some(data) = messages.next().await {
            // Raw pixels become a PNG, which is work.
            let read = match kind {
                Kind::Image => tokio::task::spawn_blocking(move || live::image(kind, &data)).await,
                _ => Ok(live::image(kind, &data)),
            };
            match read {
                Ok(Ok(image)) => self.image(&mut taking, image),
                Ok(Err(problem)) => self.bad_image(problem.to_string()),
                Err(_ended) => return,
            }
        }
    }

    fn image(&self, taking: &mut Taking, image: LiveImage) {
        match taking.take(image.stamp_ns) {
            Taken::Yes => {}
            Taken::TooSoon => {
                let mut state = self.shared.lock();
                state.images.good();
                state.frames.thinned += 1;
                return;
            }
            Taken::NotRising { before_ns } => {
                let stamp_ns = image.stamp_ns;
                return self.bad_image(format!(
                    "its stamp {stamp_ns} is not above the {before_ns} of one before; after a clock was set back, \
                     start the bridge again"
                ));
            }
        }
        {
            let mut state = self.shared.lock();
            state.images.good();
            if self.topics.odometry.is_none() {
                state.tick(image.stamp_ns);
            }
        }
        if let Some(shown) = &self.shown {
            shown.image(&image);
        }
        let frame = Frame { number: taking.number, stamp_ns: image.stamp_ns, image: image.file, pose: None };
        self.join(|joining, now_ns| joining.add_image(now_ns, frame));
    }

    fn bad_image(&self, problem: String) {
        let line = format!("{}: an image is left out: {problem}", self.topics.image);
        if self.shared.lock().images.bad(problem) {
            tracing::warn!("{line}; more of the same are counted in the diagnostics");
        }
    }

    /// Odometry, until the topic ends.
    pub(crate) async fn odometry(self: Arc<Self>, mut messages: Incoming) {
        while let Some(data) = messages.next().await {
            let read = match live::pose(Kind::Odometry, &data) {
                Ok(read) if read.stamp_ns > 0 => read,
                Ok(_) => {
                    self.bad_odometry("its header has no stamp above 0".to_owned());
                    continue;
                }
                Err(problem) => {
                    self.bad_odometry(problem.to_string());
                    continue;
                }
            };
            let base = if read.child_frame.is_empty() { DEFAULT_BASE } else { &read.child_frame };
            {
                let mut state = self.shared.lock();
                state.odometry.good();
                state.tick(read.stamp_ns);
                if state.odometry_frames.is_none() {
                    let (odom, base) = (read.frame_id.clone(), base.to_owned());
                    state.odometry_frames = Some(OdometryFrames { odom, base });
                }
            }
            if let Some(shown) = &self.shown {
                shown.odometry(&data, &read, base);
            }
            // Without anybody who drives, nobody listens.
            let _ = self.wheels.send(Wheels { stamp_ns: read.stamp_ns, pose: read.pose });
            self.join(|joining, now_ns| joining.add_pose(now_ns, read.stamp_ns, read.pose));
        }
    }

    fn bad_odometry(&self, problem: String) {
        let line = format!("odometry is left out: {problem}");
        if self.shared.lock().odometry.bad(problem) {
            tracing::warn!("{line}; more of the same is counted in the diagnostics");
        }
    }

    /// Adds to what waits for its match, and hands out what has it.
    fn join(&self, add: impl FnOnce(&mut Joining, i64)) {
        let now_ns = i64::try_from(self.began.elapsed().as_nanos()).unwrap_or(i64::MAX);
        let mut joining = self.joining.lock().unwrap_or_else(PoisonError::into_inner);
        add(&mut joining, now_ns);
        while let Some(frame) = joining.next() {
            if frame.pose.is_none() && self.topics.odometry.is_some() {
                self.shared.lock().frames.without_odometry += 1;
            }
            if self.seen.receiver_count() > 0 {
                let _ = self.seen.send(frame.clone());
            }
            if !self.outbox.is_open() {
                self.shared.lock().frames.unwanted += 1;
                continue;
            }
            let dropped = self.outbox.put(frame);
            self.shared.lock().frames.dropped += dropped;
        }
    }

    /// Camera infos, until the topic ends.
    pub(crate) async fn camera_infos(self: Arc<Self>, mut messages: Incoming) {
        while let Some(data) = messages.next().await {
            let read = live::camera_info(&data);
            if let (Some(shown), Ok(_)) = (&self.shown, &read) {
                shown.camera_info(&data);
            }
            let mut state = self.shared.lock();
            match read {
                Ok(info) => {
                    state.camera_infos.good();
                    // One that cannot be declared may be followed by one that can.
                    if state.declared == Declared::Waiting {
                        state.camera_info = Some(info);
                    }
                }
                Err(problem) => {
                    state.camera_infos.bad(problem.to_string());
                }
            }
        }
    }

    /// Transforms that never change, until the topic ends.
    pub(crate) async fn mountings(self: Arc<Self>, mut messages: Incoming) {
        while let Some(data) = messages.next().await {
            let mut state = self.shared.lock();
            let added = state.mountings.add(&data);
            match added {
                Ok(()) => state.tf_static.good(),
                Err(problem) => {
                    state.tf_static.bad(problem.to_string());
                    continue;
                }
            }
            drop(state);
            if let Some(shown) = &self.shown {
                shown.mountings(&data);
            }
        }
    }

    /// Declares the camera as soon as enough is known of it, and says what is missing.
    pub(crate) async fn declare(self: Arc<Self>) {
        let Some(topic) = self.topics.camera_info.clone() else {
            self.declare_as(Declared::As(None), None);
            return;
        };
        let mut since = None;
        let mut told = None;
        loop {
            tokio::time::sleep(DECLARING_PERIOD / 10).await;
            let verdict = self.verdict(&mut since);
            let problem = match verdict {
                Some(Verdict::Whole(camera)) => return self.declare_as(Declared::As(Some(camera)), None),
                Some(Verdict::Unmounted(camera, why)) => {
                    return self.declare_as(Declared::As(Some(camera)), Some(why.to_string()));
                }
                Some(Verdict::Waiting) => None,
                Some(Verdict::Undeclarable(why)) => Some(format!(
                    "no frame is sent: the camera of {topic} cannot be declared: {why}; or set camera_info_topic to none"
                )),
                None if self.began.elapsed() > QUIET => Some(format!(
                    "no frame is sent: nothing came on {topic}; publish it, name another by camera_info_topic, or set that to \
                     none for a camera that is not declared"
                )),
                None => None,
            };
            if problem.is_some() && problem != told {
                tracing::error!("{}", problem.as_deref().unwrap_or_default());
                told.clone_from(&problem);
            }
            self.shared.lock().camera_problem = problem;
        }
    }

    fn verdict(&self, since: &mut Option<Instant>) -> Option<Verdict> {
        let state = self.shared.lock();
        let info = state.camera_info.as_ref()?;
        let base = state.odometry_frames.as_ref().map(|frames| frames.base.as_str());
        let known = Known {
            image_topic: &self.topics.image,
            info,
            mountings: &state.mountings,
            base,
            since: *since.get_or_insert_with(Instant::now),
        };
        Some(known.verdict())
    }

    fn declare_as(&self, declared: Declared, problem: Option<String>) {
        if let Some(problem) = &problem {
            tracing::warn!("{problem}");
        }
        let mut state = self.shared.lock();
        state.camera_problem = problem;
        state.declared = declared.clone();
        drop(state);
        self.declared.send_replace(declared);
    }
}

fn least_ns(most_hz: f64) -> i64 {
    // Rounded down to nothing where every frame is wanted.
    if most_hz > 0.0 { (THINNING_SLACK * 1e9 / most_hz) as i64 } else { 0 }
}

/// Which images are taken.
struct Taking {
    least_ns: i64,
    /// Of the latest that was taken.
    number: u64,
    last_ns: i64,
}

#[derive(Debug, PartialEq, Eq)]
enum Taken {
    Yes,
    TooSoon,
    NotRising { before_ns: i64 },
}

impl Taking {
    fn take(&mut self, stamp_ns: i64) -> Taken {
        if stamp_ns <= self.last_ns {
            return Taken::NotRising { before_ns: self.last_ns };
        }
        if stamp_ns.saturating_sub(self.last_ns) < self.least_ns {
            return Taken::TooSoon;
        }
        self.last_ns = stamp_ns;
        self.number += 1;
        Taken::Yes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_thinned_by_their_stamps_and_have_to_rise() {
        let mut taking = Taking { least_ns: least_ns(10.0), number: 0, last_ns: i64::MIN };
        assert_eq!(taking.take(1_000_000_000), Taken::Yes);
        assert_eq!(taking.take(1_033_000_000), Taken::TooSoon);
        assert_eq!(taking.take(1_095_000_000), Taken::Yes);
        assert_eq!(taking.take(1_095_000_000), Taken::NotRising { before_ns: 1_095_000_000 });
        assert_eq!(taking.number, 2);
        let mut all = Taking { least_ns: least_ns(0.0), number: 0, last_ns: i64::MIN };
        assert_eq!([all.take(1), all.take(2)], [Taken::Yes, Taken::Yes]);
    }
}
