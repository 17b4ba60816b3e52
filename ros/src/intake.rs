//! What comes from the robot: images joined with odometry, and its camera.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use futures::StreamExt;
use tokio::sync::{broadcast, watch};
use waypost_bags::live::{self, LiveImage, LivePose};
use waypost_bags::{Frame, Joining, Kind, Pose, Step, Succession};

use crate::camera::{DEFAULT_BASE, Known, Verdict};
use crate::outbox::Outbox;
use crate::plan::Plan;
use crate::raw::Incoming;
use crate::settings::Topics;
use crate::shown::Shown;
use crate::state::{Declared, OdometryFrames, Shared};

/// How often it is looked whether the camera can be declared, besides when something comes.
const DECLARING_PERIOD: Duration = Duration::from_secs(1);
/// The bridge says so when nothing was there after this time.
const QUIET: Duration = Duration::from_secs(10);
/// Images and odometry are of one clock: what one topic shows, the other shows within this time.
const ONE_RESET: Duration = Duration::from_secs(10);
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
    plans: watch::Sender<Plan>,
    shown: Option<Shown>,
    joining: Mutex<Joining>,
    /// When the robot's clock was set back last, and by which topic.
    reset: Mutex<Option<(Instant, String)>>,
    began: Instant,
}

impl Intake {
    pub(crate) fn new(
        shared: Shared,
        topics: Topics,
        most_hz: f64,
        outbox: Arc<Outbox>,
        declared: watch::Sender<Declared>,
        plans: watch::Sender<Plan>,
        shown: Option<Shown>,
    ) -> Self {
        let mut joining = Joining::default();
        if topics.odometry.is_none() {
            joining.end();
        }
        let (wheels, _) = broadcast::channel(DRIVING_AHEAD);
        let (seen, _) = broadcast::channel(DRIVING_AHEAD);
        let (joining, reset) = (Mutex::new(joining), Mutex::default());
        let began = Instant::now();
        Self { shared, topics, most_hz, outbox, declared, wheels, seen, plans, shown, joining, reset, began }
    }

    /// Images, until the topic ends.
    pub(crate) async fn images(self: Arc<Self>, mut messages: Incoming) {
        let kind = self.topics.image_kind;
        let mut taking = Taking { least_ns: least_ns(self.most_hz), number: 0, last_ns: i64::MIN };
        let mut stamps = Stamps::default();
        while let Some(data) = messages.next().await {
            // Raw pixels become a PNG, which is work.
            let read = match kind {
                Kind::Image => tokio::task::spawn_blocking(move || live::image(kind, &data)).await,
                _ => Ok(live::image(kind, &data)),
            };
            match read {
                Ok(Ok(image)) => self.image(&mut taking, &mut stamps, image),
                Ok(Err(problem)) => self.bad_image(problem.to_string()),
                Err(_ended) => return,
            }
        }
    }

    fn image(&self, taking: &mut Taking, stamps: &mut Stamps<LiveImage>, image: LiveImage) {
        let (stamp_ns, left_out) = (image.stamp_ns, stamps.left_out());
        match stamps.push(stamp_ns, image) {
            Step::Follows(image) => self.take(taking, image),
            Step::Held | Step::Repeats => {}
            Step::GoOn(images) => images.into_iter().for_each(|(_, image)| self.take(taking, image)),
            // The session that is open takes none of them: their stamps are below those that it has.
            Step::InPlaceOfLast(_) | Step::InPlaceOfAll(_) | Step::Anew(_) => {
                taking.last_ns = i64::MIN;
                self.clock_was_set_back(&self.topics.image);
            }
        }
        for _ in left_out..stamps.left_out() {
            self.bad_image(format!("its stamp does not follow those around it; the latest is {stamp_ns}"));
        }
    }

