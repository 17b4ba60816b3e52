//! Connections as they come in at a port: how many there may be, and that each begins to speak.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum_server::{AddrListener, Address};
use bytes::{Buf, Bytes, BytesMut};
use futures::Stream;
use rustls::ServerConfig;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Mutex, OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::task::JoinSet;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_util::task::AbortOnDropHandle;
use tonic::transport::server::Connected;

/// How an HTTP/2 client begins, RFC 9113 section 3.4.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// Connections that have spoken and wait to be served.
const QUEUE: usize = 16;

/// Until the system is asked again that had no room for a connection: asking at once would take a core.
const RETRY: Duration = Duration::from_millis(200);

/// A complaint is logged once in this time, however many connections give rise to it.
const COMPLAINT_INTERVAL: Duration = Duration::from_secs(10);

/// What a port takes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Connections open at a time; further ones are closed at once.
    pub(crate) connections: usize,
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
    ) -> io::Result<Self> {
        let at = listener.local_addr()?;
        let (sender, ready) = mpsc::channel(QUEUE);
        let accepting = tokio::spawn(accept(listener, tls.map(TlsAcceptor::from), limits, sender));
        Ok(Self { at, ready: Mutex::new(ready), _accepting: AbortOnDropHandle::new(accepting) })
    }
}

