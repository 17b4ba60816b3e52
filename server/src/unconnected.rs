//! A server that is asked within its own process, without sockets: what strangers send can be fed to it as bytes, thousands of
//! times a second. `tests/fuzz` does that.

use std::fs::File;
use std::sync::Arc;

use axum::Router;
use fabmap::model::Model;
use futures::future::BoxFuture;
use http::{Request, Response};
use tonic::service::Routes;
use tower::Service as _;

use crate::Server;
use crate::ingest::model::LoadedModel;
use crate::service::{Service, snapshots};

/// A server without listeners.
#[derive(Debug)]
pub struct Unconnected {
    service: Arc<Service>,
    grpc: Routes,
    rest: Router,
}

impl Unconnected {
    /// `server`, which is to be reached by [`Unconnected::grpc`] and [`Unconnected::rest`] alone.
    ///
    /// # Errors
    /// If the description of its routes cannot be made.
    pub fn of(server: Server) -> BoxFuture<'static, anyhow::Result<Self>> {
        Box::pin(async move {
            let Server { service, tls: _, map_memory_bytes, strangers: _, cors_origins } = server;
            service.start_upkeep(map_memory_bytes);
            let grpc = crate::grpc::routes(&service).await?;
            Ok(Self { grpc, rest: crate::http::router(service.clone(), cors_origins)?, service })
        })
    }

    /// The answer to a call of gRPC.
    ///
    /// # Errors
    /// If there is none.
    pub fn grpc(
        &self,
        call: Request<tonic::body::Body>,
    ) -> BoxFuture<'_, anyhow::Result<Response<tonic::body::Body>>> {
        Box::pin(async move { crate::grpc::answer(&self.service, self.grpc.clone(), call).await })
    }

    /// The answer to a request of REST.
    pub fn rest(&self, request: Request<axum::body::Body>) -> BoxFuture<'_, Response<axum::body::Body>> {
        Box::pin(async move {
            let answered: Result<_, std::convert::Infallible> = self.rest.clone().call(request).await;
            let Ok(response) = answered;
            response
        })
    }

    /// Stops in good order.
    pub fn stop(self) -> BoxFuture<'static, ()> {
        Box::pin(async move {
            self.service.stop().await;
        })
    }
}

/// Checks a model file as an import does, and stores nothing.
///
/// # Errors
/// Why an import would not take it.
pub fn check_model(bytes: &[u8]) -> Result<(), String> {
    let model = Model::from_bytes(bytes).map_err(|error| error.to_string())?;
    LoadedModel::new(model).map(drop).map_err(|error| error.to_string())
}

/// Checks a map's snapshot as an import does, and stores nothing.
///
/// # Errors
/// Why an import would not take it.
pub fn check_snapshot(file: &File) -> Result<(), String> {
    snapshots::would_import(file).map_err(|error| error.to_string())
}
