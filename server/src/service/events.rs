//! What happens in maps, told to those who watch. Frames are read from the log, so that whoever is slow misses none and
//! takes no more memory than a page of them; robots that are led are looked at a few times a second.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::stream::{self, BoxStream, StreamExt};
use posegraph::{PlanarPose, Pose};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio_util::sync::CancellationToken;
use topomap::mapper::MapPose;
use waypost_navigation::metric::Status;

use super::frames::{FrameView, Frames};
use super::navigation::{Goal, GoalRefusal, Navigation, NavigationView, Told};
use crate::error::ServiceError;
use crate::names::map_in;
use crate::open_map::answers::{FrameAnswer, PlacePose};
use crate::storage::{FrameRow, MapRow};

/// Those who may watch at a time: each holds a page of frames.
const MOST_WATCHES: usize = 100;

/// When to ask again for room.
const RETRY: Duration = Duration::from_secs(5);

/// Frames that are read at a time.
const PAGE: u32 = 64;

/// How often robots are looked at while there are some.
const LED_POLL: Duration = Duration::from_millis(250);

/// How often a map without robots is looked at.
const IDLE_POLL: Duration = Duration::from_secs(2);

/// A robot whose state stays is told of so often while it reports.
const TOLD_AGAIN: Duration = Duration::from_secs(1);

/// Something that happened in a map.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum MapEventView {
    /// The watch goes on from here; always the first.
    Started { next_position: u64, log: String },
    /// A frame was decided; `position` is its own in the log.
    Frame { position: u64, frame: Box<FrameView> },
    /// A robot that is led, without its route.
    Navigation(Box<NavigationView>),
}

/// Tells what happens in maps. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Events {
    frames: Frames,
    navigation: Navigation,
    room: Arc<Semaphore>,
    stopping: CancellationToken,
}

impl Events {
    pub(super) fn new(frames: Frames, navigation: Navigation, stopping: CancellationToken) -> Self {
        Self { frames, navigation, room: Arc::new(Semaphore::new(MOST_WATCHES)), stopping }
    }

    /// What happens in a map from log position `from` on, or from now on. Refused if the map has another log than `log`,
    /// unless that is empty. Ends with an error.
    pub(crate) async fn watch(
        &self,
        name: &str,
        from: Option<u64>,
        log: &str,
    ) -> Result<BoxStream<'static, Result<MapEventView, ServiceError>>, ServiceError> {
        let map = map_in(name)?;
        let room = self.room.clone().try_acquire_owned().map_err(|_| ServiceError::Unavailable {
            message: format!(
                "{MOST_WATCHES} watches of maps are open, and there is no room for more; end some, or ask again"
            ),
            retry_after: Some(RETRY),
        })?;
        let row = self.frames.open_maps.row(map).await?;
        if !log.is_empty() && log != log_of(&row) {
            return Err(other_log(map));
        }
        let words = self.frames.vocabulary_len(&row).await?;
        // Before the end of the log is read, so that nothing comes between.
        let commits = self.frames.storage.commits_of(row.id);
        let events = self.frames.storage.log_events(row.id).await?;
        let next = from.unwrap_or(events);
        if next > events {
            return Err(ServiceError::precondition(format_args!(
                "the log of the map {map} has {events} events, so there is no position {next} to go on from: it is another \
                 map, or sessions were removed from it; watch from 0, or from now on"
            )));
        }
        let started = MapEventView::Started { next_position: next, log: log_of(&row) };
        let watch = Watch {
            events: self.clone(),
            row,
            words,
            next,
            commits,
            ready: VecDeque::from([started]),
            told: BTreeMap::new(),
            looked: None,
            _room: room,
        };
        let next = async |watch: Option<Watch>| {
            let mut watch = watch?;
            Some(match watch.next().await {
                Ok(event) => (Ok(event), Some(watch)),
                Err(error) => (Err(error), None),
            })
        };
        Ok(stream::unfold(Some(watch), next).boxed())
    }
}

/// Names the log of a map as it is now: when the map was made tells it from any other of its name, and each removal of
/// sessions begins another edition.
fn log_of(row: &MapRow) -> String {
    format!("{:x}.{:x}", row.created_ns, row.edition)
}

fn other_log(map: &str) -> ServiceError {
    ServiceError::Aborted {
        message: format!(
            "sessions were removed from the map {map}, or it was made anew, so that positions in its log mean something \
             else; watch it again"
        ),
    }
}

/// What one watcher has been told, and what comes next.
struct Watch {
    events: Events,
    row: MapRow,
    /// Of the map's vocabulary.
    words: usize,
    /// The log position to go on from.
    next: u64,
    commits: watch::Receiver<()>,
    ready: VecDeque<MapEventView>,
    /// Of the robots that are led, by name.
    told: BTreeMap<String, ToldOf>,
    /// When they were looked at last.
    looked: Option<Instant>,
    _room: OwnedSemaphorePermit,
}

