//! A server that is told to stop does so, whatever its clients are up to.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Stdio;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use waypost_client::{Code, FrameOutcome};
use waypost_proto::v1;
use waypost_proto::v1::model_service_client::ModelServiceClient;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::train_model_request::Content;

use crate::harness::{
    Built, RawStream, ServerProcess, assert_status, channel, frame, images, import_model, in_time,
    map_request, open, session_options, wire,
};

/// Many times what a stop takes.
const STOPPING: Duration = Duration::from_secs(10);

struct Running {
    server: ServerProcess,
    _directory: tempfile::TempDir,
}

async fn running() -> Running {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    Running { server, _directory: directory }
}

impl Running {
    #[track_caller]
    fn stops(&mut self) {
        let status = self.server.terminate(STOPPING);
        let log = self.server.log();
        assert!(status.is_some(), "it does not stop:\n{log}");
        assert!(status.is_some_and(|status| status.success()), "{status:?}:\n{log}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_open_stream_is_told() {
    let mut running = running().await;
    let (mut raw, _) = RawStream::open(&running.server.endpoint(), open("drive", "robot")).await.unwrap();
    raw.answered(wire(frame(1))).await;
    running.stops();
    let status = raw.next().await.unwrap_err();
    assert_status("stopping", (status.code(), status.message()), Code::Unavailable, "the server is stopping");
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_under_way_are_answered_or_sent_again() {
    let mut running = running().await;
    let client = running.server.client().await;
    let session = client.open_session(session_options("drive", "robot")).await.unwrap();
    let (mut sender, mut outcomes) = session.split();
    let sending = tokio::spawn(async move {
        for sequence in 1..=60 {
            if sender.send(frame(sequence)).await.is_err() {
                return;
            }
        }
    });
    let mut acknowledged = 0;
    while acknowledged < 5 {
        match in_time(outcomes.next()).await.unwrap() {
            Some(FrameOutcome::Answer(answer)) => acknowledged = answer.sequence,
            other => panic!("{other:?}"),
        }
    }
    running.stops();
    drop(outcomes);
    sending.await.unwrap();
    let server = ServerProcess::start(running._directory.path());
    let (_, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert!(opened.last_committed_sequence >= Some(acknowledged), "{opened:?}");
    server.stop();
}

/// Whoever reads its log may end first, as behind a pipe: what cannot be told then is no reason to fail or to go on.
#[tokio::test(flavor = "multi_thread")]
async fn a_server_whose_log_nobody_reads_serves_and_stops() {
    let directory = tempfile::tempdir().unwrap();
    let ready = directory.path().join("ready.json");
    let mut command = Built::command("waypost-server");
    command.args(["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0", "--log", "debug"]);
    command.arg("--data-dir").arg(directory.path().join("data")).arg("--ready-file").arg(&ready);
    let mut server = command.stderr(Stdio::piped()).spawn().unwrap();
    let reader = server.stderr.take().unwrap();
    let began = Instant::now();
    while !ready.exists() {
        assert!(began.elapsed() < 6 * STOPPING, "it does not start");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    drop(reader);
    let addresses: serde_json::Value = serde_json::from_slice(&std::fs::read(&ready).unwrap()).unwrap();
    let http = addresses["http"].as_str().unwrap();
    for _ in 0..3 {
        let refused =
            crate::harness::http().get(format!("http://{http}/v1/maps/nowhere")).send().await.unwrap();
        assert_eq!(refused.status(), reqwest::StatusCode::NOT_FOUND);
    }
    rustix::process::kill_process(Pid::from_child(&server), Signal::TERM).unwrap();
    let asked = Instant::now();
    let status = loop {
        if let Some(status) = server.try_wait().unwrap() {
            break Some(status);
        }
        if asked.elapsed() > STOPPING {
            server.kill().unwrap();
            break None;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    assert!(status.is_some_and(|status| status.success()), "it does not stop: {status:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_that_never_says_what_it_wants_does_not_hold_it_up() {
    let mut running = running().await;
    let (silent, receiver) = mpsc::channel::<v1::StreamRequest>(1);
    let mut sessions = SessionServiceClient::new(channel(&running.server.endpoint()).await);
    let call = tokio::spawn(async move { sessions.stream(ReceiverStream::new(receiver)).await.map(drop) });
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(!call.is_finished());
    running.stops();
    assert!(in_time(call).await.unwrap().is_err());
    drop(silent);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_that_stands_still_does_not_hold_it_up() {
    let mut running = running().await;
    let (uploading, receiver) = mpsc::channel(4);
    let settings = v1::TrainModelSettings { words: 10, ..v1::TrainModelSettings::default() };
    uploading.send(v1::TrainModelRequest { content: Some(Content::Settings(settings)) }).await.unwrap();
    let image = Content::Image(images()[0].clone());
    uploading.send(v1::TrainModelRequest { content: Some(image) }).await.unwrap();
    let mut models = ModelServiceClient::new(channel(&running.server.endpoint()).await);
    let call = tokio::spawn(async move { models.train_model(ReceiverStream::new(receiver)).await.map(drop) });
    tokio::time::sleep(Duration::from_millis(500)).await;
    assert!(!call.is_finished());
    running.stops();
    assert!(in_time(call).await.unwrap().is_err());
    drop(uploading);
}

/// Connections that somebody opened and left, with what was sent over each.
#[tokio::test(flavor = "multi_thread")]
async fn connections_that_stand_still_do_not_hold_it_up() {
    let request = "GET /healthz HTTP/1.1\r\nHost: x\r\n";
    let whole = format!("{request}\r\n");
    let mut holding_up = Vec::new();
    for (case, sent, to_grpc) in [
        ("HTTP, silent", "", false),
        ("HTTP, half a request", request, false),
        ("HTTP, kept after an answer", &whole, false),
        ("gRPC, silent", "", true),
        ("gRPC, half a preface", "PRI * HTTP/2.0", true),
    ] {
        let mut running = running().await;
        let address = if to_grpc { running.server.grpc() } else { running.server.http() };
        let mut connection = TcpStream::connect(address).unwrap();
        connection.write_all(sent.as_bytes()).unwrap();
        if sent == whole {
            let mut answer = [0; 12];
            connection.read_exact(&mut answer).unwrap();
            assert_eq!(&answer, b"HTTP/1.1 200");
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
        if running.server.terminate(STOPPING).is_none() {
            holding_up.push(case);
        }
    }
    assert!(holding_up.is_empty(), "the server does not stop because of: {holding_up:?}");
}
