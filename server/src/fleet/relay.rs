//! What a server does with what it is asked while another owns the database: it asks that one.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::connect_info::Connected;
use axum::extract::{ConnectInfo, Request, State};
use axum::response::{IntoResponse, Response};
use axum_server::Handle;
use http::{Method, StatusCode, header};
use hyper::body::Incoming;
use prost::Message;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use tonic::{Code, Status};

use super::Ports;
use super::carried::{CarriedAnswer, CarriedCall};
use super::upstream::{Upstream, Way};
use crate::error::ServiceError;
use crate::http::HttpError;
use crate::ingest::helping::Helping;
use crate::ingest::looking::{self, Look, Seen};
use crate::memory::process_levels;
use crate::metrics::{Forwarding, Metrics};
use crate::net::connections::{Came, Connections, Port};
use crate::net::messages::MAX_MESSAGE_BYTES;
use crate::net::neighbours::{self, Neighbours};
use crate::net::peer::Unreachable;
use crate::net::standing::{Admission, Standing};
use crate::net::tls::Tls;
use crate::storage::Owner;

/// After which a client tries again that nobody could serve.
const RETRY: Duration = Duration::from_secs(1);

/// How long is waited until it is known who owns the database: just after a start, for a moment.
const PATIENCE: Duration = Duration::from_secs(2);

/// Both ports of a server in reserve.
#[derive(Clone, Debug)]
pub(super) struct Relay {
    way: Way,
    /// What it does for the owner.
    helping: Helping,
    metrics: Metrics,
    /// Cancelled when this ends, and with it all that came over it.
    over: CancellationToken,
}

/// Which language is spoken at a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Language {
    Grpc,
    Rest,
}

#[derive(Clone)]
struct Door {
    relay: Relay,
    language: Language,
}

/// Who is at the other end of a connection, and its way to the owner.
#[derive(Clone, Debug)]
struct Visitor {
    standing: Option<Standing>,
    upstream: Arc<Upstream>,
}

impl Connected<Port> for Visitor {
    fn connect_info(port: Port) -> Self {
        let Came(standing) = Came::connect_info(port);
        Self { standing, upstream: Arc::default() }
    }
}

/// Cuts all connections when it is dropped.
struct CutAtEnd(Handle<Port>);

impl Drop for CutAtEnd {
    fn drop(&mut self) {
        self.0.shutdown();
    }
}

impl Relay {
    /// `database` is the address that models are read from.
    pub(super) fn new(
        owner: watch::Receiver<Option<Owner>>,
        database: &str,
        tls: Option<&Tls>,
        metrics: Metrics,
    ) -> Self {
        let way = Way { owner, tls: tls.map(|tls| tls.neighbours.clone()) };
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self { way, helping: Helping::new(database, cores), metrics, over: CancellationToken::new() }
    }

    /// Serves both ports until this is dropped.
    pub(super) async fn serve(
        self,
        grpc: TcpListener,
        http: TcpListener,
        ports: &Ports,
    ) -> anyhow::Result<()> {
        let _over = self.over.clone().drop_guard();
        let tls = ports.tls.as_ref();
        let grpc_tls = tls.map(|tls| tls.grpc.clone());
        let http_tls = tls.map(|tls| tls.http.clone());
        let calls = Connections::at(grpc, grpc_tls, crate::grpc::LIMITS, ports.strangers)?;
        let requests = Connections::at(http, http_tls, crate::http::LIMITS, ports.strangers)?;
        tokio::try_join!(self.serve_at(calls, Language::Grpc), self.serve_at(requests, Language::Rest))?;
        Ok(())
    }

    async fn serve_at(&self, connections: Connections, language: Language) -> anyhow::Result<()> {
        let door = Door { relay: self.clone(), language };
        let routes = Router::new().fallback(ask).with_state(door);
        let handle: Handle<Port> = Handle::new();
        let _cut = CutAtEnd(handle.clone());
        let mut server = axum_server::Server::from_listener(connections).handle(handle);
        crate::http::limit(server.http_builder());
        if language == Language::Grpc {
            server.http_builder().http2().max_concurrent_streams(crate::grpc::MAX_STREAMS_PER_CONNECTION);
        }
        server.serve(routes.into_make_service_with_connect_info::<Visitor>()).await?;
        Ok(())
    }
}

