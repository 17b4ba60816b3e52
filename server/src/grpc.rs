//! gRPC: `waypost.v1` spoken over the service layer. Conversions here, decisions there.

mod access;
mod appearance;
mod cluster;
mod corrections;
mod events;
mod jobs;
mod labels;
mod maps;
mod merges;
mod models;
mod navigation;
mod reach;
mod recognition;
mod requests;
mod sessions;
mod status;
mod tokens;

use std::future::{Future, poll_fn};
use std::sync::Arc;
use std::time::Duration;

use http::{Request, Response};
use tokio::net::TcpListener;
use tonic::body::Body;
use tonic::service::Routes;
use tonic::{Status, Streaming};
use tower::{Layer, Service as _};
use waypost_proto::FILE_DESCRIPTOR_SET;
use waypost_proto::v1::appearance_service_server::AppearanceServiceServer;
use waypost_proto::v1::cluster_service_server::ClusterServiceServer;
use waypost_proto::v1::correction_service_server::CorrectionServiceServer;
use waypost_proto::v1::event_service_server::EventServiceServer;
use waypost_proto::v1::job_service_server::JobServiceServer;
use waypost_proto::v1::label_service_server::LabelServiceServer;
use waypost_proto::v1::map_service_server::MapServiceServer;
use waypost_proto::v1::merge_service_server::MergeServiceServer;
use waypost_proto::v1::model_service_server::ModelServiceServer;
use waypost_proto::v1::navigation_service_server::NavigationServiceServer;
use waypost_proto::v1::recognition_service_server::RecognitionServiceServer;
use waypost_proto::v1::session_service_server::SessionServiceServer;
use waypost_proto::v1::token_service_server::TokenServiceServer;

use crate::error::ServiceError;
use crate::grpc::access::AccessLayer;
use crate::grpc::requests::RequestLayer;
use crate::net::connections::{Connections, Limits};
use crate::net::messages::MAX_MESSAGE_BYTES;
use crate::net::standing::Strangers;
use crate::net::tls::Tls;
use crate::service::Service;

/// Largest message taken in: an image of 4 MiB is refused with an answer, not by ending the stream,
/// even if it is a good deal too large.
const MAX_REQUEST_BYTES: usize = MAX_MESSAGE_BYTES;

/// Largest message sent; tonic itself has no limit.
const MAX_RESPONSE_BYTES: usize = 16 << 20;

/// A robot that is gone without a word is noticed after two of these.
const KEEPALIVE: Duration = Duration::from_secs(20);

/// Calls that one connection may have open at a time: more than any robot needs, but not any number.
pub(crate) const MAX_STREAMS_PER_CONNECTION: u32 = 256;

/// All headers of a call together.
const MAX_HEADER_BYTES: u32 = 16 << 10;

/// Connections for all streams and as many robots that only ask now and then; with those of HTTP they stay below
/// the 1024 files that most systems let a process have.
pub(crate) const LIMITS: Limits =
    Limits { connections: 640, kept_for_strangers: 16, patience: Duration::from_secs(10) };

/// Within which the first message of a stream has to come.
const FIRST_MESSAGE_TIMEOUT: Duration = Duration::from_secs(30);

/// How long an upload may pause between messages.
const UPLOAD_PAUSE: Duration = Duration::from_secs(120);

/// The generated servers share no trait that has the limits.
macro_rules! limited {
    ($server:expr) => {
        $server.max_decoding_message_size(MAX_REQUEST_BYTES).max_encoding_message_size(MAX_RESPONSE_BYTES)
    };
}

pub(crate) async fn serve(
    service: Arc<Service>,
    listener: TcpListener,
    tls: Option<&Tls>,
    strangers: Strangers,
    shutdown: impl Future<Output = ()> + Send,
) -> anyhow::Result<()> {
    let routes = routes(&service).await?;
    let connections = Connections::at(listener, tls.map(|tls| tls.grpc.clone()), LIMITS, strangers)?;
    tonic::transport::Server::builder()
        .http2_keepalive_interval(Some(KEEPALIVE))
        .http2_keepalive_timeout(Some(KEEPALIVE))
        .max_concurrent_streams(MAX_STREAMS_PER_CONNECTION)
        .http2_max_header_list_size(MAX_HEADER_BYTES)
        .layer(RequestLayer { service: service.clone() })
        .layer(AccessLayer { service: service.clone() })
        .add_routes(routes)
        .serve_with_incoming_shutdown(connections, shutdown)
        .await?;
    Ok(())
}

