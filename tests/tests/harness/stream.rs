//! Streams of frames: through the client library, and message by message.

use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::metadata::MetadataMap;
use tonic::transport::Channel;
use tonic::{Status, Streaming};
use waypost_client::{Client, FrameContent, FrameInput, FrameOutcome, Session, SessionOptions};
use waypost_proto::v1;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::stream_request::Content as Request;
use waypost_proto::v1::stream_response::Content as Response;

use super::{ServerProcess, channel, in_time, words_options};

/// A session of that name.
pub(crate) fn session_options(map: &str, session: &str) -> SessionOptions {
    SessionOptions { session_id: session.to_owned(), ..SessionOptions::new(map) }
}

/// Streams frames to the end of a session; one outcome per frame, in order.
pub(crate) async fn stream(
    session: Session,
    frames: impl IntoIterator<Item = FrameInput>,
) -> Vec<FrameOutcome> {
    let (mut sender, mut outcomes) = session.split();
    let sending = async move {
        for frame in frames {
            sender.send(frame).await.expect("the session takes the frame");
        }
    };
    let receiving = async move {
        let mut received = Vec::new();
        while let Some(outcome) = outcomes.next().await.expect("the session goes on") {
            received.push(outcome);
        }
        received
    };
    in_time(async { tokio::join!(sending, receiving) }).await.1
}

/// Streams frames of numbers 1 to `count` through a session that goes on whatever becomes of its server: `then` hears
/// before each answer how many there were, and gives the server that goes on.
pub(crate) async fn stream_through(
    session: Session,
    count: u64,
    frame: impl Fn(u64) -> FrameInput + Send + 'static,
    mut server: ServerProcess,
    then: impl Fn(u64, ServerProcess) -> ServerProcess,
) -> ServerProcess {
    let (mut sender, mut outcomes) = session.split();
    let sending = tokio::spawn(async move {
        for sequence in 1..=count {
            sender.send(frame(sequence)).await.expect("the session goes on");
        }
    });
    for expected in 1..=count {
        server = then(expected - 1, server);
        match in_time(outcomes.next()).await.unwrap() {
            Some(FrameOutcome::Answer(answer)) => assert_eq!(answer.sequence, expected),
            other => panic!("frame {expected}: {other:?}"),
        }
    }
    sending.await.unwrap();
    assert_eq!(in_time(outcomes.next()).await.unwrap(), None);
    server
}

/// Streams frames, images or words by the shipped model, into a session that takes them all.
pub(crate) async fn answers(
    client: &Client,
    map: &str,
    session: &str,
    frames: impl IntoIterator<Item = FrameInput>,
) -> Vec<v1::FrameAnswer> {
    let frames: Vec<FrameInput> = frames.into_iter().collect();
    let has_words = frames.iter().any(|frame| !matches!(frame.content, FrameContent::Image(_)));
    let options = if has_words { words_options(map, session) } else { session_options(map, session) };
    answers_of(client, options, frames).await
}

/// Streams frames into a session, opened as `options` say, that takes them all.
pub(crate) async fn answers_of(
    client: &Client,
    options: SessionOptions,
    frames: impl IntoIterator<Item = FrameInput>,
) -> Vec<v1::FrameAnswer> {
    let session = client.open_session(options).await.unwrap();
    let answered = |outcome| match outcome {
        FrameOutcome::Answer(answer) => answer,
        FrameOutcome::Refusal(refusal) => panic!("refused: {refusal:?}"),
    };
    stream(session, frames).await.into_iter().map(answered).collect()
}

/// A frame as it goes over the wire.
pub(crate) fn wire(frame: FrameInput) -> v1::Frame {
    let FrameInput { sequence, stamp_ns, content, odometry, note } = frame;
    let content = match content {
        FrameContent::Image(image) => v1::frame::Content::Image(image),
        FrameContent::Histogram(histogram) => v1::frame::Content::Histogram(histogram),
        FrameContent::Words(words) => v1::frame::Content::Words(words),
    };
    v1::Frame { sequence, stamp_ns, odometry, content: Some(content), note }
}

