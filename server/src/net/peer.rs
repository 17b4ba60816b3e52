//! A connection to another server of the same fleet.

use std::future::Future;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use hyper::client::conn::http2::{Builder, SendRequest};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use rustls::ClientConfig;
use rustls::pki_types::{InvalidDnsNameError, ServerName};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;

/// Within which the other takes a connection.
const PATIENCE: Duration = Duration::from_secs(2);

/// A server that is gone without a word is noticed after two of these.
const KEEPALIVE: Duration = Duration::from_secs(5);

/// Answers that may be under way before they are taken: snapshots, pictures.
const STREAM_WINDOW_BYTES: u32 = 1 << 20;
const CONNECTION_WINDOW_BYTES: u32 = 4 << 20;

/// Why another server was not asked.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Unreachable {
    #[error("{0}")]
    Io(#[from] io::Error),
    #[error("it did not answer within {} s", PATIENCE.as_secs())]
    Late,
    #[error("{0}")]
    Http(#[from] hyper::Error),
    #[error("{0}")]
    Name(#[from] InvalidDnsNameError),
    #[error("the request cannot be passed on: {0}")]
    Request(#[from] http::Error),
}

/// Connects to `address`, host and port, over TLS if it is given how. The connection ends when nobody holds what is
/// returned any more, or when `until` completes.
pub(crate) async fn connect(
    address: &str,
    tls: Option<&Arc<ClientConfig>>,
    until: impl Future<Output = ()> + Send + 'static,
) -> Result<SendRequest<Body>, Unreachable> {
    let connecting = async {
        let stream = TcpStream::connect(address).await?;
        stream.set_nodelay(true)?;
        match tls {
            None => speak(stream, until).await,
            Some(config) => {
                let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
                let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
                let name = ServerName::try_from(host)?;
                speak(TlsConnector::from(config.clone()).connect(name, stream).await?, until).await
            }
        }
    };
    tokio::time::timeout(PATIENCE, connecting).await.map_err(|_elapsed| Unreachable::Late)?
}

async fn speak(
    stream: impl AsyncRead + AsyncWrite + Send + Unpin + 'static,
    until: impl Future<Output = ()> + Send + 'static,
) -> Result<SendRequest<Body>, Unreachable> {
    let (sender, connection) = Builder::new(TokioExecutor::new())
        .timer(TokioTimer::new())
        .keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE)
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .handshake(TokioIo::new(stream))
        .await?;
    tokio::spawn(async move {
        tokio::select! {
            ended = connection => {
                if let Err(error) = ended {
                    tracing::debug!(%error, "a connection to another server ended");
                }
            }
            () = until => {}
        }
    });
    Ok(sender)
}
