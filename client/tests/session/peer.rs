//! A server of sessions that breaks where the script says, over real sockets.
//!
//! It keeps the contract: frames are committed once, in rising order, and answered from the store when
//! they are sent again. A crash takes the whole runtime down, connections and all, and a new one comes
//! up at the same address with what was committed.

use std::collections::{HashMap, VecDeque};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::net::TcpSocket;
use tokio::sync::Notify;
use tokio_stream::wrappers::{TcpListenerStream, UnboundedReceiverStream};
use tonic::transport::Server;
use tonic::{Code, Request, Response, Status, Streaming};
use waypost_proto::google::rpc;
use waypost_proto::v1;
use waypost_proto::v1::session_service_server::{SessionService, SessionServiceServer};
use waypost_proto::v1::stream_request::Content as Asked;
use waypost_proto::v1::stream_response::Content as Told;

pub(crate) const MAP: &str = "maps/office";
/// Frames of this size in bytes are bad and refused.
pub(crate) const BAD_IMAGE_BYTES: usize = 13;

/// What happens when a frame arrives. Each happens once.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Fault {
    /// The server dies before it has committed the frame.
    CrashBeforeCommit,
    /// The server dies when it has committed the frame and not yet answered.
    CrashAfterCommit,
    /// The stream ends; the frame is not committed.
    End(Code),
    /// The stream ends as if all was well; the frame is committed.
    EndQuietly,
    /// The frame is refused and not committed.
    Refuse(Code),
    /// The server dies, and its disk is replaced by an empty one.
    CrashAndForget,
}

/// What the server has on its disk and what it has seen.
#[derive(Default)]
pub(crate) struct Record {
    /// Frames in the order of their commits, by session.
    pub(crate) committed: HashMap<String, Vec<u64>>,
    /// Sessions as they were opened, one entry per stream.
    pub(crate) opened: Vec<String>,
    /// Most frames that arrived without an answer.
    pub(crate) most_held: usize,
    faults: HashMap<u64, VecDeque<Fault>>,
}

pub(crate) struct Peer {
    pub(crate) address: SocketAddr,
    record: Arc<Mutex<Record>>,
    holding: Arc<Holding>,
    orders: mpsc::Sender<Order>,
    supervisor: Option<JoinHandle<()>>,
    /// Bound and never listening: keeps the port from other tests' servers while this one is down.
    _port: TcpSocket,
}

/// Answers are held back while it is on.
#[derive(Default)]
struct Holding {
    on: Mutex<bool>,
    released: Notify,
}

enum Order {
    Crash { forget: bool },
    Stop,
}

impl Peer {
    pub(crate) fn start(faults: impl IntoIterator<Item = (u64, Fault)>) -> Self {
        let mut record = Record::default();
        for (sequence, fault) in faults {
            record.faults.entry(sequence).or_default().push_back(fault);
        }
        let record = Arc::new(Mutex::new(record));
        let holding = Arc::new(Holding::default());
        let (orders, taken) = mpsc::channel();
        let (listening, is_listening) = mpsc::channel();
        let port = bound(SocketAddr::from(([127, 0, 0, 1], 0)));
        let address = port.local_addr().unwrap();
        let sessions =
            Sessions { record: Arc::clone(&record), holding: Arc::clone(&holding), orders: orders.clone() };
        let supervisor = std::thread::spawn(move || supervise(address, &sessions, &taken, &listening));
        is_listening.recv().unwrap();
        Self { address, record, holding, orders, supervisor: Some(supervisor), _port: port }
    }

    pub(crate) fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    pub(crate) fn record(&self) -> MutexGuard<'_, Record> {
        self.record.lock().unwrap()
    }

    pub(crate) fn hold_answers(&self) {
        *self.holding.on.lock().unwrap() = true;
    }

    pub(crate) fn release_answers(&self) {
        *self.holding.on.lock().unwrap() = false;
        self.holding.released.notify_waiters();
    }

    /// Ends the server for good.
    pub(crate) fn stop(&mut self) {
        if let Some(supervisor) = self.supervisor.take() {
            self.orders.send(Order::Stop).unwrap();
            supervisor.join().unwrap();
        }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.stop();
    }
}

