//! A robot as the contract has it: frames by the clock, sent again when the server says so.
//!
//! Spoken message by message, because the client library keeps to itself what is measured here: how often a
//! frame was refused, and what the server says of its time.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Result, anyhow, bail};
use futures::future::OptionFuture;
use prost::Message;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Endpoint;
use tonic::{Code, Status, Streaming};
use tonic_types::pb::RetryInfo;
use waypost_client::{Client, FrameContent, FrameInput, FrameOutcome, SessionOptions};
use waypost_proto::google::rpc;
use waypost_proto::v1;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::stream_request::Content as Request;
use waypost_proto::v1::stream_response::Content as Response;

use super::contents::Contents;
use super::server::breach;

/// Frames that a robot has on their way at once, as many as the client library by default.
const WINDOW: usize = 8;

/// How long a robot waits after a refusal that does not say.
const DEFAULT_RETRY: Duration = Duration::from_millis(100);

/// After its last frame, a robot waits this long for its answers.
const LAST_ANSWERS: Duration = Duration::from_secs(30);

/// An open session of one robot.
pub(super) struct Robot {
    requests: mpsc::Sender<v1::StreamRequest>,
    responses: Streaming<v1::StreamResponse>,
    contents: Arc<Contents>,
    first_content: usize,
    /// Without an outcome, oldest first.
    backlog: VecDeque<Backlogged>,
    /// Nothing is sent before: a frame was refused for now.
    retry_at: Option<Instant>,
    /// Frames that may be on their way at once: one after a refusal, then twice as many with each answer.
    window: usize,
    record: Record,
}

/// When a robot takes images, and what becomes of those it cannot get rid of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    /// The first image.
    pub(super) first: Instant,
    /// Between images. Zero: the next is taken when there is room for it.
    pub(super) interval: Duration,
    /// The last image is taken before.
    pub(super) until: Instant,
    /// Frames without an answer that a robot keeps; new images are dropped while it has so many.
    pub(super) backlog_frames: usize,
    pub(super) at_the_end: AtTheEnd,
}

/// What a robot does when its drive is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AtTheEnd {
    /// It waits for the answers that are still out.
    Wait,
    /// It is switched off.
    Leave,
}

/// What happened to a robot's frames.
#[derive(Debug, Default)]
pub(super) struct Record {
    /// Images taken.
    pub(super) offered: u64,
    /// Images dropped by the robot because its backlog was full.
    pub(super) dropped: u64,
    pub(super) answered: Vec<Answered>,
    /// Refusals of frames that were then sent again.
    pub(super) refused_for_now: u64,
    /// Those of them that said when to try again.
    pub(super) with_retry_info: u64,
    /// Refusals for good.
    pub(super) refused: u64,
    /// Frames sent, those sent again included.
    pub(super) sent: u64,
}

/// A frame that was answered.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answered {
    pub(super) at: Instant,
    /// From when the image was to be taken, whether the robot was late or not.
    pub(super) round_trip: Duration,
    /// How late the robot was with sending it first.
    pub(super) send_late: Duration,
    /// What the server spent on the frame itself.
    pub(super) computing: Duration,
}

impl Record {
    pub(super) fn together(records: impl IntoIterator<Item = Record>) -> Self {
        let mut together = Self::default();
        records.into_iter().for_each(|record| together.add(record));
        together
    }

    fn add(&mut self, other: Record) {
        let Record { offered, dropped, answered, refused_for_now, with_retry_info, refused, sent } = other;
        self.offered += offered;
        self.dropped += dropped;
        self.answered.extend(answered);
        self.refused_for_now += refused_for_now;
        self.with_retry_info += with_retry_info;
        self.refused += refused;
        self.sent += sent;
    }
}

impl Answered {
    /// What is not computing: the way there and back, waiting, the commit.
    pub(super) fn beyond_computing(&self) -> Duration {
        self.round_trip.saturating_sub(self.computing)
    }
}

struct Backlogged {
    sequence: u64,
    due: Instant,
    first_sent: Option<Instant>,
    in_flight: bool,
}

impl Robot {
    /// Opens a session over a connection of its own.
    pub(super) async fn open(
        endpoint: &str,
        (map, session): (&str, &str),
        contents: Arc<Contents>,
        first_content: usize,
    ) -> Result<Self> {
        let connection = connection(endpoint)?;
        let (requests, responses) = open_stream(connection, (map, session), &contents.words_hash).await?;
        Ok(Self {
            requests,
            responses,
            contents,
            first_content,
            backlog: VecDeque::new(),
            retry_at: None,
            window: WINDOW,
            record: Record::default(),
        })
    }

