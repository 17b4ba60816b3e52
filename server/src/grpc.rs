//! gRPC: `waypost.v1` spoken over the service layer. Conversions here, decisions there.

mod convert;
mod jobs;
mod maps;
mod models;
mod sessions;
mod status;

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Status, Streaming};
use waypost_proto::FILE_DESCRIPTOR_SET;
use waypost_proto::v1::job_service_server::JobServiceServer;
use waypost_proto::v1::map_service_server::MapServiceServer;
use waypost_proto::v1::model_service_server::ModelServiceServer;
use waypost_proto::v1::session_service_server::SessionServiceServer;

use crate::error::ServiceError;
use crate::service::Service;

/// Largest message taken in: an image of 4 MiB is refused with an answer, not by ending the stream,
/// even if it is a good deal too large.
const MAX_REQUEST_BYTES: usize = 16 << 20;

/// Largest message sent; tonic itself has no limit.
const MAX_RESPONSE_BYTES: usize = 16 << 20;

/// A robot that is gone without a word is noticed after two of these.
const KEEPALIVE: Duration = Duration::from_secs(20);

/// The generated servers share no trait that has the limits.
macro_rules! limited {
    ($server:expr) => {
        $server.max_decoding_message_size(MAX_REQUEST_BYTES).max_encoding_message_size(MAX_RESPONSE_BYTES)
    };
}

pub(crate) async fn serve(
    service: Arc<Service>,
    listener: TcpListener,
    shutdown: impl Future<Output = ()> + Send,
) -> anyhow::Result<()> {
    let adapter = || Adapter { service: service.clone() };
    let (health_reporter, health) = tonic_health::server::health_reporter();
    health_reporter.set_serving::<SessionServiceServer<Adapter>>().await;
    let stopping = service.stopping().clone();
    tokio::spawn(async move {
        stopping.cancelled().await;
        health_reporter.set_not_serving::<SessionServiceServer<Adapter>>().await;
    });
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()?;
    tonic::transport::Server::builder()
        .http2_keepalive_interval(Some(KEEPALIVE))
        .http2_keepalive_timeout(Some(KEEPALIVE))
        .tcp_nodelay(true)
        .add_service(health)
        .add_service(reflection)
        .add_service(limited!(ModelServiceServer::new(adapter())))
        .add_service(limited!(JobServiceServer::new(adapter())))
        .add_service(limited!(MapServiceServer::new(adapter())))
        .add_service(limited!(SessionServiceServer::new(adapter())))
        .serve_with_incoming_shutdown(TcpListenerStream::new(listener), shutdown)
        .await?;
    Ok(())
}

/// Implements the generated service traits.
#[derive(Clone, Debug)]
struct Adapter {
    service: Arc<Service>,
}

impl Adapter {
    /// The next message of a client, or UNAVAILABLE once the server stops: a client that pauses must
    /// not hold it up.
    async fn next<T>(&self, requests: &mut Streaming<T>) -> Result<Option<T>, Status> {
        tokio::select! {
            message = requests.message() => message,
            () = self.service.stopping().cancelled() => Err(ServiceError::stopping().into()),
        }
    }
}
