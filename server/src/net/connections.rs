//! Connections as they come in at a port: how many there may be, and that each begins to speak.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Arc, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum_server::{AddrListener, Address};
use bytes::{Buf, Bytes, BytesMut};
use futures::Stream;
use rustls::ServerConfig;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Mutex, mpsc};
use tokio::task::JoinSet;
use tokio::time::Sleep;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_util::sync::WaitForCancellationFutureOwned;
use tokio_util::task::AbortOnDropHandle;
use tonic::transport::server::Connected;

use super::complaint::Complaint;
use super::standing::{Place, Standing, Standings, Strangers};

/// How an HTTP/2 client begins, RFC 9113 section 3.4.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// Connections that have spoken and wait to be served.
const QUEUE: usize = 16;

/// Until the system is asked again that had no room for a connection: asking at once would take a core.
const RETRY: Duration = Duration::from_millis(200);

/// A stranger that says more than this means no good: a call without a token is a few hundred bytes.
const MUCH_OF_A_STRANGER: u64 = 64 << 10;

/// What a port takes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Connections open at a time; strangers are cut to make room for further ones.
    pub(crate) connections: usize,
    /// Of these, as many as strangers can always have: to ask how the server is, or to show a token.
    pub(crate) kept_for_strangers: usize,
    /// Within which a client must have finished the TLS handshake and sent its first byte, and, if that begins
    /// the preface of HTTP/2, all of the preface.
    pub(crate) patience: Duration,
}

/// Connections at one port that have begun to speak.
#[derive(Debug)]
pub(crate) struct Connections {
    at: SocketAddr,
    ready: Mutex<mpsc::Receiver<Connection>>,
    _accepting: AbortOnDropHandle<()>,
}

impl Connections {
    /// Takes connections at `listener`, over TLS if there is a configuration, until this is dropped.
    pub(crate) fn at(
        listener: TcpListener,
        tls: Option<Arc<ServerConfig>>,
        limits: Limits,
        strangers: Strangers,
    ) -> io::Result<Self> {
        let at = listener.local_addr()?;
        let (sender, ready) = mpsc::channel(QUEUE);
        let standings = Standings::new(limits.connections, limits.kept_for_strangers, strangers);
        let (tls, complaint) = (tls.map(TlsAcceptor::from), Arc::default());
        let opening = Opening { tls, patience: limits.patience, ready: sender, complaint };
        let accepting = tokio::spawn(accept(listener, standings, opening));
        Ok(Self { at, ready: Mutex::new(ready), _accepting: AbortOnDropHandle::new(accepting) })
    }
}

/// How a connection is taken from its first byte to who serves it. Cheap to clone.
#[derive(Clone)]
struct Opening {
    tls: Option<TlsAcceptor>,
    patience: Duration,
    ready: mpsc::Sender<Connection>,
    /// About strangers of the port.
    complaint: Arc<std::sync::Mutex<Complaint>>,
}

async fn accept(listener: TcpListener, standings: Standings, opening: Opening) {
    let mut connections = JoinSet::new();
    let mut complaint = Complaint::default();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = connections.join_next() => continue,
        };
        match accepted {
            Ok((stream, from)) => match standings.enter(from.ip().to_canonical()) {
                Some(place) => {
                    connections.spawn(opening.clone().take(stream, place));
                }
                None if complaint.count().is_some() => tracing::warn!(
                    %from,
                    "no more connections are taken: as many are open as may be; further ones are closed at once"
                ),
                None => {}
            },
            Err(error) if is_of_one_connection(&error) => {}
            Err(error) => {
                if complaint.count().is_some() {
                    tracing::error!(
                        %error,
                        "connections cannot be taken; if too many files are open, raise the limit (ulimit -n)"
                    );
                }
                tokio::time::sleep(RETRY).await;
            }
        }
    }
}

impl Opening {
    /// Waits until the client has begun to speak, and hands the connection on.
    async fn take(self, stream: TcpStream, place: Place) {
        let from = place.standing().peer();
        let cut = place.cut().clone();
        let opened = tokio::select! {
            opened = tokio::time::timeout(self.patience, open(stream, self.tls, place, self.complaint)) => opened,
            () = cut.cancelled() => return tracing::debug!(%from, "a connection made room for another"),
        };
        match opened {
            // An error means that the server stops.
            Ok(Ok(connection)) => drop(self.ready.send(connection).await),
            Ok(Err(error)) => tracing::debug!(%from, %error, "a connection was not opened"),
            Err(_) => tracing::debug!(%from, "a connection was silent, and is cut"),
        }
    }
}

