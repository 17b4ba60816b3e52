//! The Waypost server: gRPC for robots, REST for people, one service layer under both.
//!
//! [`serve`] runs a server on sockets that the caller has bound, until the caller says stop.

pub mod config;
mod error;
mod extraction;
mod grpc;
mod http;
mod service;
mod storage;

use std::future::Future;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;

use crate::service::Service;
use crate::storage::Storage;

/// How long connections may take to end once the server stops.
const GRACE: Duration = Duration::from_secs(5);

/// A server whose database is open.
#[derive(Debug)]
pub struct Server {
    service: Arc<Service>,
}

impl Server {
    /// Opens the database in `data_dir`, making it if it is missing.
    ///
    /// # Errors
    /// If the directory cannot be written to, is used by another server, is of a newer version or is
    /// damaged; the message says which and how to mend it.
    pub async fn open(data_dir: PathBuf) -> anyhow::Result<Self> {
        let storage = Storage::open(&data_dir).await?;
        Ok(Self { service: Arc::new(Service::new(storage)) })
    }

    /// Serves both listeners until `shutdown` completes; then ends streams, commits and checkpoints
    /// every map, and closes the database.
    ///
    /// # Errors
    /// If a listener fails.
    pub async fn serve(
        self,
        grpc: TcpListener,
        http: TcpListener,
        shutdown: impl Future<Output = ()> + Send + 'static,
    ) -> anyhow::Result<()> {
        let service = self.service;
        let stopping = service.stopping().clone();
        let signal = stopping.clone();
        let watch = tokio::spawn(async move {
            shutdown.await;
            signal.cancel();
        });
        let serving = async {
            tokio::try_join!(
                grpc::serve(service.clone(), grpc, stopping.clone().cancelled_owned()),
                http::serve(service.clone(), http, stopping.clone().cancelled_owned()),
            )
        };
        let patience = async {
            stopping.cancelled().await;
            tokio::time::sleep(GRACE).await;
        };
        let served = tokio::select! {
            served = serving => served.map(drop),
            () = patience => {
                tracing::warn!("some connections did not end in time and were cut");
                Ok(())
            }
        };
        watch.abort();
        service.stop().await;
        served
    }
}

/// Opens `data_dir` and serves until `shutdown` completes; see [`Server`].
///
/// # Errors
/// As [`Server::open`] and [`Server::serve`].
pub async fn serve(
    data_dir: PathBuf,
    grpc: TcpListener,
    http: TcpListener,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> anyhow::Result<()> {
    Server::open(data_dir).await?.serve(grpc, http, shutdown).await
}
