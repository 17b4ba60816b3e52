//! Whole tables, page by page from the service to the socket: a table is never in memory as a whole.

use std::future::Future;
use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use futures::stream::{self, Stream, StreamExt, TryStreamExt};
use serde::Serialize;
use utoipa::ToSchema;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Nothing};
use crate::error::ServiceError;
use crate::names::map_name;
use crate::open_map::answers::FrameReference;
use crate::pages::Page;
use crate::service::Service;
use crate::service::frames::{FrameView, FramesWanted};
use crate::service::maps::LoopClosureView;
use crate::wire::maps::loop_closure;
use crate::wire::sessions::listed_frame;

/// Rows read at a time.
const PAGE_ROWS: u32 = 1000;

/// All loop closures of a map as CSV, oldest first.
#[utoipa::path(get, path = "/v1/maps/{map}/loop-closures.csv", tag = "exports", params(MapPath),
    responses((status = 200, description = "A header, then a line per loop closure.", body = String,
        content_type = "text/csv", example = json!("session,sequence,stamp_ns,matched_session,matched_sequence,\
        matched_stamp_ns,place_number,posterior,probability,note,matched_note,withdrawn_ns,withdrawn_by\n")), Refusals))]
pub(super) async fn export_loop_closures_csv(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Response, HttpError> {
    let pages = first_of(loop_closures(service, map_name(&map))).await?;
    Ok(csv_file(&format!("{map}-loop-closures.csv"), LOOP_CLOSURE_COLUMNS, pages, LoopClosureLine::from))
}

/// All loop closures of a map as a JSON array, oldest first.
#[utoipa::path(get, path = "/v1/maps/{map}/loop-closures.json", tag = "exports", params(MapPath),
    responses((status = 200, description = "All loop closures.", body = Vec<v1::LoopClosure>), Refusals))]
pub(super) async fn export_loop_closures_json(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Response, HttpError> {
    let pages = first_of(loop_closures(service, map_name(&map))).await?;
    Ok(json_file(&format!("{map}-loop-closures.json"), pages, loop_closure))
}

/// All frames of a map with what was decided about them as CSV, session by session.
#[utoipa::path(get, path = "/v1/maps/{map}/posteriors.csv", tag = "exports", params(MapPath),
    responses((status = 200, body = String, content_type = "text/csv", description = "A header, then a line per \
        frame: session, sequence, stamp_ns, reason, place_number, posterior, new_place_posterior, and the \
        most probable places in columns place_number_1, posterior_1 to place_number_10, posterior_10; note is what \
        the robot calls the frame."), Refusals))]
pub(super) async fn export_posteriors_csv(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Response, HttpError> {
    let pages = first_of(frames(service, map_name(&map))).await?;
    Ok(csv_file(&format!("{map}-posteriors.csv"), POSTERIOR_COLUMNS, pages, |frame| {
        PosteriorLine::from(FramePosterior::from(frame))
    }))
}

/// All frames of a map with what was decided about them as a JSON array, session by session.
#[utoipa::path(get, path = "/v1/maps/{map}/posteriors.json", tag = "exports", params(MapPath),
    responses((status = 200, description = "All frames.", body = Vec<FramePosterior>), Refusals))]
pub(super) async fn export_posteriors_json(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Response, HttpError> {
    let pages = first_of(frames(service, map_name(&map))).await?;
    Ok(json_file(&format!("{map}-posteriors.json"), pages, FramePosterior::from))
}

/// Rows, a page at a time.
type Rows<T> = Result<Vec<T>, ServiceError>;

fn loop_closures(
    service: Arc<Service>,
    map: String,
) -> impl Stream<Item = Rows<LoopClosureView>> + Send + 'static {
    pages(move |token| {
        let service = service.clone();
        let map = map.clone();
        async move { service.maps.loop_closures(&map, PAGE_ROWS, &token).await }
    })
}

/// The frames of all sessions, with the session that each is of.
fn frames(
    service: Arc<Service>,
    map: String,
) -> impl Stream<Item = Rows<(String, FrameView)>> + Send + 'static {
    let listing = service.clone();
    let sessions = pages(move |token| {
        let service = listing.clone();
        let map = map.clone();
        async move { service.frames.sessions(&map, PAGE_ROWS, &token).await }
    });
    let sessions = sessions.map_ok(|rows| stream::iter(rows).map(Ok::<_, ServiceError>)).try_flatten();
    sessions.map_ok(move |session| frames_of(service.clone(), session.name)).try_flatten()
}

fn frames_of(
    service: Arc<Service>,
    session: String,
) -> impl Stream<Item = Rows<(String, FrameView)>> + Send + 'static {
    let of = session.clone();
    let frames = pages(move |token| {
        let service = service.clone();
        let session = session.clone();
        async move { service.frames.list(&session, FramesWanted::default(), PAGE_ROWS, &token).await }
    });
    frames.map_ok(move |rows| rows.into_iter().map(|frame| (of.clone(), frame)).collect())
}