/// What was told of a robot.
struct ToldOf {
    state: State,
    stamp_ns: i64,
    at: Instant,
}

/// What of a robot is told at once when it changes.
#[derive(Clone, Debug, PartialEq)]
struct State {
    connected: bool,
    status: Option<Status>,
    detail: Option<String>,
    goal: Option<Goal>,
    refusal: Option<GoalRefusal>,
}

impl State {
    fn of(view: &NavigationView) -> Self {
        let told = view.guidance.as_ref();
        Self {
            connected: view.connected,
            status: told.map(|told| told.guidance.status),
            detail: told.and_then(Told::detail),
            goal: view.goal.clone(),
            refusal: view.goal_refusal.clone(),
        }
    }
}

impl Watch {
    async fn next(&mut self) -> Result<MapEventView, ServiceError> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Ok(event);
            }
            self.look_at_robots();
            self.commits.borrow_and_update();
            self.read_frames().await?;
            if self.ready.is_empty() {
                self.wait().await?;
            }
        }
    }

    /// Until something may have happened, if the map is still the same.
    async fn wait(&mut self) -> Result<(), ServiceError> {
        let pause = if self.told.is_empty() { IDLE_POLL } else { LED_POLL };
        tokio::select! {
            () = self.events.stopping.cancelled() => return Err(ServiceError::stopping()),
            // Its sender lives as long as somebody listens.
            _ = self.commits.changed() => {}
            () = tokio::time::sleep(pause) => {}
        }
        let now = self.events.frames.open_maps.row(&self.row.name).await?;
        if now.edition() == self.row.edition() {
            return Ok(());
        }
        Err(other_log(&self.row.name))
    }

    async fn read_frames(&mut self) -> Result<(), ServiceError> {
        let frames = &self.events.frames;
        let rows = frames.storage.frames_from(self.row.id, self.next, PAGE, self.words).await?;
        let Some(last) = rows.last() else { return Ok(()) };
        let next = last.event.frame + 1;
        let positions: Vec<u64> = rows.iter().map(|row| row.event.frame).collect();
        let poses = self.poses_of(&rows).await;
        let views = frames.frame_views(&self.row, rows).await?;
        self.next = next;
        self.ready.extend(positions.into_iter().zip(views).zip(poses).map(|((position, view), map_pose)| {
            let map_pose = map_pose.filter(|_| !view.is_withdrawn());
            let answer = FrameAnswer { map_pose, ..view.answer };
            MapEventView::Frame { position, frame: Box::new(FrameView { answer, ..view }) }
        }));
        Ok(())
    }

    /// Where the map puts the robot at each frame; nowhere if it cannot be asked just now.
    async fn poses_of(&self, rows: &[FrameRow]) -> Vec<Option<MapPose>> {
        let at = |row: &FrameRow| row.event.decision.place.filter(|_| row.event.at.is_some());
        let places: Vec<_> = rows.iter().filter_map(at).collect();
        if places.is_empty() {
            return vec![None; rows.len()];
        }
        let found = match self.events.frames.open_maps.open_of(&self.row).await {
            Ok(map) => map.place_poses(places).await.unwrap_or_default(),
            Err(_) => Vec::new(),
        };
        let mut found = found.into_iter();
        rows.iter()
            .map(|row| at(row).and_then(|_| found.next().flatten()).and_then(|at| pose(row, at)))
            .collect()
    }

    fn look_at_robots(&mut self) {
        let now = Instant::now();
        if self.looked.is_some_and(|looked| now.duration_since(looked) < LED_POLL) {
            return;
        }
        self.looked = Some(now);
        let led = self.events.navigation.led_on(self.row.id);
        self.told.retain(|name, _| led.iter().any(|view| view.name == *name));
        for view in led {
            let state = State::of(&view);
            let stamp_ns = view.guidance.as_ref().map_or(0, |told| told.stamp_ns);
            let is_news = match self.told.get(&view.name) {
                None => true,
                Some(told) => {
                    told.state != state
                        || told.stamp_ns != stamp_ns && now.duration_since(told.at) >= TOLD_AGAIN
                }
            };
            if is_news {
                self.told.insert(view.name.clone(), ToldOf { state, stamp_ns, at: now });
                self.ready
                    .push_back(MapEventView::Navigation(Box::new(NavigationView { route: None, ..view })));
            }
        }
    }
}

/// Where a robot was in its place's frame, on the map.
fn pose(row: &FrameRow, PlacePose { part, pose }: PlacePose) -> Option<MapPose> {
    let robot = pose.compose(row.event.at.as_ref()?.pose());
    let by_wheels = PlanarPose::seen_from_above(row.event.odometry.as_ref()?.pose());
    Some(MapPose { part, robot, odom: robot.compose(&by_wheels.inverse()) })
}