    /// Takes images as the camera says until its end.
    pub(super) async fn drive(mut self, camera: Camera) -> Result<Record> {
        let mut next_image = Some(camera.first);
        loop {
            self.send_what_may_go(camera.interval)?;
            if next_image.is_none() && (self.backlog.is_empty() || camera.at_the_end == AtTheEnd::Leave) {
                return Ok(self.record);
            }
            let waits_for_room =
                camera.interval == Duration::ZERO && self.backlog.len() >= camera.backlog_frames;
            let image_at = next_image.filter(|_| !waits_for_room).unwrap_or(camera.until);
            let retry_at = self.retry_at.filter(|_| self.all_came_back());
            tokio::select! {
                response = self.responses.message() => self.take(response.map_err(|status| ended(&status))?)?,
                () = sleep_until(image_at), if next_image.is_some() => {
                    next_image = self.take_image(&camera, next_image);
                }
                Some(()) = OptionFuture::from(retry_at.map(sleep_until)) => self.retry_at = None,
                () = sleep_until(camera.until + LAST_ANSWERS) => {
                    bail!(
                        "{} frames of one robot were never answered; lower the load, or look for what holds the server up",
                        self.backlog.len()
                    );
                }
            }
        }
    }

    /// Gives when the next image is due; none after the last.
    fn take_image(&mut self, camera: &Camera, due: Option<Instant>) -> Option<Instant> {
        let now = Instant::now();
        let due = due.filter(|_| camera.interval > Duration::ZERO).unwrap_or(now);
        if due >= camera.until {
            return None;
        }
        self.record.offered += 1;
        if self.backlog.len() < camera.backlog_frames {
            let sequence = self.record.offered;
            self.backlog.push_back(Backlogged { sequence, due, first_sent: None, in_flight: false });
        } else {
            self.record.dropped += 1;
        }
        Some(due + camera.interval).filter(|&next| next < camera.until)
    }

    /// Oldest first; nothing overtakes a frame that has to be sent again.
    fn send_what_may_go(&mut self, interval: Duration) -> Result<()> {
        if self.retry_at.is_some() {
            return Ok(());
        }
        for frame in self.backlog.iter_mut().take(self.window).filter(|frame| !frame.in_flight) {
            let index = (self.first_content + frame.sequence as usize) % self.contents.frames.len();
            let content = &self.contents.frames[index];
            frame.in_flight = true;
            frame.first_sent.get_or_insert_with(Instant::now);
            self.record.sent += 1;
            // Any rising stamps will do.
            let stamp_ns = frame.sequence as i64 * (interval.as_nanos() as i64).max(1);
            let request = Request::Frame(wire(frame.sequence, stamp_ns, content.clone()));
            let sent = self.requests.try_send(v1::StreamRequest { content: Some(request) });
            // If the stream has ended, its responses tell why.
            if let Err(mpsc::error::TrySendError::Full(_)) = sent {
                return Err(breach("more frames are on their way than the window holds"));
            }
        }
        Ok(())
    }

    fn all_came_back(&self) -> bool {
        !self.backlog.iter().any(|frame| frame.in_flight)
    }

    fn take(&mut self, response: Option<v1::StreamResponse>) -> Result<()> {
        let content = response.and_then(|response| response.content);
        match content.ok_or_else(|| breach("the server ended the stream"))? {
            Response::Answer(answer) => {
                let frame = self.settled(answer.sequence)?;
                let now = Instant::now();
                self.window = (2 * self.window).min(WINDOW);
                self.record.answered.push(Answered {
                    at: now,
                    round_trip: now - frame.due,
                    send_late: frame.first_sent.map_or(Duration::ZERO, |sent| sent - frame.due),
                    computing: computing(&answer.timings.unwrap_or_default()),
                });
            }
            Response::Refusal(v1::FrameRefusal { sequence, status, .. }) => {
                self.refused(sequence, &status.unwrap_or_default())?;
            }
            Response::Opened(_) => return Err(breach("the session was opened twice")),
        }
        Ok(())
    }

    fn refused(&mut self, sequence: u64, status: &rpc::Status) -> Result<()> {
        if Code::from(status.code) != Code::Unavailable {
            self.settled(sequence)?;
            self.record.refused += 1;
            return Ok(());
        }
        self.frame(sequence)?.in_flight = false;
        self.window = 1;
        self.record.refused_for_now += 1;
        let hint = retry_delay(status);
        self.record.with_retry_info += u64::from(hint.is_some());
        let retry_at = Instant::now() + hint.unwrap_or(DEFAULT_RETRY);
        // The frames behind it are refused without a time of their own.
        self.retry_at = match self.retry_at {
            Some(before) if hint.is_none() => Some(before),
            before => before.max(Some(retry_at)),
        };
        Ok(())
    }

    fn frame(&mut self, sequence: u64) -> Result<&mut Backlogged> {
        let found = self.backlog.iter_mut().find(|frame| frame.sequence == sequence && frame.in_flight);
        found.ok_or_else(|| breach("the server answered a frame that was not sent"))
    }

