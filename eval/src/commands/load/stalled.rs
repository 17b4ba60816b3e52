//! Clients that send and do not read.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::interval;
use tonic::Streaming;
use waypost_proto::v1;
use waypost_proto::v1::stream_request::Content as Request;

use super::contents::Contents;
use super::robot::{connection, open_stream, wire};
use super::server::MAP;

/// Bytes of answers that a stalled client takes all the same: a few answers.
const WINDOW_BYTES: u32 = 1 << 10;

/// Sends frames at a robot's rate for as long as the server takes them, and reads none of its answers.
pub(super) struct StalledStream {
    /// Held and never asked: the answers pile up until flow control stops the server.
    _responses: Streaming<v1::StreamResponse>,
    sending: JoinHandle<()>,
}

impl StalledStream {
    /// Opens the session like any robot, and then falls silent.
    pub(super) async fn open(
        endpoint: &str,
        session: &str,
        contents: &Arc<Contents>,
        rate_hz: f64,
    ) -> Result<Self> {
        let connection = connection(endpoint)?.initial_stream_window_size(WINDOW_BYTES);
        let (requests, responses) = open_stream(connection, (MAP, session), &contents.words_hash).await?;
        let contents = contents.clone();
        let mut pace = interval(Duration::from_secs_f64(1.0 / rate_hz));
        let sending = tokio::spawn(async move {
            for (sequence, content) in (1..).zip(contents.frames.iter().cycle()) {
                pace.tick().await;
                let frame = Request::Frame(wire(sequence, sequence as i64, content.clone()));
                if requests.send(v1::StreamRequest { content: Some(frame) }).await.is_err() {
                    return;
                }
            }
        });
        Ok(Self { _responses: responses, sending })
    }
}

impl Drop for StalledStream {
    fn drop(&mut self) {
        self.sending.abort();
    }
}

/// A client whose network does not read: not even its HTTP/2 hears of the server.
pub(super) struct StalledConnection {
    _stream: StalledStream,
    forwarding: JoinHandle<()>,
}

impl StalledConnection {
    /// Opens the session through a forwarder that then stops reading from the server.
    pub(super) async fn open(
        server: &str,
        session: &str,
        contents: &Arc<Contents>,
        rate_hz: f64,
    ) -> Result<Self> {
        let listener =
            TcpListener::bind("127.0.0.1:0").await.context("no connection on the loopback interface")?;
        let address = listener.local_addr().context("no connection on the loopback interface")?;
        let (deafen, deaf) = oneshot::channel();
        let server = server.to_owned();
        // An error ends the connection, which its robot would notice.
        let forwarding = tokio::spawn(async move { drop(forward(listener, &server, deaf).await) });
        let stream = StalledStream::open(&format!("http://{address}"), session, contents, rate_hz).await?;
        // The forwarder is there for as long as the connection.
        let _ = deafen.send(());
        Ok(Self { _stream: stream, forwarding })
    }
}

impl Drop for StalledConnection {
    fn drop(&mut self) {
        self.forwarding.abort();
    }
}

/// Forwards one connection; what the server says only until it is `deaf`.
async fn forward(
    listener: TcpListener,
    server: &str,
    mut deaf: oneshot::Receiver<()>,
) -> std::io::Result<()> {
    let (near, _) = listener.accept().await?;
    let (mut from_robot, mut to_robot) = near.into_split();
    let (mut from_server, mut to_server) = TcpStream::connect(server).await?.into_split();
    let upwards = async move { tokio::io::copy(&mut from_robot, &mut to_server).await.map(drop) };
    let downwards = async move {
        let mut buffer = vec![0; 16 << 10];
        loop {
            tokio::select! {
                read = from_server.read(&mut buffer) => match read? {
                    0 => return Ok(()),
                    length => to_robot.write_all(&buffer[..length]).await?,
                },
                // Both halves stay open, and nobody reads.
                _ = &mut deaf => std::future::pending().await,
            }
        }
    };
    tokio::try_join!(upwards, downwards).map(drop)
}