/// The first message of an ordinary stream.
pub(crate) fn open(map: &str, session: &str) -> v1::OpenSession {
    v1::OpenSession {
        map: format!("maps/{map}"),
        session_id: session.to_owned(),
        mode: v1::SessionMode::Map.into(),
        camera: None,
        words_hash: String::new(),
        run_id: String::new(),
    }
}

/// A stream as the contract has it, without the client library's care.
pub(crate) struct RawStream {
    requests: mpsc::Sender<v1::StreamRequest>,
    responses: Streaming<v1::StreamResponse>,
}

impl RawStream {
    /// Begins a stream with `first`.
    pub(crate) async fn begin(endpoint: &str, first: Request) -> Result<Self, Status> {
        Self::begin_over(channel(endpoint).await, first).await
    }

    /// Begins a stream over a connection that is there.
    pub(crate) async fn begin_over(channel: Channel, first: Request) -> Result<Self, Status> {
        Self::begin_with(channel, first, MetadataMap::new()).await
    }

    /// Begins a stream that shows a token's secret.
    pub(crate) async fn begin_as(endpoint: &str, secret: &str, first: Request) -> Result<Self, Status> {
        let mut metadata = MetadataMap::new();
        metadata.insert("authorization", format!("Bearer {secret}").parse().unwrap());
        Self::begin_with(channel(endpoint).await, first, metadata).await
    }

    /// The same with what goes beside it, as a secret does.
    pub(crate) async fn begin_with(
        channel: Channel,
        first: Request,
        metadata: MetadataMap,
    ) -> Result<Self, Status> {
        let (requests, receiver) = mpsc::channel(256);
        requests.send(v1::StreamRequest { content: Some(first) }).await.unwrap();
        let mut service = SessionServiceClient::new(channel);
        let mut request = tonic::Request::new(ReceiverStream::new(receiver));
        *request.metadata_mut() = metadata;
        let responses = in_time(service.stream(request)).await?.into_inner();
        Ok(Self { requests, responses })
    }

    /// Opens a session; gives what the server says to it.
    pub(crate) async fn open(
        endpoint: &str,
        first: v1::OpenSession,
    ) -> Result<(Self, v1::SessionOpened), Status> {
        let mut stream = Self::begin(endpoint, Request::Open(first)).await?;
        match stream.next().await? {
            Some(Response::Opened(opened)) => Ok((stream, opened)),
            other => panic!("the session was not opened: {other:?}"),
        }
    }

    /// A way to send beside reading.
    pub(crate) fn requests(&self) -> mpsc::Sender<v1::StreamRequest> {
        self.requests.clone()
    }

    pub(crate) async fn send(&self, content: Request) {
        // A stream that has ended takes nothing more; the next response tells why it did.
        let _ = self.requests.send(v1::StreamRequest { content: Some(content) }).await;
    }

    /// Sends a message with nothing in it; gives what is said to it.
    pub(crate) async fn empty_message(mut self) -> Result<Option<Response>, Status> {
        let _ = self.requests.send(v1::StreamRequest { content: None }).await;
        self.next().await
    }

    /// The next response; `None` at the end of the stream.
    pub(crate) async fn next(&mut self) -> Result<Option<Response>, Status> {
        let response = in_time(self.responses.message()).await?;
        Ok(response.map(|response| response.content.expect("a response has a content")))
    }

    /// Sends a frame and waits for what becomes of it.
    pub(crate) async fn frame(&mut self, frame: v1::Frame) -> Result<Response, Status> {
        self.send(Request::Frame(frame)).await;
        Ok(self.next().await?.expect("the stream goes on"))
    }

    /// Sends a frame that is taken.
    pub(crate) async fn answered(&mut self, frame: v1::Frame) -> v1::FrameAnswer {
        match self.frame(frame).await {
            Ok(Response::Answer(answer)) => answer,
            other => panic!("no answer: {other:?}"),
        }
    }

    /// Sends a frame that is refused.
    pub(crate) async fn refused(&mut self, frame: v1::Frame) -> v1::FrameRefusal {
        match self.frame(frame).await {
            Ok(Response::Refusal(refusal)) => refusal,
            other => panic!("not refused: {other:?}"),
        }
    }
}