/// All pages of a list.
fn pages<T, F>(page: impl Fn(String) -> F + Send) -> impl Stream<Item = Rows<T>> + Send
where
    T: Send,
    F: Future<Output = Result<Page<T>, ServiceError>> + Send,
{
    stream::try_unfold((page, Some(String::new())), |(page, token)| async move {
        let Some(token) = token else { return Ok(None) };
        let Page { items, next } = page(token).await?;
        Ok(Some((items, (page, (!next.is_empty()).then_some(next)))))
    })
}

/// Waits for the first page, so that what is wrong from the beginning is an answer and no broken file.
async fn first_of<T: Send + 'static>(
    pages: impl Stream<Item = Rows<T>> + Send + 'static,
) -> Result<impl Stream<Item = Rows<T>> + Send + 'static, ServiceError> {
    let mut pages = pages.boxed();
    let first = pages.next().await.transpose()?;
    Ok(stream::iter(first.map(Ok)).chain(pages))
}

fn csv_file<T, R: Serialize>(
    name: &str,
    columns: &'static [&'static str],
    pages: impl Stream<Item = Rows<T>> + Send + 'static,
    row: impl Fn(T) -> R + Send + 'static,
) -> Response {
    let header = stream::once(async move { csv_lines([columns]) });
    let lines = pages.map(move |rows| csv_lines(rows?.into_iter().map(&row)));
    file("text/csv; charset=utf-8", name, header.chain(lines))
}

fn csv_lines<R: Serialize>(rows: impl IntoIterator<Item = R>) -> Result<Bytes, ServiceError> {
    let mut lines = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    for row in rows {
        lines.serialize(row).map_err(ServiceError::internal)?;
    }
    Ok(lines.into_inner().map_err(ServiceError::internal)?.into())
}

fn json_file<T, R: Serialize>(
    name: &str,
    pages: impl Stream<Item = Rows<T>> + Send + 'static,
    row: impl Fn(T) -> R + Send + 'static,
) -> Response {
    let mut separator = "\n";
    let lines = pages.map(move |rows| {
        let mut lines = Vec::new();
        for value in rows? {
            lines.extend_from_slice(std::mem::replace(&mut separator, ",\n").as_bytes());
            serde_json::to_writer(&mut lines, &row(value)).map_err(ServiceError::internal)?;
        }
        Ok(lines.into())
    });
    let bracket = |text: &'static str| stream::once(async move { Ok(text.into()) });
    file("application/json", name, bracket("[").chain(lines).chain(bracket("\n]\n")))
}

/// A file for the disk. If a later page fails the connection is cut, so that a part is not taken for the whole.
fn file(
    content_type: &'static str,
    name: &str,
    content: impl Stream<Item = Result<Bytes, ServiceError>> + Send + 'static,
) -> Response {
    let headers = [
        (CONTENT_TYPE, content_type.to_owned()),
        (CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\"")),
    ];
    (headers, Body::from_stream(content)).into_response()
}

const LOOP_CLOSURE_COLUMNS: &[&str] = &[
    "session",
    "sequence",
    "stamp_ns",
    "matched_session",
    "matched_sequence",
    "matched_stamp_ns",
    "place_number",
    "posterior",
    "probability",
    "note",
    "matched_note",
    "withdrawn_ns",
    "withdrawn_by",
];

/// A line of the table of loop closures, in the order of [`LOOP_CLOSURE_COLUMNS`].
#[derive(Debug, Serialize)]
struct LoopClosureLine(Seen, Seen, u32, f64, Option<f64>, [String; 2], (Option<i64>, String));

/// Session, sequence number and stamp.
type Seen = (String, u64, i64);

impl From<LoopClosureView> for LoopClosureLine {
    fn from(view: LoopClosureView) -> Self {
        let LoopClosureView { frame, matched, place, posterior, probability, correction } = view;
        let FrameReference { session, sequence, stamp_ns, note } = frame;
        let FrameReference { session: at, sequence: number, stamp_ns: stamp, note: noted } = matched;
        let said = correction.map_or((None, String::new()), |said| (Some(said.said.said_ns), said.said.by));
        let (frame, matched) = ((session, sequence, stamp_ns), (at, number, stamp));
        Self(frame, matched, place.number(), posterior, probability, [note, noted], said)
    }
}

/// What was decided about a frame, in short.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct FramePosterior {
    /// `maps/{map}/sessions/{session}`
    session: String,
    sequence: u64,
    /// When the image was taken, by the robot's clock.
    stamp_ns: i64,
    /// What the robot calls the frame; empty if nothing.
    note: String,
    /// As in the frame's answer.
    #[schema(example = "loop_closure")]
    reason: &'static str,
    /// The place that the frame belongs to; null if too little was seen to decide.
    #[schema(required)]
    place_number: Option<u32>,
    /// Posterior probability of what was decided: of the place, or of a new one.
    posterior: f64,
    /// Probability of being somewhere new.
    new_place_posterior: f64,
    /// The most probable places, most probable first.
    #[schema(max_items = 10)]
    places: Vec<v1::PlaceProbability>,
}