async fn accept(
    listener: TcpListener,
    tls: Option<TlsAcceptor>,
    limits: Limits,
    ready: mpsc::Sender<Connection>,
) {
    let room = Arc::new(Semaphore::new(limits.connections));
    let mut opening = JoinSet::new();
    let mut complaint = Complaint::default();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = opening.join_next() => continue,
        };
        match accepted {
            Ok((stream, from)) => match room.clone().try_acquire_owned() {
                Ok(room) => {
                    let tls = tls.clone();
                    let ready = ready.clone();
                    opening.spawn(async move {
                        match tokio::time::timeout(limits.patience, open(stream, tls, room)).await {
                            // An error means that the server stops.
                            Ok(Ok(connection)) => drop(ready.send(connection).await),
                            Ok(Err(error)) => tracing::debug!(%from, %error, "a connection was not opened"),
                            Err(_) => tracing::debug!(%from, "a connection was silent, and is cut"),
                        }
                    });
                }
                Err(_) if complaint.is_due() => tracing::warn!(
                    most = limits.connections,
                    %from,
                    "no more connections are taken: as many are open as may be; further ones are closed at once"
                ),
                Err(_) => {}
            },
            Err(error) if is_of_one_connection(&error) => {}
            Err(error) => {
                if complaint.is_due() {
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

/// Whether the client gave up before it was its turn; the next one has nothing to do with it.
fn is_of_one_connection(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

#[derive(Debug, Default)]
struct Complaint {
    last: Option<Instant>,
}

impl Complaint {
    fn is_due(&mut self) -> bool {
        let due = self.last.is_none_or(|last| last.elapsed() >= COMPLAINT_INTERVAL);
        if due {
            self.last = Some(Instant::now());
        }
        due
    }
}

async fn open(
    stream: TcpStream,
    tls: Option<TlsAcceptor>,
    room: OwnedSemaphorePermit,
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
    Ok(Connection { head: head.freeze(), wire, _room: room })
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
    /// Given back when the connection is closed.
    _room: OwnedSemaphorePermit,
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
        if self.head.is_empty() {
            return Pin::new(self.wire.stream()).poll_read(context, buffer);
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
        Pin::new(self.wire.stream()).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(self.wire.stream()).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        match &self.wire {
            Wire::Plain(stream) => stream.is_write_vectored(),
            Wire::Encrypted(stream) => stream.is_write_vectored(),
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(self.wire.stream()).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(self.wire.stream()).poll_shutdown(context)
    }
}

/// For tonic; nobody asks where a call comes from.
impl Connected for Connection {
    type ConnectInfo = ();

    fn connect_info(&self) {}
}

/// For tonic.
impl Stream for Connections {
    type Item = io::Result<Connection>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.ready.get_mut().poll_recv(context).map(|connection| connection.map(Ok))
    }
}

/// For axum-server: an address at which [`Connections`] come in.
#[derive(Clone, Debug)]
pub(crate) struct Port(SocketAddr);

impl Address for Port {
    type Stream = Connection;
    type Listener = Connections;
}

impl AddrListener<Connection, Port> for Connections {
    async fn bind_to(Port(address): Port) -> io::Result<Self> {
        Err(io::Error::new(io::ErrorKind::Unsupported, format!("{address} is bound by who asks to serve")))
    }

    async fn accept_stream(&self) -> io::Result<(Connection, Port)> {
        match self.ready.lock().await.recv().await {
            Some(connection) => Ok((connection, Port(self.at))),
            // What accepts has ended: none will come.
            None => std::future::pending().await,
        }
    }

    fn get_local_addr(&self) -> io::Result<Port> {
        Ok(Port(self.at))
    }
}

#[cfg(test)]
mod tests {
    use futures::StreamExt;
    use tokio::io::AsyncWriteExt;

    use super::*;

    const PATIENT: Limits = Limits { connections: 2, patience: Duration::from_secs(60) };
    const HASTY: Limits = Limits { connections: 2, patience: Duration::from_millis(50) };

    async fn port(limits: Limits) -> Connections {
        Connections::at(TcpListener::bind("127.0.0.1:0").await.unwrap(), None, limits).unwrap()
    }

    async fn client(connections: &Connections, says: &[u8]) -> TcpStream {
        let mut stream = TcpStream::connect(connections.at).await.unwrap();
        stream.write_all(says).await.unwrap();
        stream
    }

    /// Whether the server closes it, once it may have done so.
    async fn is_closed(mut stream: TcpStream) -> bool {
        let read = tokio::time::timeout(Duration::from_secs(30), stream.read_u8()).await;
        read.is_ok_and(|read| read.is_err())
    }

    #[tokio::test]
    async fn answers_do_not_wait_for_the_acknowledgement_of_those_before() {
        let mut connections = port(PATIENT).await;
        let _client = client(&connections, PREFACE).await;
        let Connection { wire, .. } = connections.next().await.unwrap().unwrap();
        assert!(matches!(wire, Wire::Plain(stream) if stream.nodelay().unwrap()));
    }

    #[tokio::test]
    async fn nothing_that_was_said_is_lost() {
        let mut connections = port(PATIENT).await;
        for said in [PREFACE, b"G", b"PUT / HTTP/1.1\r\nHost: a\r\n\r\n", &[PREFACE, b"\0\0\0"].concat()] {
            let mut client = client(&connections, said).await;
            let mut connection = connections.next().await.unwrap().unwrap();
            client.write_all(b" and more").await.unwrap();
            let mut heard = vec![0; said.len() + 9];
            connection.read_exact(&mut heard).await.unwrap();
            assert_eq!(heard, [said, b" and more"].concat());
            connection.write_all(b"!").await.unwrap();
            assert_eq!(client.read_u8().await.unwrap(), b'!');
        }
    }

    #[tokio::test]
    async fn who_says_nothing_or_half_of_it_is_cut() {
        let mut connections = port(HASTY).await;
        for said in [&b""[..], b"P", &PREFACE[..PREFACE.len() - 1]] {
            assert!(is_closed(client(&connections, said).await).await, "{said:?}");
        }
        let _client = client(&connections, PREFACE).await;
        assert!(connections.next().await.unwrap().is_ok());
    }

    #[tokio::test]
    async fn there_are_only_so_many() {
        let mut connections = port(PATIENT).await;
        let _clients = [client(&connections, b"GET").await, client(&connections, b"GET").await];
        let first = connections.next().await.unwrap().unwrap();
        let _second = connections.next().await.unwrap().unwrap();
        // It may be closed before it has said anything.
        assert!(is_closed(TcpStream::connect(connections.at).await.unwrap()).await);
        drop(first);
        let _third = client(&connections, b"GET").await;
        assert!(connections.next().await.unwrap().is_ok());
    }
}
