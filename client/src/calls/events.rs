//! What happens in maps, while it happens.

use tokio::time::{Instant, sleep};
use tonic::Streaming;
use waypost_proto::v1;
use waypost_proto::v1::map_event::Event;

use crate::client::{Client, map_name};
use crate::error::Error;
use crate::reconnection::{Backoff, LinkEnd, Reconnection};

impl Client {
    /// Watches a map: its frames from log position `from_position` on (0 for all), or those that are
    /// decided from now on, and the robots that navigate in it.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the log has no such position,
    /// UNAVAILABLE if too many watch.
    pub async fn watch_map(&self, map: &str, from_position: Option<u64>) -> Result<MapEvents, Error> {
        let mut events = MapEvents {
            client: self.clone(),
            map: map_name(map),
            next_position: from_position,
            open: None,
            backoff: Backoff::new(Reconnection::default()),
        };
        events.open = Some(events.connect().await?);
        Ok(events)
    }
}

/// What happens in a map, until the server ends it. When the connection breaks, the watch goes on
/// over another one from where it was: no frame is missed, and none told twice.
#[derive(Debug)]
pub struct MapEvents {
    client: Client,
    map: String,
    /// To go on from; `None` while nobody has said where the log ends.
    next_position: Option<u64>,
    /// `None` while it is broken.
    open: Option<Streaming<v1::MapEvent>>,
    backoff: Backoff,
}

impl MapEvents {
    /// Reconnects by other delays than the default.
    #[must_use]
    pub fn with_reconnection(self, reconnection: Reconnection) -> Self {
        Self { backoff: Backoff::new(reconnection), ..self }
    }

    /// Waits for the next event.
    ///
    /// # Errors
    /// [`Error::Connection`] if the server was away for longer than [`Reconnection::give_up_after`].
    /// [`Error::Status`]: NOT_FOUND once the map is deleted, ABORTED when sessions were removed from
    /// it, DATA_LOSS where a frame is damaged on its disk: those behind it are told from the next position on.
    pub async fn next(&mut self) -> Result<v1::MapEvent, Error> {
        loop {
            let end = match &mut self.open {
                Some(events) => match events.message().await {
                    Ok(Some(event)) => {
                        self.backoff.progress();
                        match &event.event {
                            Some(Event::Started(started)) => {
                                self.next_position = Some(started.next_position);
                                continue;
                            }
                            Some(Event::Frame(frame)) => self.next_position = Some(frame.position + 1),
                            Some(Event::Navigation(_)) | None => {}
                        }
                        return Ok(event);
                    }
                    Ok(None) => LinkEnd::closed(),
                    Err(status) => LinkEnd::of(&status),
                },
                None => match self.connect().await {
                    Ok(events) => {
                        self.open = Some(events);
                        continue;
                    }
                    Err(Error::Connection { reason, .. }) => LinkEnd::Broken(reason),
                    Err(Error::Status { code: tonic::Code::Unavailable, message }) => {
                        LinkEnd::Broken(message)
                    }
                    Err(error) => LinkEnd::Final(error),
                },
            };
            self.open = None;
            match end {
                LinkEnd::Final(error) => return Err(error),
                LinkEnd::Broken(reason) => match self.backoff.next_delay(Instant::now()) {
                    Some(delay) => sleep(delay).await,
                    None => {
                        return Err(Error::Connection {
                            endpoint: self.client.endpoint().to_owned(),
                            reason,
                        });
                    }
                },
            }
        }
    }

    async fn connect(&self) -> Result<Streaming<v1::MapEvent>, Error> {
        let request = v1::WatchRequest { map: self.map.clone(), from_position: self.next_position };
        self.client.taken(self.client.events_client().watch(request).await)
    }
}