/// A socket at an address that others of ours may share until one of them listens.
fn bound(address: SocketAddr) -> TcpSocket {
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_reuseaddr(true).unwrap();
    socket.bind(address).unwrap();
    socket
}

/// Keeps one server running at one address until it is told to stop.
fn supervise(
    address: SocketAddr,
    sessions: &Sessions,
    orders: &mpsc::Receiver<Order>,
    listening: &mpsc::Sender<()>,
) {
    loop {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let listener = runtime.block_on(async { bound(address).listen(1024) }).unwrap();
        // Only the first start is waited for.
        let _ = listening.send(());
        let service = SessionServiceServer::new(sessions.clone()).max_decoding_message_size(8 << 20);
        runtime.spawn(
            Server::builder().add_service(service).serve_with_incoming(TcpListenerStream::new(listener)),
        );
        let order = orders.recv().unwrap();
        runtime.shutdown_timeout(Duration::from_secs(10));
        match order {
            Order::Crash { forget: false } => {}
            Order::Crash { forget: true } => sessions.record().committed.clear(),
            Order::Stop => return,
        }
    }
}

#[derive(Clone)]
struct Sessions {
    record: Arc<Mutex<Record>>,
    holding: Arc<Holding>,
    orders: mpsc::Sender<Order>,
}

type Answers = tokio::sync::mpsc::UnboundedSender<Result<v1::StreamResponse, Status>>;

#[tonic::async_trait]
impl SessionService for Sessions {
    type StreamStream = UnboundedReceiverStream<Result<v1::StreamResponse, Status>>;

    async fn stream(
        &self,
        request: Request<Streaming<v1::StreamRequest>>,
    ) -> Result<Response<Self::StreamStream>, Status> {
        let mut requests = request.into_inner();
        let Some(Asked::Open(open)) = requests.message().await?.and_then(|first| first.content) else {
            return Err(Status::invalid_argument("open a session first"));
        };
        if open.map != MAP {
            return Err(Status::not_found("there is no such map; create it"));
        }
        let (answers, responses) = tokio::sync::mpsc::unbounded_channel();
        let session = self.open(&open.session_id, &answers);
        let sessions = self.clone();
        tokio::spawn(async move {
            if let Err(ended) = sessions.serve(&session, requests, &answers).await {
                let _ = answers.send(Err(ended));
            }
        });
        Ok(Response::new(UnboundedReceiverStream::new(responses)))
    }

    async fn list_sessions(
        &self,
        _: Request<v1::ListSessionsRequest>,
    ) -> Result<Response<v1::ListSessionsResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn get_session(&self, _: Request<v1::GetSessionRequest>) -> Result<Response<v1::Session>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn list_open_streams(
        &self,
        _: Request<v1::ListOpenStreamsRequest>,
    ) -> Result<Response<v1::ListOpenStreamsResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn list_frames(
        &self,
        _: Request<v1::ListFramesRequest>,
    ) -> Result<Response<v1::ListFramesResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn get_frame(&self, _: Request<v1::GetFrameRequest>) -> Result<Response<v1::FrameRecord>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn get_frame_image(
        &self,
        _: Request<v1::GetFrameImageRequest>,
    ) -> Result<Response<v1::GetFrameImageResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn explain_frame(
        &self,
        _: Request<v1::ExplainFrameRequest>,
    ) -> Result<Response<v1::FrameExplanation>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn get_frame_picture(
        &self,
        _: Request<v1::GetFramePictureRequest>,
    ) -> Result<Response<v1::GetFramePictureResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn delete_session(
        &self,
        _: Request<v1::DeleteSessionRequest>,
    ) -> Result<Response<v1::Job>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn add_relative_pose(
        &self,
        _: Request<v1::AddRelativePoseRequest>,
    ) -> Result<Response<v1::AddRelativePoseResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }
}