/// Whether the client gave up before it was its turn; the next one has nothing to do with it.
fn is_of_one_connection(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

async fn open(
    stream: TcpStream,
    tls: Option<TlsAcceptor>,
    place: Place,
    complaint: Arc<std::sync::Mutex<Complaint>>,
) -> io::Result<Connection> {
    // Answers are small and come in bursts: none is to wait until the one before it is acknowledged.
    stream.set_nodelay(true)?;
    let mut wire = match tls {
        Some(tls) => Wire::Encrypted(Box::new(tls.accept(stream).await?)),
        None => Wire::Plain(stream),
    };
    let mut head = BytesMut::with_capacity(PREFACE.len());
    while !has_begun(&head) {
        if wire.stream().read_buf(&mut head).await? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
    }
    Ok(Connection::new(head.freeze(), wire, place, complaint))
}

/// Whether it can be told which version of HTTP is spoken: what serves it sees to the rest.
fn has_begun(head: &[u8]) -> bool {
    !head.is_empty() && (head.starts_with(PREFACE) || !PREFACE.starts_with(head))
}

/// A connection on which the client has begun to speak.
#[derive(Debug)]
pub(crate) struct Connection {
    /// What was read to see that.
    head: Bytes,
    wire: Wire,
    end: End,
    /// Given back when the connection is closed.
    place: Place,
    cut: Pin<Box<WaitForCancellationFutureOwned>>,
    /// Until it is asked whether the connection may stay.
    review: Pin<Box<Sleep>>,
}

impl Connection {
    fn new(head: Bytes, wire: Wire, place: Place, complaint: Arc<std::sync::Mutex<Complaint>>) -> Self {
        let cut = Box::pin(place.cut().clone().cancelled_owned());
        let review = Box::pin(tokio::time::sleep(place.review().unwrap_or_default()));
        let (standing, since) = (place.standing().clone(), Instant::now());
        let end = End { standing, since, heard_bytes: head.len() as u64, is_overdue: false, complaint };
        Self { head, wire, end, place, cut, review }
    }

    /// An error once the connection is to be closed: it made room for another, or nobody on it was admitted in time.
    fn poll_stay(&mut self, context: &mut Context<'_>) -> io::Result<()> {
        if self.cut.as_mut().poll(context).is_ready() {
            return Err(io::ErrorKind::ConnectionAborted.into());
        }
        while self.review.as_mut().poll(context).is_ready() {
            let Some(next) = self.place.review() else {
                self.end.is_overdue = true;
                return Err(io::ErrorKind::ConnectionAborted.into());
            };
            self.review.as_mut().reset(tokio::time::Instant::now() + next);
        }
        Ok(())
    }
}

/// Says of a stranger's connection, when it is closed, that it was open for too long or said too much: who runs the server has
/// to know where that comes from.
#[derive(Debug)]
struct End {
    standing: Standing,
    since: Instant,
    heard_bytes: u64,
    is_overdue: bool,
    complaint: Arc<std::sync::Mutex<Complaint>>,
}

impl Drop for End {
    fn drop(&mut self) {
        let is_to_be_told = self.is_overdue || self.heard_bytes > MUCH_OF_A_STRANGER;
        if !is_to_be_told || self.standing.is_admitted() {
            return;
        }
        let mut complaint = self.complaint.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(untold) = complaint.count() {
            tracing::info!(
                peer = %self.standing.peer(),
                open_s = self.since.elapsed().as_secs(),
                heard_bytes = self.heard_bytes,
                further = untold,
                "a connection without an admitted call was closed; `further` ones were since the last that was told of"
            );
        }
    }
}

#[derive(Debug)]
enum Wire {
    Plain(TcpStream),
    Encrypted(Box<TlsStream<TcpStream>>),
}

trait Duplex: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Duplex for T {}

impl Wire {
    fn stream(&mut self) -> &mut dyn Duplex {
        match self {
            Wire::Plain(stream) => stream,
            Wire::Encrypted(stream) => stream,
        }
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.poll_stay(context)?;
        if self.head.is_empty() {
            let before = buffer.filled().len();
            let read = Pin::new(self.wire.stream()).poll_read(context, buffer);
            self.end.heard_bytes += (buffer.filled().len() - before) as u64;
            return read;
        }
        let taken = self.head.len().min(buffer.remaining());
        buffer.put_slice(&self.head[..taken]);
        self.head.advance(taken);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.poll_stay(context)?;
        Pin::new(self.wire.stream()).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.poll_stay(context)?;
        Pin::new(self.wire.stream()).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        match &self.wire {
            Wire::Plain(stream) => stream.is_write_vectored(),
            Wire::Encrypted(stream) => stream.is_write_vectored(),
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.poll_stay(context)?;
        Pin::new(self.wire.stream()).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(self.wire.stream()).poll_shutdown(context)
    }
}

/// For tonic.
impl Connected for Connection {
    type ConnectInfo = Standing;

    fn connect_info(&self) -> Standing {
        self.place.standing().clone()
    }
}

/// For tonic.
impl Stream for Connections {
    type Item = io::Result<Connection>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.ready.get_mut().poll_recv(context).map(|connection| connection.map(Ok))
    }
}

/// For axum-server: an address at which [`Connections`] come in, and who came.
#[derive(Clone, Debug)]
pub(crate) struct Port(SocketAddr, Option<Standing>);

/// For axum: what calls know of their connection.
#[derive(Clone, Debug)]
pub(crate) struct Came(pub(crate) Option<Standing>);

impl axum::extract::connect_info::Connected<Port> for Came {
    fn connect_info(Port(_, standing): Port) -> Self {
        Self(standing)
    }
}

impl Address for Port {
    type Stream = Connection;
    type Listener = Connections;
}

impl AddrListener<Connection, Port> for Connections {
    async fn bind_to(Port(address, _): Port) -> io::Result<Self> {
        Err(io::Error::new(io::ErrorKind::Unsupported, format!("{address} is bound by who asks to serve")))
    }

    async fn accept_stream(&self) -> io::Result<(Connection, Port)> {
        match self.ready.lock().await.recv().await {
            Some(connection) => {
                let standing = connection.place.standing().clone();
                Ok((connection, Port(self.at, Some(standing))))
            }
            // What accepts has ended: none will come.
            None => std::future::pending().await,
        }
    }

    fn get_local_addr(&self) -> io::Result<Port> {
        Ok(Port(self.at, None))
    }
}

#[cfg(test)]
mod tests;