    fn take(&self, taking: &mut Taking, image: LiveImage) {
        if !taking.take(image.stamp_ns) {
            let mut state = self.shared.lock();
            state.images.good();
            state.frames.thinned += 1;
            return;
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

    /// A new session begins, also for odometry: where the robot was says nothing of where it is.
    fn clock_was_set_back(&self, topic: &str) {
        let mut reset = self.reset.lock().unwrap_or_else(PoisonError::into_inner);
        if reset.as_ref().is_some_and(|(at, by)| by != topic && at.elapsed() < ONE_RESET) {
            return;
        }
        *reset = Some((Instant::now(), topic.to_owned()));
        tracing::warn!(
            "the robot's clock was set back, by the stamps of {topic}: a new session begins, and a goal has to be given again"
        );
        self.plans.send_modify(Plan::clock_was_set_back);
        self.shared.lock().placed = None;
    }

    fn bad_image(&self, problem: String) {
        let line = format!("{}: an image is left out: {problem}", self.topics.image);
        if self.shared.lock().images.bad(problem) {
            tracing::warn!("{line}; more of the same are counted in the diagnostics");
        }
    }

    /// Odometry, until the topic ends.
    pub(crate) async fn odometry(self: Arc<Self>, mut messages: Incoming) {
        let mut stamps = Stamps::default();
        while let Some(data) = messages.next().await {
            match live::pose(Kind::Odometry, &data) {
                Ok(read) if read.stamp_ns > 0 => self.pose(&mut stamps, &read, &data),
                Ok(_) => self.bad_odometry("its header has no stamp above 0".to_owned()),
                Err(problem) => self.bad_odometry(problem.to_string()),
            }
        }
    }

    fn pose(&self, stamps: &mut Stamps<Pose>, read: &LivePose, data: &[u8]) {
        let base = if read.child_frame.is_empty() { DEFAULT_BASE } else { &read.child_frame };
        {
            let mut state = self.shared.lock();
            state.odometry.good();
            if state.odometry_frames.is_none() {
                let (odom, base) = (read.frame_id.clone(), base.to_owned());
                state.odometry_frames = Some(OdometryFrames { odom, base });
            }
        }
        let &LivePose { stamp_ns, pose, .. } = read;
        let left_out = stamps.left_out();
        match stamps.push(stamp_ns, pose) {
            Step::Follows(pose) => self.moved(stamp_ns, pose),
            Step::Held | Step::Repeats => {}
            Step::GoOn(poses) => poses.into_iter().for_each(|(stamp_ns, pose)| self.moved(stamp_ns, pose)),
            Step::InPlaceOfLast(_) | Step::InPlaceOfAll(_) | Step::Anew(_) => {
                self.shared.lock().tick(stamp_ns);
                if let Some(topic) = &self.topics.odometry {
                    self.clock_was_set_back(topic);
                }
            }
        }
        for _ in left_out..stamps.left_out() {
            self.bad_odometry(format!("a stamp does not follow those around it; the latest is {stamp_ns}"));
        }
        if let Some(shown) = &self.shown {
            shown.odometry(data, read, base);
        }
        // That one decides for itself which stamps follow.
        self.join(|joining, now_ns| joining.add_pose(now_ns, stamp_ns, pose));
    }

    /// The robot was there at that time.
    fn moved(&self, stamp_ns: i64, pose: Pose) {
        self.shared.lock().tick(stamp_ns);
        // Without anybody who drives, nobody listens.
        let _ = self.wheels.send(Wheels { stamp_ns, pose });
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
            if self.topics.odometry.is_some() {
                let mut state = self.shared.lock();
                state.frames.without_odometry = joining.lacks().all();
                state.frames.lacks_odometry = frame.pose.is_none();
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
            tf_static: &self.topics.tf_static,
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

/// Which stamps of a topic follow each other, beside the time that passes here.
struct Stamps<T> {
    order: Succession<T>,
    last_came: Option<Instant>,
}

impl<T> Default for Stamps<T> {
    fn default() -> Self {
        Self { order: Succession::default(), last_came: None }
    }
}

impl<T> Stamps<T> {
    fn push(&mut self, stamp_ns: i64, item: T) -> Step<T> {
        let passed = self.last_came.replace(Instant::now()).map_or(Duration::ZERO, |last| last.elapsed());
        self.order.push_after(i64::try_from(passed.as_nanos()).unwrap_or(i64::MAX), stamp_ns, item)
    }

    fn left_out(&self) -> u64 {
        self.order.astray().left_out
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

impl Taking {
    /// Whether an image with that stamp is wanted. Stamps rise.
    fn take(&mut self, stamp_ns: i64) -> bool {
        let is_wanted = stamp_ns.saturating_sub(self.last_ns) >= self.least_ns;
        if is_wanted {
            self.last_ns = stamp_ns;
            self.number += 1;
        }
        is_wanted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_thinned_by_their_stamps() {
        let mut taking = Taking { least_ns: least_ns(10.0), number: 0, last_ns: i64::MIN };
        let taken = [1_000_000_000, 1_033_000_000, 1_095_000_000].map(|stamp_ns| taking.take(stamp_ns));
        assert_eq!((taken, taking.number), ([true, false, true], 2));
        let mut all = Taking { least_ns: least_ns(0.0), number: 0, last_ns: i64::MIN };
        assert_eq!([all.take(1), all.take(2)], [true, true]);
    }
}