impl Sessions {
    fn record(&self) -> MutexGuard<'_, Record> {
        self.record.lock().unwrap()
    }

    fn open(&self, session_id: &str, answers: &Answers) -> String {
        let mut record = self.record();
        let session = match session_id {
            "" => format!("{MAP}/sessions/made-up-{}", record.opened.len()),
            session_id => format!("{MAP}/sessions/{session_id}"),
        };
        record.opened.push(session.clone());
        let last_committed_sequence = record.committed.get(&session).and_then(|log| log.last().copied());
        let opened = v1::SessionOpened {
            session: session.clone(),
            last_committed_sequence,
            model: "models/0".to_owned(),
            words_hash: String::new(),
        };
        tell(answers, Told::Opened(opened));
        session
    }

    async fn serve(
        &self,
        session: &str,
        mut requests: Streaming<v1::StreamRequest>,
        answers: &Answers,
    ) -> Result<(), Status> {
        let mut held = Vec::new();
        loop {
            let request = tokio::select! {
                request = requests.message() => request?,
                () = self.holding.released.notified(), if !held.is_empty() => {
                    held.drain(..).for_each(|told| tell(answers, told));
                    continue;
                }
            };
            let Some(request) = request else { return Ok(()) };
            let Some(Asked::Frame(frame)) = request.content else {
                return Err(Status::invalid_argument("send frames"));
            };
            let Some(told) = self.frame(session, &frame).await? else { return Ok(()) };
            if *self.holding.on.lock().unwrap() {
                held.push(told);
                let mut record = self.record();
                record.most_held = record.most_held.max(held.len());
            } else {
                tell(answers, told);
            }
        }
    }

    /// None if the stream ends without a word.
    async fn frame(&self, session: &str, frame: &v1::Frame) -> Result<Option<Told>, Status> {
        let fault = self.record().faults.get_mut(&frame.sequence).and_then(VecDeque::pop_front);
        match fault {
            None => Ok(Some(self.commit(session, frame))),
            Some(Fault::CrashBeforeCommit) => self.crash(false).await,
            Some(Fault::CrashAndForget) => self.crash(true).await,
            Some(Fault::CrashAfterCommit) => {
                self.commit(session, frame);
                self.crash(false).await
            }
            Some(Fault::End(code)) => Err(Status::new(code, "the script says so")),
            Some(Fault::EndQuietly) => {
                self.commit(session, frame);
                Ok(None)
            }
            Some(Fault::Refuse(code)) => Ok(Some(refusal(frame.sequence, code))),
        }
    }

    async fn crash(&self, forget: bool) -> Result<Option<Told>, Status> {
        self.orders.send(Order::Crash { forget }).unwrap();
        std::future::pending().await
    }

    fn commit(&self, session: &str, frame: &v1::Frame) -> Told {
        let sequence = frame.sequence;
        let mut record = self.record();
        let log = record.committed.entry(session.to_owned()).or_default();
        let resent = log.contains(&sequence);
        if !resent {
            let Some(v1::frame::Content::Image(image)) = &frame.content else { panic!("no image") };
            if image.len() == BAD_IMAGE_BYTES {
                return refusal(sequence, Code::InvalidArgument);
            }
            if log.last().is_some_and(|last| *last >= sequence) {
                return refusal(sequence, Code::FailedPrecondition);
            }
            log.push(sequence);
        }
        let last_committed_sequence = log.last().copied().unwrap_or_default();
        Told::Answer(v1::FrameAnswer { sequence, last_committed_sequence, resent, ..Default::default() })
    }
}

fn refusal(sequence: u64, code: Code) -> Told {
    let status =
        rpc::Status { code: code.into(), message: "the script says so".to_owned(), details: Vec::new() };
    Told::Refusal(v1::FrameRefusal { sequence, last_committed_sequence: None, status: Some(status) })
}

fn tell(answers: &Answers, content: Told) {
    // A client that is gone does not listen.
    let _ = answers.send(Ok(v1::StreamResponse { content: Some(content) }));
}
