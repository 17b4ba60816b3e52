//! What happens in maps, while it happens.

use std::time::Duration;

use tokio::time::{Instant, sleep};
use tonic::Streaming;
use waypost_proto::v1;
use waypost_proto::v1::map_event::Event;

use crate::client::{Call, Client, PAGE_SIZE, map_name};
use crate::error::Error;
use crate::reconnection::{Backoff, LinkEnd, Reconnection};

impl Client {
    /// What the server refused since it began, newest first: calls, requests, and frames, wheel reports and goals
    /// on open streams. The last 1000 are kept. For administrators of the whole server.
    ///
    /// # Errors
    /// [`Error::Status`] with PERMISSION_DENIED.
    pub fn refusals(&self) -> Call<'_, Vec<v1::Refusal>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request = v1::ListRefusalsRequest { page_size: PAGE_SIZE, page_token };
                let page = self.events_client().list_refusals(request).await?.into_inner();
                Ok((page.refusals, page.next_page_token))
            })
            .await
        })
    }

    /// How the server fared over the last hour: its metrics, every 15 seconds.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub fn metrics_history(&self) -> Call<'_, v1::MetricsHistory> {
        Box::pin(async move {
            self.taken(self.events_client().get_metrics_history(v1::GetMetricsHistoryRequest {}).await)
        })
    }

    /// Watches a map: its frames from log position `from_position` on (0 for all), or those that are
    /// decided from now on, and the robots that navigate in it.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the log has no such position,
    /// UNAVAILABLE if too many watch.
    pub fn watch_map<'a>(&'a self, map: &'a str, from_position: Option<u64>) -> Call<'a, MapEvents> {
        Box::pin(async move {
            let mut events = MapEvents {
                client: self.clone(),
                map: map_name(map),
                next_position: from_position,
                log: String::new(),
                open: None,
                pause: None,
                backoff: Backoff::new(Reconnection::default()),
            };
            events.open = Some(self.taken(self.events_client().watch(events.request()).await)?);
            Ok(events)
        })
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
    /// The log that positions are of; empty while nobody has named it.
    log: String,
    /// `None` while it is broken.
    open: Option<Streaming<v1::MapEvent>>,
    /// Before the next attempt to open it; `None` where none has failed.
    pause: Option<Duration>,
    backoff: Backoff,
}

/// What a watch comes to.
#[derive(Clone, Debug, PartialEq)]
pub enum Watched {
    /// Something happened in the map.
    Event(Box<v1::MapEvent>),
    /// The connection broke; the watch tries to go on over another one.
    Disconnected {
        /// Why it broke.
        reason: String,
    },
    /// It goes on, and has missed nothing.
    Reconnected,
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
            match self.next_or_break().await? {
                Watched::Event(event) => return Ok(*event),
                Watched::Disconnected { reason: _ } | Watched::Reconnected => {}
            }
        }
    }

    /// Waits for the next event, or tells that the connection broke, and that there is another one.
    ///
    /// # Errors
    /// As [`next`](Self::next).
    pub async fn next_or_break(&mut self) -> Result<Watched, Error> {
        loop {
            if let Some(pause) = self.pause {
                sleep(pause).await;
            }
            let reason = match self.next_over_a_connection().await {
                Ok(watched) => return Ok(watched),
                Err(LinkEnd::Final(error)) => return Err(error),
                Err(LinkEnd::Broken(reason)) => reason,
            };
            self.open = None;
            let Some(delay) = self.backoff.next_delay(Instant::now()) else {
                return Err(Error::Connection { endpoint: self.client.endpoint().to_owned(), reason });
            };
            // Of further attempts that fail nothing is told.
            if self.pause.replace(delay).is_none() {
                return Ok(Watched::Disconnected { reason });
            }
        }
    }

    /// The next event over the connection that is open, or over a new one.
    async fn next_over_a_connection(&mut self) -> Result<Watched, LinkEnd> {
        loop {
            let Some(events) = &mut self.open else {
                let opened = self.client.events_client().watch(self.request()).await;
                self.open = Some(opened.map_err(|status| LinkEnd::of(&status))?.into_inner());
                continue;
            };
            let event = events.message().await.map_err(|status| LinkEnd::of(&status))?;
            let event = event.ok_or_else(LinkEnd::closed)?;
            self.backoff.progress();
            match &event.event {
                Some(Event::Started(started)) => {
                    self.next_position = Some(started.next_position);
                    self.log.clone_from(&started.log);
                    if self.pause.take().is_some() {
                        return Ok(Watched::Reconnected);
                    }
                }
                Some(Event::Frame(frame)) => {
                    self.next_position = Some(frame.position + 1);
                    return Ok(Watched::Event(Box::new(event)));
                }
                Some(Event::Navigation(_)) | None => return Ok(Watched::Event(Box::new(event))),
            }
        }
    }

    fn request(&self) -> v1::WatchRequest {
        v1::WatchRequest { map: self.map.clone(), from_position: self.next_position, log: self.log.clone() }
    }
}