/// All services, behind nothing.
pub(crate) async fn routes(service: &Arc<Service>) -> anyhow::Result<Routes> {
    let adapter = || Adapter { service: service.clone() };
    let (health_reporter, health) = tonic_health::server::health_reporter();
    health_reporter.set_serving::<SessionServiceServer<Adapter>>().await;
    let stopping = service.stopping().clone();
    tokio::spawn(async move {
        stopping.cancelled().await;
        health_reporter.set_not_serving::<SessionServiceServer<Adapter>>().await;
    });
    let reflected = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    // Python's reflection client, among others, speaks the older version alone.
    let reflection = reflected().build_v1()?;
    let reflection_alpha = reflected().build_v1alpha()?;
    Ok(Routes::new(health)
        .add_service(reflection)
        .add_service(reflection_alpha)
        .add_service(limited!(ModelServiceServer::new(adapter())))
        .add_service(limited!(JobServiceServer::new(adapter())))
        .add_service(limited!(MapServiceServer::new(adapter())))
        .add_service(limited!(CorrectionServiceServer::new(adapter())))
        .add_service(limited!(MergeServiceServer::new(adapter())))
        .add_service(limited!(SessionServiceServer::new(adapter())))
        .add_service(limited!(NavigationServiceServer::new(adapter())))
        .add_service(limited!(RecognitionServiceServer::new(adapter())))
        .add_service(limited!(LabelServiceServer::new(adapter())))
        .add_service(limited!(AppearanceServiceServer::new(adapter())))
        .add_service(limited!(EventServiceServer::new(adapter())))
        .add_service(limited!(TokenServiceServer::new(adapter())))
        .add_service(limited!(ClusterServiceServer::new(adapter()))))
}

/// Answers one call at [`routes`], guarded, as if it had come over a connection.
pub(crate) async fn answer(
    service: &Arc<Service>,
    routes: Routes,
    call: Request<Body>,
) -> anyhow::Result<Response<Body>> {
    let guarded = AccessLayer { service: service.clone() }.layer(routes);
    let mut watched = RequestLayer { service: service.clone() }.layer(guarded);
    poll_fn(|context| watched.poll_ready(context)).await?;
    Ok(watched.call(call).await?)
}

/// Implements the generated service traits.
#[derive(Clone, Debug)]
struct Adapter {
    service: Arc<Service>,
}

impl Adapter {
    /// The first message of a stream; DEADLINE_EXCEEDED if it does not come.
    async fn first<T>(&self, requests: &mut Streaming<T>) -> Result<Option<T>, Status> {
        self.next_within(FIRST_MESSAGE_TIMEOUT, requests).await
    }

    /// The next message of an upload; DEADLINE_EXCEEDED if it pauses for too long.
    async fn next<T>(&self, requests: &mut Streaming<T>) -> Result<Option<T>, Status> {
        self.next_within(UPLOAD_PAUSE, requests).await
    }

    /// UNAVAILABLE once the server stops: a client that pauses must not hold it up.
    async fn next_within<T>(
        &self,
        patience: Duration,
        requests: &mut Streaming<T>,
    ) -> Result<Option<T>, Status> {
        tokio::select! {
            message = requests.message() => message,
            () = tokio::time::sleep(patience) => Err(ServiceError::deadline(format_args!(
                "no message came within {} s; call again, and send without such a pause",
                patience.as_secs()
            ))
            .into()),
            () = self.service.stopping().cancelled() => Err(ServiceError::stopping().into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use bytes::Bytes;
    use http_body::Frame;
    use tonic::Code;
    use tonic::body::Body;
    use waypost_proto::v1::StreamRequest;

    use super::*;
    use crate::metrics::Metrics;
    use crate::service::tokens::Tokens;
    use crate::storage::Storage;

    /// A client that is connected and says nothing.
    struct Silent;

    impl http_body::Body for Silent {
        type Data = Bytes;
        type Error = Status;

        fn poll_frame(
            self: std::pin::Pin<&mut Self>,
            _: &mut std::task::Context<'_>,
        ) -> std::task::Poll<Option<Result<Frame<Bytes>, Status>>> {
            std::task::Poll::Pending
        }
    }

    fn silent<T: prost::Message + Default + 'static>() -> Streaming<T> {
        let decoder = tonic_prost::ProstDecoder::<T>::new(tonic::codec::BufferSettings::default());
        Streaming::new_request(decoder, Body::new(Silent), None, None)
    }

    #[tokio::test]
    async fn who_says_nothing_is_not_waited_for_for_ever() {
        let directory = tempfile::tempdir().unwrap();
        let storage = Storage::open(directory.path()).await.unwrap();
        let tokens = Tokens::load(&storage).await.unwrap();
        let service = Arc::new(Service::new(storage, tokens, Metrics::new().unwrap()));
        let adapter = Adapter { service: service.clone() };
        let patience = Duration::from_millis(50);
        let silent_stream = &mut silent::<StreamRequest>();
        let (waited, status) =
            (Instant::now(), adapter.next_within(patience, silent_stream).await.unwrap_err());
        assert_eq!(status.code(), Code::DeadlineExceeded, "{status}");
        assert!(waited.elapsed() >= patience && status.message().contains("send without such a pause"));
        // One that stops does not wait even so long.
        service.stopping().cancel();
        let status = adapter.first(silent_stream).await.unwrap_err();
        assert_eq!(status.code(), Code::Unavailable, "{status}");
        service.stop().await;
    }
}