/// Asks the owner what was asked here.
async fn ask(
    State(door): State<Door>,
    ConnectInfo(visitor): ConnectInfo<Visitor>,
    request: Request,
) -> Response {
    let path = request.uri().path().to_owned();
    if door.language == Language::Rest && path == "/healthz" {
        return "ok\n".into_response();
    }
    if door.language == Language::Rest && path == looking::PATH {
        return match door.look(&visitor, request).await {
            Ok(seen) => seen.encode_to_vec().into_response(),
            Err(error) => door.language.refusal(error),
        };
    }
    let own_metrics =
        door.language == Language::Rest && path == "/metrics" && request.method() == Method::GET;
    let forwarding = door.relay.metrics.forward(door.language.name());
    match door.ask_owner(&visitor, request).await {
        Ok(response) => {
            if !is_refused(&response)
                && door.language.admits(&path)
                && let Some(standing) = &visitor.standing
                && let Err(full) = standing.admit(door.relay.admission())
            {
                return door.language.refusal(full);
            }
            // The owner has said that they may be read.
            if own_metrics && response.status() == StatusCode::OK {
                let kind = [(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")];
                return (kind, door.relay.metrics.render_in_reserve(process_levels())).into_response();
            }
            door.language.carried(response, forwarding)
        }
        Err(error) => door.language.refusal(error),
    }
}

impl Relay {
    /// Which token it was the owner knows.
    fn admission(&self) -> Admission {
        Admission { token: None, deleted: self.over.clone() }
    }
}

impl Door {
    /// Looks at an image for the owner, and for nobody else.
    async fn look(&self, visitor: &Visitor, request: Request) -> Result<Seen, ServiceError> {
        let secret = self.relay.way.owner.borrow().as_ref().map(|owner| owner.secret.clone());
        if Neighbours::of(secret.as_deref()).on_behalf_of(request.headers()).is_none() {
            return Err(ServiceError::unauthenticated("this is for servers of the same database alone"));
        }
        if let Some(standing) = &visitor.standing {
            standing.admit(self.relay.admission())?;
        }
        let body = axum::body::to_bytes(request.into_body(), MAX_MESSAGE_BYTES).await;
        let look = Look::decode(body.map_err(ServiceError::invalid)?).map_err(ServiceError::invalid)?;
        self.relay.helping.look(look).await
    }

    async fn ask_owner(
        &self,
        visitor: &Visitor,
        mut request: Request,
    ) -> Result<Response<Incoming>, ServiceError> {
        let mut owner = self.relay.way.owner.clone();
        let known = tokio::time::timeout(PATIENCE, owner.wait_for(Option::is_some)).await;
        let Some(owner) = known.ok().and_then(Result::ok).and_then(|owner| owner.clone()) else {
            return Err(not_now("who owns the database is not known"));
        };
        let address = match self.language {
            Language::Grpc => &owner.addresses.grpc,
            Language::Rest => &owner.addresses.http,
        };
        if address.is_empty() {
            return Err(not_now(&format!("the database is worked on by a command ({})", owner.holder)));
        }
        // Two servers that take each other for the owner would ask each other for ever.
        if Neighbours::of(Some(&owner.secret)).on_behalf_of(request.headers()).is_some() {
            return Err(not_now("the database has just changed hands"));
        }
        let peer = visitor.standing.as_ref().map_or(Ipv4Addr::UNSPECIFIED.into(), Standing::peer);
        neighbours::tell(request.headers_mut(), IpAddr::to_canonical(&peer), &owner.secret);
        let asked = visitor.upstream.ask(&self.relay.way, (&owner, address), request).await;
        asked.map_err(|error| unreachable(&owner, address, &error))
    }
}

fn unreachable(owner: &Owner, address: &str, error: &Unreachable) -> ServiceError {
    tracing::warn!(owner = owner.holder, address, %error, "the owner of the database was not reached");
    not_now(&format!("the server that owns the database ({}, at {address}) was not reached", owner.holder))
}

fn not_now(why: &str) -> ServiceError {
    let message = format!("{why}; send this again in a moment, here or to another server");
    ServiceError::Unavailable { message, retry_after: Some(RETRY) }
}

/// Whether the owner does not serve who asked.
fn is_refused(response: &Response<Incoming>) -> bool {
    let status = Status::from_header_map(response.headers()).map(|status| status.code());
    matches!(status, Some(Code::Unauthenticated | Code::PermissionDenied))
        || [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN].contains(&response.status())
}

impl Language {
    fn name(self) -> &'static str {
        match self {
            Self::Grpc => "grpc",
            Self::Rest => "http",
        }
    }

    /// Whether a call shows who asks: not what everyone may ask.
    fn admits(self, path: &str) -> bool {
        match self {
            Self::Grpc => !path.starts_with("/grpc.health."),
            Self::Rest => path.starts_with("/v1/") || path == "/metrics",
        }
    }

    fn refusal(self, error: ServiceError) -> Response {
        match self {
            Self::Grpc => Status::from(error).into_http(),
            Self::Rest => HttpError::from(error).into_response(),
        }
    }

    fn carried(self, response: Response<Incoming>, forwarding: Forwarding) -> Response {
        response.map(|body| match self {
            Self::Grpc => Body::new(CarriedCall::new(body, forwarding)),
            Self::Rest => Body::new(CarriedAnswer::new(body, forwarding)),
        })
    }
}