    /// Takes a frame off the backlog. Answers come in the order of frames.
    fn settled(&mut self, sequence: u64) -> Result<Backlogged> {
        let front = self.backlog.pop_front().filter(|front| front.sequence == sequence && front.in_flight);
        front.ok_or_else(|| breach("the server answered frames out of order"))
    }
}

/// All robots side by side; what happened to each, in no order.
pub(super) async fn drive_all(robots: impl IntoIterator<Item = (Robot, Camera)>) -> Result<Vec<Record>> {
    let mut driving = JoinSet::new();
    for (robot, camera) in robots {
        driving.spawn(robot.drive(camera));
    }
    let mut records = Vec::new();
    while let Some(driven) = driving.join_next().await {
        records.push(driven??);
    }
    Ok(records)
}

/// Streams frames by the client library, as fast as they are taken; fails if one is refused.
pub(super) async fn stream_all(
    client: &Client,
    options: SessionOptions,
    frames: impl Iterator<Item = FrameInput> + Send + 'static,
    answered: impl Fn(),
) -> Result<()> {
    let (mut sender, mut outcomes) = client.open_session(options).await?.split();
    let sending = tokio::spawn(async move {
        for frame in frames {
            sender.send(frame).await?;
        }
        Ok::<(), anyhow::Error>(())
    });
    while let Some(outcome) = outcomes.next().await? {
        if let FrameOutcome::Refusal(refusal) = outcome {
            let why = refusal.status.unwrap_or_default().message;
            bail!("the server under load refused a frame: {why}");
        }
        answered();
    }
    sending.await?
}

/// A connection to be made.
pub(super) fn connection(endpoint: &str) -> Result<Endpoint> {
    Ok(Endpoint::from_shared(endpoint.to_owned())?.tcp_nodelay(true))
}

/// For `map_err` where a call or a stream has ended.
fn ended(status: &Status) -> anyhow::Error {
    anyhow!("a stream ended under load: {} ({:?})", status.message(), status.code())
}

/// A stream with an open session.
pub(super) async fn open_stream(
    connection: Endpoint,
    (map, session): (&str, &str),
    words_hash: &str,
) -> Result<(mpsc::Sender<v1::StreamRequest>, Streaming<v1::StreamResponse>)> {
    let channel = connection.connect().await?;
    let (requests, receiver) = mpsc::channel(WINDOW + 1);
    let opening = v1::OpenSession {
        map: format!("maps/{map}"),
        session_id: session.to_owned(),
        mode: v1::SessionMode::Map.into(),
        camera: None,
        words_hash: words_hash.to_owned(),
        run_id: String::new(),
    };
    // The receiver is here still.
    let _ = requests.send(v1::StreamRequest { content: Some(Request::Open(opening)) }).await;
    let mut service = SessionServiceClient::new(channel);
    let mut responses =
        service.stream(ReceiverStream::new(receiver)).await.map_err(|status| ended(&status))?.into_inner();
    match responses.message().await.map_err(|status| ended(&status))?.and_then(|response| response.content) {
        Some(Response::Opened(_)) => Ok((requests, responses)),
        Some(Response::Answer(_) | Response::Refusal(_)) | None => {
            Err(breach("the server did not open the session"))
        }
    }
}

pub(super) fn wire(sequence: u64, stamp_ns: i64, content: FrameContent) -> v1::Frame {
    let content = match content {
        FrameContent::Image(image) => v1::frame::Content::Image(image),
        FrameContent::Histogram(histogram) => v1::frame::Content::Histogram(histogram),
        FrameContent::Words(words) => v1::frame::Content::Words(words),
    };
    v1::Frame { sequence, stamp_ns, odometry: None, content: Some(content), note: String::new() }
}

fn computing(timings: &v1::Timings) -> Duration {
    let v1::Timings {
        extract_ms,
        quantize_ms,
        likelihood_ms,
        new_place_ms,
        filter_ms,
        verification_ms,
        // Waiting, and the sum of all.
        commit_ms: _,
        total_ms: _,
    } = timings;
    let ms = extract_ms + quantize_ms + likelihood_ms + new_place_ms + filter_ms + verification_ms;
    Duration::try_from_secs_f64(ms / 1e3).unwrap_or_default()
}

/// What a `google.rpc.RetryInfo` among the details asks for.
fn retry_delay(status: &rpc::Status) -> Option<Duration> {
    let hint = status.details.iter().find(|detail| detail.type_url.ends_with("/google.rpc.RetryInfo"))?;
    let delay = RetryInfo::decode(hint.value.as_slice()).ok()?.retry_delay?;
    Duration::try_from(delay).ok()
}
