//! The way to the owner of the database.

use std::sync::Arc;

use axum::body::Body;
use http::{Request, Response, Uri, Version, header, uri};
use hyper::body::Incoming;
use hyper::client::conn::http2::SendRequest;
use rustls::ClientConfig;
use tokio::sync::{Mutex, watch};

use crate::net::peer::{self, Unreachable};
use crate::storage::Owner;

/// What of a request is about its connection alone, RFC 9113 section 8.2.2.
const OF_THE_CONNECTION: [header::HeaderName; 5] = [
    header::CONNECTION,
    header::EXPECT,
    header::PROXY_AUTHENTICATE,
    header::TRANSFER_ENCODING,
    header::UPGRADE,
];

/// One connection to the owner for each that comes in: what the owner grants to a connection, everyone has.
#[derive(Debug, Default)]
pub(super) struct Upstream(Mutex<Option<(i64, SendRequest<Body>)>>);

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
        let mut owner = way.owner.clone();
        // Whoever still waits for that one is told at once.
        let until = async move {
            let is_another = |owner: &Option<Owner>| owner.as_ref().is_none_or(|owner| owner.epoch != epoch);
            let _ended = owner.wait_for(is_another).await;
        };
        let sender = peer::connect(address, way.tls.as_ref(), until).await?;
        *known = Some((epoch, sender.clone()));
        Ok(sender)
    }
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
