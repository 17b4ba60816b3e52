//! The connection to a server that calls, sessions and navigations share.

use std::time::Duration;

use futures::future::BoxFuture;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint};
use tonic::{Response, Status};
use waypost_proto::v1::appearance_service_client::AppearanceServiceClient;
use waypost_proto::v1::cluster_service_client::ClusterServiceClient;
use waypost_proto::v1::correction_service_client::CorrectionServiceClient;
use waypost_proto::v1::event_service_client::EventServiceClient;
use waypost_proto::v1::job_service_client::JobServiceClient;
use waypost_proto::v1::label_service_client::LabelServiceClient;
use waypost_proto::v1::map_service_client::MapServiceClient;
use waypost_proto::v1::merge_service_client::MergeServiceClient;
use waypost_proto::v1::model_service_client::ModelServiceClient;
use waypost_proto::v1::navigation_service_client::NavigationServiceClient;
use waypost_proto::v1::recognition_service_client::RecognitionServiceClient;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::token_service_client::TokenServiceClient;

use crate::MAX_IMAGE_BYTES;
use crate::error::{Error, innermost};
use crate::options::{Bearer, ClientOptions};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// A peer that disappeared is noticed after the interval and the timeout.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(10);
const KEEP_ALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// An image, and 64 KiB for everything else.
pub(crate) const MAX_REQUEST_BYTES: usize = MAX_IMAGE_BYTES + (64 << 10);
/// A page of places is the longest answer: 100 places with 100 frames each, about 2 MiB.
const MAX_ANSWER_BYTES: usize = 16 << 20;
pub(crate) const PAGE_SIZE: u32 = 100;

/// A connection with the token that goes with every call.
pub(crate) type Transport = InterceptedService<Channel, Bearer>;

/// A call that is made when it is awaited: what the server answers, or why there is no answer.
///
/// It comes boxed: the work of an `async fn` would be compiled in each program that awaits it.
pub type Call<'a, T> = BoxFuture<'a, Result<T, Error>>;

/// A connection to a server. Cheap to clone: clones share the connection. After it broke, the next
/// call connects again.
#[derive(Clone, Debug)]
pub struct Client {
    transport: Transport,
    endpoint: String,
}

impl Client {
    /// Connects to a server, by its address or with [`ClientOptions`].
    ///
    /// # Errors
    /// [`Error::Endpoint`] if the address is invalid, [`Error::Options`] if the token or the
    /// certificates are, [`Error::Connection`] if no server answers there.
    pub async fn connect(options: impl Into<ClientOptions>) -> Result<Self, Error> {
        let options = options.into();
        let endpoint = configured(&options)?;
        let channel = endpoint
            .connect()
            .await
            .map_err(|error| Error::Connection { endpoint: options.address(), reason: innermost(&error) })?;
        Self::over(channel, &options)
    }

    /// A client that connects at its first call, for robots that may start before the server.
    /// Must be called within a Tokio runtime.
    ///
    /// # Errors
    /// [`Error::Endpoint`] if the address is invalid, [`Error::Options`] if the token or the
    /// certificates are.
    pub fn lazy(options: impl Into<ClientOptions>) -> Result<Self, Error> {
        let options = options.into();
        let channel = configured(&options)?.connect_lazy();
        Self::over(channel, &options)
    }

    fn over(channel: Channel, options: &ClientOptions) -> Result<Self, Error> {
        let transport = InterceptedService::new(channel, options.bearer()?);
        Ok(Self { transport, endpoint: options.address() })
    }

    /// Fetches all pages of a list. `page` is no `AsyncFn`, so that calls can be spawned.
    pub(crate) async fn all_pages<T, P>(&self, page: impl Fn(String) -> P) -> Result<Vec<T>, Error>
    where
        P: Future<Output = Result<(Vec<T>, String), Status>>,
    {
        let mut all = Vec::new();
        let mut page_token = String::new();
        loop {
            let (mut items, next) = self.met(page(page_token).await)?;
            all.append(&mut items);
            if next.is_empty() {
                return Ok(all);
            }
            page_token = next;
        }
    }

