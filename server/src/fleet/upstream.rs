//! The way to the owner of the database.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use http::{Request, Response, Uri, Version, header, uri};
use hyper::body::Incoming;
use hyper::client::conn::http2::{Builder, SendRequest};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use rustls::ClientConfig;
use rustls::pki_types::ServerName;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::sync::{Mutex, watch};
use tokio_rustls::TlsConnector;

use crate::storage::Owner;

/// Within which the owner takes a connection.
const PATIENCE: Duration = Duration::from_secs(2);

/// An owner that is gone without a word is noticed after two of these, or when its lease has run out.
const KEEPALIVE: Duration = Duration::from_secs(5);

/// Answers that may be under way before they are taken: snapshots, pictures.
const STREAM_WINDOW_BYTES: u32 = 1 << 20;
const CONNECTION_WINDOW_BYTES: u32 = 4 << 20;

/// What of a request is about its connection alone, RFC 9113 section 8.2.2.
const OF_THE_CONNECTION: [header::HeaderName; 4] =
    [header::CONNECTION, header::PROXY_AUTHENTICATE, header::TRANSFER_ENCODING, header::UPGRADE];

/// One connection to the owner for each that comes in: what the owner grants to a connection, everyone has.
#[derive(Debug, Default)]
pub(super) struct Upstream(Mutex<Option<(i64, SendRequest<Body>)>>);

/// Why the owner was not asked.
#[derive(Debug, thiserror::Error)]
pub(super) enum Unreachable {
    #[error("{0}")]
    Io(#[from] io::Error),
    #[error("it did not answer within {} s", PATIENCE.as_secs())]
    Late,
    #[error("{0}")]
    Http(#[from] hyper::Error),
    #[error("{0}")]
    Name(#[from] rustls::pki_types::InvalidDnsNameError),
    #[error("the request cannot be passed on: {0}")]
    Request(#[from] http::Error),
}

/// How the owner is reached.
#[derive(Clone, Debug)]
pub(super) struct Way {
    pub(super) owner: watch::Receiver<Option<Owner>>,
    pub(super) tls: Option<Arc<ClientConfig>>,
}

impl Upstream {
    /// Asks `owner` at `address`, host and port.
    pub(super) async fn ask(
        &self,
        way: &Way,
        (owner, address): (&Owner, &str),
        request: Request<Body>,
    ) -> Result<Response<Incoming>, Unreachable> {
        let request = for_connection(request, way.tls.is_some(), address)?;
        let mut sender = self.sender(way, owner.epoch, address).await?;
        match sender.try_send_request(request).await {
            Ok(response) => Ok(response),
            Err(mut failed) => match failed.take_message() {
                // The connection ended just now, and nothing was sent.
                Some(request) => {
                    self.0.lock().await.take();
                    let mut sender = self.sender(way, owner.epoch, address).await?;
                    Ok(sender.send_request(request).await?)
                }
                None => Err(failed.into_error().into()),
            },
        }
    }

    async fn sender(&self, way: &Way, epoch: i64, address: &str) -> Result<SendRequest<Body>, Unreachable> {
        let mut known = self.0.lock().await;
        if let Some((of, sender)) = &*known
            && *of == epoch
            && !sender.is_closed()
        {
            return Ok(sender.clone());
        }
        let connecting = connect(way, epoch, address);
        let sender = tokio::time::timeout(PATIENCE, connecting).await.map_err(|_| Unreachable::Late)??;
        *known = Some((epoch, sender.clone()));
        Ok(sender)
    }
}

async fn connect(way: &Way, epoch: i64, address: &str) -> Result<SendRequest<Body>, Unreachable> {
    let stream = TcpStream::connect(address).await?;
    stream.set_nodelay(true)?;
    match &way.tls {
        None => speak(way, epoch, stream).await,
        Some(config) => {
            let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
            let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
            let encrypted = TlsConnector::from(config.clone()).connect(ServerName::try_from(host)?, stream);
            speak(way, epoch, encrypted.await?).await
        }
    }
}

async fn speak(
    way: &Way,
    epoch: i64,
    stream: impl AsyncRead + AsyncWrite + Send + Unpin + 'static,
) -> Result<SendRequest<Body>, Unreachable> {
    let (sender, connection) = Builder::new(TokioExecutor::new())
        .timer(TokioTimer::new())
        .keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE)
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .handshake(TokioIo::new(stream))
        .await?;
    let mut owner = way.owner.clone();
    tokio::spawn(async move {
        tokio::select! {
            ended = connection => {
                if let Err(error) = ended {
                    tracing::debug!(%error, "the connection to the owner of the database ended");
                }
            }
            // Whoever still waits for that one is told at once.
            _ = owner.wait_for(|owner| owner.as_ref().is_none_or(|owner| owner.epoch != epoch)) => {}
        }
    });
    Ok(sender)
}

/// The same request, as it is sent over a connection of HTTP/2. What it was addressed to stays.
fn for_connection(
    request: Request<Body>,
    encrypted: bool,
    address: &str,
) -> Result<Request<Body>, http::Error> {
    let (mut parts, body) = request.into_parts();
    let named = parts.headers.get(header::HOST).and_then(|host| host.to_str().ok()?.parse().ok());
    let authority: uri::Authority = match parts.uri.authority().cloned().or(named) {
        Some(authority) => authority,
        None => address.parse()?,
    };
    parts.uri = Uri::builder()
        .scheme(if encrypted { "https" } else { "http" })
        .authority(authority)
        .path_and_query(parts.uri.path_and_query().map_or("/", |path| path.as_str()))
        .build()?;
    for name in OF_THE_CONNECTION {
        parts.headers.remove(name);
    }
    parts.version = Version::HTTP_2;
    Ok(Request::from_parts(parts, body))
}
