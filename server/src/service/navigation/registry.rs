//! Who is being led where: one commander a robot.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use tokio::sync::OwnedSemaphorePermit;
use tokio_util::sync::CancellationToken;

use super::{Guide, Identity, NavigationView};
use crate::error::ServiceError;
use crate::storage::MapId;

/// How long a robot's navigation waits for it to come back.
const KEPT: Duration = Duration::from_secs(60);

/// The robots that are led, or were a moment ago.
#[derive(Debug, Default)]
pub(crate) struct Registry {
    led: Mutex<BTreeMap<(MapId, String), Led>>,
}

#[derive(Debug)]
struct Led {
    guide: Guide,
    /// There for as long as the stream is open.
    room: Weak<OwnedSemaphorePermit>,
    taken_over: CancellationToken,
    /// When it was first seen without a stream.
    alone_since: Option<Instant>,
}

pub(super) struct Opened {
    pub(super) guide: Guide,
    pub(super) resumed: bool,
}

impl Registry {
    /// The same run goes on; another one begins anew, if the robot has no other commander.
    pub(super) fn open(
        &self,
        (map, name): (MapId, &str),
        run: &str,
        (room, taken_over): (&Arc<OwnedSemaphorePermit>, &CancellationToken),
        fresh: impl FnOnce() -> Result<Guide, ServiceError>,
    ) -> Result<Opened, ServiceError> {
        let mut led = self.led();
        let key = (map, name.to_owned());
        let same_run = |before: &Led| !run.is_empty() && before.guide.identity().run == run;
        if let Some(before) = led.get_mut(&key) {
            if same_run(before) {
                before.taken_over.cancel();
                (before.room, before.taken_over) = (Arc::downgrade(room), taken_over.clone());
                before.alone_since = None;
                return Ok(Opened { guide: before.guide.clone(), resumed: true });
            }
            if before.is_open() {
                return Err(ServiceError::precondition(format_args!(
                    "the robot {name} is being led by another stream, and has one commander at a time; end that one, or \
                     give the run_id that it was opened with to go on in its place"
                )));
            }
        }
        let guide = fresh()?;
        let room = Arc::downgrade(room);
        let entry = Led { guide: guide.clone(), room, taken_over: taken_over.clone(), alone_since: None };
        led.insert(key, entry);
        Ok(Opened { guide, resumed: false })
    }

    /// A robot whose stream was not opened after all.
    pub(super) fn forget(&self, (map, name): (MapId, &str), guide: &Guide) {
        let mut led = self.led();
        let key = (map, name.to_owned());
        if led.get(&key).is_some_and(|led| led.guide.is(guide)) {
            led.remove(&key);
        }
    }

    pub(super) fn find(&self, (map, name): (MapId, &str)) -> Option<Guide> {
        self.led().get(&(map, name.to_owned())).map(|led| led.guide.clone())
    }

    /// Whether any robot is led along a map, or was a moment ago.
    pub(in crate::service) fn any_on(&self, map: MapId) -> bool {
        self.led().keys().any(|(of, _)| *of == map)
    }

    /// Whether a robot that is led along a map is connected now.
    pub(in crate::service) fn any_connected_on(&self, map: MapId) -> bool {
        self.led().iter().any(|((of, _), led)| *of == map && led.is_open())
    }

    pub(super) fn of_map(&self, map: MapId) -> Vec<Guide> {
        let led = self.led();
        led.iter().filter(|((of, _), _)| *of == map).map(|(_, led)| led.guide.clone()).collect()
    }

    pub(super) fn all(&self) -> Vec<Guide> {
        self.led().values().map(|led| led.guide.clone()).collect()
    }

    pub(super) fn unused_name(&self, map: MapId) -> String {
        let led = self.led();
        let names = (0_u64..).map(|number| format!("robot-{number}"));
        names.into_iter().find(|name| !led.contains_key(&(map, name.clone()))).unwrap_or_default()
    }

    pub(super) fn view(&self, guide: &Guide) -> NavigationView {
        let Identity { map_id, name, .. } = guide.identity();
        let led = self.led();
        let connected =
            led.get(&(*map_id, name.clone())).is_some_and(|led| led.is_open() && led.guide.is(guide));
        drop(led);
        guide.view(connected)
    }

    /// All but those that have waited for too long.
    fn led(&self) -> MutexGuard<'_, BTreeMap<(MapId, String), Led>> {
        let mut led = self.led.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        led.retain(|_, led| {
            if led.is_open() {
                led.alone_since = None;
                return true;
            }
            now.duration_since(*led.alone_since.get_or_insert(now)) < KEPT
        });
        led
    }
}

impl Led {
    fn is_open(&self) -> bool {
        self.room.strong_count() > 0
    }
}