    pub(crate) fn taken<T>(&self, response: Result<Response<T>, Status>) -> Result<T, Error> {
        self.met(response.map(Response::into_inner))
    }

    pub(crate) fn met<T>(&self, result: Result<T, Status>) -> Result<T, Error> {
        result.map_err(|status| Error::from_status(&status, &self.endpoint))
    }

    pub(crate) fn endpoint(&self) -> &str {
        &self.endpoint
    }
}

/// A method for the stub of each service, with the limits of this client.
macro_rules! stubs {
    ($($method:ident: $stub:ident),+ $(,)?) => {
        impl Client {
            $(pub(crate) fn $method(&self) -> $stub<Transport> {
                $stub::new(self.transport.clone())
                    .max_encoding_message_size(MAX_REQUEST_BYTES)
                    .max_decoding_message_size(MAX_ANSWER_BYTES)
            })+
        }
    };
}

stubs! {
    appearance_client: AppearanceServiceClient,
    cluster_client: ClusterServiceClient,
    corrections_client: CorrectionServiceClient,
    events_client: EventServiceClient,
    jobs_client: JobServiceClient,
    labels_client: LabelServiceClient,
    maps_client: MapServiceClient,
    merges_client: MergeServiceClient,
    models_client: ModelServiceClient,
    navigations_client: NavigationServiceClient,
    recognition_client: RecognitionServiceClient,
    sessions_client: SessionServiceClient,
    tokens_client: TokenServiceClient,
}

/// The resource name `maps/{map}` of a map given with or without its collection.
pub(crate) fn map_name(map: &str) -> String {
    if map.starts_with("maps/") { map.to_owned() } else { format!("maps/{map}") }
}

fn configured(options: &ClientOptions) -> Result<Endpoint, Error> {
    let refused = |reason: String| Error::Endpoint { endpoint: options.endpoint.clone(), reason };
    let mut configured =
        Endpoint::from_shared(options.address()).map_err(|error| refused(innermost(&error)))?;
    match configured.uri().scheme_str() {
        Some("http") => options.check_plain()?,
        Some("https") => {
            let unusable =
                |error| Error::Options(format!("the certificates cannot be used: {}", innermost(&error)));
            configured = configured.tls_config(options.tls()?).map_err(unusable)?;
        }
        Some(other) => return Err(refused(format!("the scheme `{other}` is not served"))),
        None => return Err(refused("it lacks a scheme".to_owned())),
    }
    configured
        .connect_timeout(CONNECT_TIMEOUT)
        .tcp_nodelay(true)
        .http2_keep_alive_interval(KEEP_ALIVE_INTERVAL)
        .keep_alive_timeout(KEEP_ALIVE_TIMEOUT)
        .user_agent(concat!("waypost-client/", env!("CARGO_PKG_VERSION")))
        .map_err(|error| refused(innermost(&error)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_named_with_or_without_its_collection() {
        assert_eq!(map_name("office"), "maps/office");
        assert_eq!(map_name("maps/office"), "maps/office");
    }

    #[test]
    fn addresses_that_no_client_can_use_are_refused() {
        for endpoint in ["", "a b:7600", "ftp://127.0.0.1:7600", "http://", "http://a b"] {
            let refused = configured(&endpoint.into());
            assert!(matches!(refused, Err(Error::Endpoint { .. })), "{endpoint:?}: {refused:?}");
        }
        assert!(configured(&"http://127.0.0.1:7600".into()).is_ok());
    }

    /// Encrypted if anything for it is given, as in Python.
    #[test]
    fn an_address_without_a_scheme_is_one() {
        let plain = ClientOptions::new("127.0.0.1:7600");
        assert_eq!(configured(&plain).unwrap().uri().to_string(), "http://127.0.0.1:7600/");
        assert_eq!(plain.with_ca("of ours").address(), "https://127.0.0.1:7600");
    }
}
