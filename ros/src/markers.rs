//! A map as markers, published whenever it has grown.

use std::time::{Duration, Instant};

use tokio::sync::watch;
use waypost_client::{Client, Error};
use waypost_ros_messages::{DrawnMap, Header, MarkerArray};

use crate::bus::Outgoing;
use crate::plan::Plan;
use crate::state::Shared;

/// At most this often; and a map that is fetched slowly is fetched seldom.
const PERIOD: Duration = Duration::from_secs(2);
const PAUSE_PER_FETCH: u32 = 20;
/// Also a map that this robot does not change may change.
const ANYWAY: Duration = Duration::from_secs(30);

/// Publishes a map as markers whenever it has grown.
pub(crate) struct Markers {
    pub(crate) client: Client,
    pub(crate) plans: watch::Receiver<Plan>,
    pub(crate) map_frame: String,
    pub(crate) shared: Shared,
    pub(crate) out: Outgoing<MarkerArray>,
}

impl Markers {
    pub(crate) async fn run(self) {
        let mut told: Option<(Instant, u64, u32, String)> = None;
        let mut pause = PERIOD;
        loop {
            tokio::time::sleep(pause).await;
            let Some(map) = self.plans.borrow().map.clone() else { continue };
            let (answered, part) = self.known();
            let is_due = told.as_ref().is_none_or(|(at, told_answered, told_part, told_map)| {
                (*told_answered, *told_part, told_map) != (answered, part, &map) || at.elapsed() > ANYWAY
            });
            if !is_due {
                continue;
            }
            let began = Instant::now();
            match self.fetch(&map, part).await {
                Ok(markers) => {
                    self.out.publish(markers);
                    told = Some((began, answered, part, map));
                }
                // The session tells of a server that is away.
                Err(error) => tracing::debug!("no markers: {error}"),
            }
            pause = PERIOD.max(began.elapsed() * PAUSE_PER_FETCH);
        }
    }

    /// Answers so far, and the part of the map that the robot is in.
    fn known(&self) -> (u64, u32) {
        let state = self.shared.lock();
        (state.frames.answered, state.placed.as_ref().map_or(0, |placed| placed.part))
    }

    async fn fetch(&self, map: &str, part: u32) -> Result<MarkerArray, Error> {
        let places = self.client.places(map).await?;
        let labels = self.client.labels(map).await?;
        let closures = self.client.loop_closures(map).await?;
        let stamp_ns = self.shared.lock().robot_now_ns().unwrap_or(0);
        Ok(MarkerArray::of_map(
            &Header::new(stamp_ns, &self.map_frame),
            &DrawnMap { part, places, labels, closures },
        ))
    }
}
