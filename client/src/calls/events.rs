//! What happens in maps, while it happens.

use tonic::Streaming;
use waypost_proto::v1;

use crate::client::{Client, map_name};
use crate::error::Error;

impl Client {
    /// Watches a map: its frames from log position `from_position` on (0 for all), or those that are
    /// decided from now on, and the robots that navigate in it.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the log has no such position,
    /// UNAVAILABLE if too many watch.
    pub async fn watch_map(&self, map: &str, from_position: Option<u64>) -> Result<MapEvents, Error> {
        let request = v1::WatchRequest { map: map_name(map), from_position };
        let events = self.taken(self.events_client().watch(request).await)?;
        Ok(MapEvents { events, endpoint: self.endpoint().to_owned() })
    }
}

/// What happens in a map, until the server ends it.
#[derive(Debug)]
pub struct MapEvents {
    events: Streaming<v1::MapEvent>,
    endpoint: String,
}

impl MapEvents {
    /// Waits for the next event.
    ///
    /// # Errors
    /// [`Error::Connection`] if the connection broke: watch again from behind the last position.
    /// [`Error::Status`]: NOT_FOUND once the map is deleted, ABORTED when sessions were removed from
    /// it, UNAVAILABLE when the server stops, DATA_LOSS where a frame is damaged on its disk: those behind it are told from
    /// the next position on.
    pub async fn next(&mut self) -> Result<Option<v1::MapEvent>, Error> {
        self.events.message().await.map_err(|status| Error::from_status(&status, &self.endpoint))
    }
}
