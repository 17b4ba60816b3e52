//! What happens in maps, as server-sent events.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::http::{HeaderMap, HeaderName};
use axum::response::sse::{Event, KeepAlive, Sse};
use futures::stream::{Stream, StreamExt};
use serde::Deserialize;
use utoipa::IntoParams;
use waypost_proto::v1;
use waypost_proto::v1::map_event;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Parameters};
use crate::error::ServiceError;
use crate::names::map_name;
use crate::service::Service;
use crate::service::events::MapEventView;
use crate::wire::events::map_event as message;

/// What a browser that connects again has had, as `id` of the last event.
const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

/// A comment as often as this keeps proxies from closing a connection that says nothing.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct From {
    /// Frames from this position of the map's log on come first: 0 for all. Left out, only frames that are decided from
    /// now on.
    #[param(example = 0)]
    from_position: Option<u64>,
}

impl Parameters for From {
    const TAKES: &str = "from_position=NUMBER";
}

/// What happens in a map, while it happens, as server-sent events.
///
/// Each event is a line `event: started`, which is the first, `event: frame` or `event: navigation`, and the JSON of a
/// `MapEvent` as `data`. The start and each frame have an `id`: a browser that connects again goes on behind the last one
/// it had. It is refused with 409 if sessions were removed from the map meanwhile, or it was made anew. `event: error` is
/// the last, with the error as `data`, when the map is deleted, sessions are removed from it, or the server stops.
#[utoipa::path(get, path = "/v1/maps/{map}/events", tag = "maps", operation_id = "watch_map",
    params(MapPath, From,
        ("Last-Event-ID" = Option<String>, Header, description = "`id` of the last event that the caller has had.")),
    responses((status = 200, description = "The events, for as long as the caller listens.", body = v1::MapEvent,
        content_type = "text/event-stream"), Refusals))]
pub(super) async fn watch_map(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(From { from_position }): InQuery<From>,
    headers: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, HttpError> {
    let (from, log) = match headers.get(LAST_EVENT_ID) {
        Some(last) => {
            let (log, position) = behind(last.as_bytes())?;
            (Some(position), log)
        }
        None => (from_position, String::new()),
    };
    let events = service.events.watch(&map_name(&map), from, &log).await?;
    // The first event names the log.
    let events = events.scan(String::new(), |log, event| {
        if let Ok(MapEventView::Started { next_position: _, log: named }) = &event {
            log.clone_from(named);
        }
        std::future::ready(Some(Ok(sent(event, log))))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)))
}

/// What a caller that connects again gives back: the log, and the position in it to go on from.
fn id(log: &str, next_position: u64) -> String {
    format!("{log}-{next_position}")
}

/// The log and the position behind the last event.
fn behind(last: &[u8]) -> Result<(String, u64), ServiceError> {
    let parts = std::str::from_utf8(last).ok().and_then(|text| text.rsplit_once('-'));
    let read = parts.and_then(|(log, position)| Some((log.to_owned(), position.parse().ok()?)));
    read.filter(|(log, _)| !log.is_empty()).ok_or_else(|| {
        ServiceError::invalid(
            "the Last-Event-ID is not one that this server gave; leave it out, or say from_position",
        )
    })
}

fn sent(event: Result<MapEventView, ServiceError>, log: &str) -> Event {
    let event = match event {
        Ok(view) => {
            let event = message(view);
            let (name, next_position) = match &event.event {
                Some(map_event::Event::Started(started)) => ("started", Some(started.next_position)),
                Some(map_event::Event::Frame(frame)) => ("frame", Some(frame.position + 1)),
                Some(map_event::Event::Navigation(_)) | None => ("navigation", None),
            };
            let sent = Event::default().event(name).json_data(&event);
            sent.map(|sent| match next_position {
                Some(next_position) => sent.id(id(log, next_position)),
                None => sent,
            })
        }
        Err(error) => Event::default().event("error").json_data(HttpError::from(error).body()),
    };
    // Messages are always JSON; a comment stands for what could not be written.
    event.unwrap_or_else(|_| Event::default().comment("an event could not be written"))
}