impl From<(String, FrameView)> for FramePosterior {
    fn from((session, frame): (String, FrameView)) -> Self {
        // In short: the rest is had frame by frame.
        let frame = listed_frame(frame);
        let answer = frame.answer.unwrap_or_default();
        Self {
            session,
            sequence: answer.sequence,
            stamp_ns: frame.stamp_ns,
            note: frame.note,
            reason: answer.reason().json_name(),
            place_number: answer.place_number,
            posterior: answer.posterior,
            new_place_posterior: answer.new_place_posterior,
            places: answer.places,
        }
    }
}

/// Places that a line of the table of posteriors has room for: as many as an answer lists.
const LINE_PLACES: usize = 10;

const POSTERIOR_COLUMNS: &[&str] = &[
    "session",
    "sequence",
    "stamp_ns",
    "reason",
    "place_number",
    "posterior",
    "new_place_posterior",
    "place_number_1",
    "posterior_1",
    "place_number_2",
    "posterior_2",
    "place_number_3",
    "posterior_3",
    "place_number_4",
    "posterior_4",
    "place_number_5",
    "posterior_5",
    "place_number_6",
    "posterior_6",
    "place_number_7",
    "posterior_7",
    "place_number_8",
    "posterior_8",
    "place_number_9",
    "posterior_9",
    "place_number_10",
    "posterior_10",
    "note",
];

/// A line of the table of posteriors, in the order of [`POSTERIOR_COLUMNS`].
#[derive(Debug, Serialize)]
struct PosteriorLine(
    String,
    u64,
    i64,
    &'static str,
    Option<u32>,
    f64,
    f64,
    [(Option<u32>, Option<f64>); LINE_PLACES],
    String,
);

impl From<FramePosterior> for PosteriorLine {
    fn from(row: FramePosterior) -> Self {
        let FramePosterior {
            session,
            sequence,
            stamp_ns,
            note,
            reason,
            place_number,
            posterior,
            new_place_posterior,
            places,
        } = row;
        let place_at =
            |rank: usize| places.get(rank).map(|place| (place.place_number, place.posterior)).unzip();
        let by_rank = std::array::from_fn(place_at);
        Self(session, sequence, stamp_ns, reason, place_number, posterior, new_place_posterior, by_rank, note)
    }
}

#[cfg(test)]
mod tests {
    use axum::body::to_bytes;

    use super::*;

    /// Ten numbers in pages of four; the tokens say where to go on.
    async fn numbers(token: String) -> Result<Page<u32>, ServiceError> {
        let from: u32 = if token.is_empty() { 0 } else { token.parse().map_err(ServiceError::invalid)? };
        let until = (from + 4).min(10);
        let next = if until < 10 { until.to_string() } else { String::new() };
        Ok(Page { items: (from..until).collect(), next })
    }

    async fn content(response: Response) -> String {
        let bytes = to_bytes(response.into_body(), usize::MAX).await.unwrap();
        String::from_utf8(bytes.to_vec()).unwrap()
    }

    #[tokio::test]
    async fn tables_go_on_over_all_pages() {
        let pages = first_of(pages(numbers)).await.unwrap();
        let csv = content(csv_file("numbers.csv", &["number", "twice"], pages, |n| (n, 2 * n))).await;
        let lines: Vec<String> = (0..10).map(|n| format!("{n},{}", 2 * n)).collect();
        assert_eq!(csv, format!("number,twice\n{}\n", lines.join("\n")));
        let pages = first_of(super::pages(numbers)).await.unwrap();
        let json = content(json_file("numbers.json", pages, |n| n)).await;
        assert_eq!(serde_json::from_str::<Vec<u32>>(&json).unwrap(), (0..10).collect::<Vec<_>>());
    }

    #[tokio::test]
    async fn a_page_is_read_when_it_is_wanted() {
        let asked = Arc::new(std::sync::atomic::AtomicUsize::new(0));
        let counted = asked.clone();
        let pages = super::pages(move |token| {
            counted.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            numbers(token)
        });
        let pages = first_of(pages).await.unwrap();
        assert_eq!(asked.load(std::sync::atomic::Ordering::Relaxed), 1);
        assert_eq!(pages.count().await, 3);
    }

    #[tokio::test]
    async fn what_fails_at_once_is_an_answer_and_what_fails_later_breaks_the_file_off() {
        let never = |_: String| async { Err::<Page<u32>, _>(ServiceError::not_found("no such list")) };
        assert!(first_of(super::pages(never)).await.is_err());
        let once = |token: String| async move {
            if token.is_empty() { numbers(token).await } else { Err(ServiceError::Internal) }
        };
        let pages = first_of(super::pages(once)).await.unwrap();
        let file = json_file("numbers.json", pages, |n| n);
        assert!(to_bytes(file.into_body(), usize::MAX).await.is_err());
    }
}
