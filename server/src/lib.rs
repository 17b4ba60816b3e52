//! The Waypost server: gRPC for robots, REST for people, one service layer under both.
//!
//! [`serve`] runs a server on sockets that the caller has bound, until the caller says stop.
//!
//! What may be awaited from outside comes boxed: the work of an `async fn` is compiled in whatever awaits it, and all of a
//! server took each program nine minutes of a processor.

mod camera;
mod clock;
pub mod config;
mod error;
mod fleet;
mod grpc;
mod http;
mod ingest;
mod map_settings;
mod memory;
mod metrics;
mod names;
mod net;
pub mod offline;
mod open_map;
mod pages;
mod quotas;
mod role;
mod service;
mod storage;
#[doc(hidden)]
pub mod unconnected;
mod wire;

use std::future::Future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use futures::future::{BoxFuture, LocalBoxFuture};
use tokio::net::TcpListener;
use tokio::sync::watch;

pub use crate::fleet::{Opening, Ports, open_beside_others};
pub use crate::memory::share_heaps;
pub use crate::net::origin::{NoOrigin, Origin};
pub use crate::net::standing::Strangers;
pub use crate::net::tls::{Tls, TlsError, TlsFiles};
pub use crate::quotas::ServerLimits;
pub use crate::role::{Ability, Role};

use crate::config::{Config, DataLocation, StorageAddress};
use crate::metrics::{HISTORY_EVERY, Metrics};
use crate::service::Service;
use crate::service::tokens::{Anonymous, Tokens};
use crate::storage::{Addresses, Claim, Storage, WhileOwned};

/// How long connections may take to end once the server stops.
const GRACE: Duration = Duration::from_secs(5);

/// The same where the database may be another server's, and for the maps to close: that one, or this one again, is waited for.
const LOST_GRACE: Duration = Duration::from_millis(500);

/// How often the metrics are summed up.
const METRICS_UPKEEP: Duration = Duration::from_secs(5);

/// How often memory that was freed goes back to the system.
const MEMORY_UPKEEP: Duration = Duration::from_secs(20);

/// A server whose database is open.
#[derive(Debug)]
pub struct Server {
    service: Arc<Service>,
    tls: Option<Tls>,
    map_memory_bytes: u64,
    strangers: Strangers,
    cors_origins: Vec<Origin>,
}

/// Why a server no longer serves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Served {
    /// It was asked to stop.
    UntilStopped,
    /// Another server owns its database, or may.
    UntilTakenOver,
}

/// A server without any token was to listen where others can reach it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{address} can be reached from other machines, and there is no token, so everyone who reaches it could do \
     everything; create a token first (waypost-server token create operator --role admin, with this server's --data-dir or --config), or \
     listen on 127.0.0.1, \
     or say --allow-anonymous (WAYPOST_ALLOW_ANONYMOUS=true) if all that can reach it may do so"
)]
pub struct Exposed {
    /// Where it was to listen.
    pub address: SocketAddr,
}

impl Exposed {
    /// Refuses `addresses` for a server whose database is yet to be made, and has no token in it.
    ///
    /// # Errors
    /// [`Exposed`].
    pub fn check_new(addresses: [SocketAddr; 2]) -> Result<(), Self> {
        exposed(addresses).map_or(Ok(()), |address| Err(Self { address }))
    }
}

impl Server {
    /// Opens the database of `location`, making it if it is missing. While another server owns a database of PostgreSQL,
    /// this waits.
    ///
    /// # Errors
    /// If the directory cannot be written to, is used by another server, is of a newer version or is
    /// damaged, or the database cannot be reached; the message says which and how to mend it.
    pub fn open(location: DataLocation) -> LocalBoxFuture<'static, anyhow::Result<Self>> {
        Box::pin(async move {
            let (tell, _owner) = watch::channel(None);
            let claim = Claim { addresses: Addresses::default(), while_owned: WhileOwned::Wait(tell) };
            Self::open_with(&location, claim).await
        })
    }

    async fn open_with(location: &DataLocation, claim: Claim) -> anyhow::Result<Self> {
        let service = open(location, claim).await?;
        service.settle_media_store().await?;
        service.settle().await?;
        let defaults = Config::default();
        let map_memory_bytes = defaults.map_memory_bytes();
        let strangers = defaults.strangers();
        Ok(Self { service, tls: None, map_memory_bytes, strangers, cors_origins: defaults.cors_origins })
    }

    /// A server without any model takes in the one that ships, as `shipped`. One that has models stays as it is.
    ///
    /// # Errors
    /// If the database cannot be read or written.
    pub fn with_shipped_model(self) -> BoxFuture<'static, anyhow::Result<Self>> {
        Box::pin(async move {
            self.service.models.take_in_shipped().await?;
            Ok(self)
        })
    }

    /// Both listeners speak TLS.
    #[must_use]
    pub fn with_tls(self, tls: Tls) -> Self {
        Self { tls: Some(tls), ..self }
    }

    /// While open maps take more than `bytes`, those that nobody uses are closed.
    #[must_use]
    pub fn with_map_memory(self, bytes: u64) -> Self {
        Self { map_memory_bytes: bytes, ..self }
    }

    /// What connections are granted on which no call was admitted, at each listener.
    #[must_use]
    pub fn with_strangers(self, strangers: Strangers) -> Self {
        Self { strangers, ..self }
    }

    /// Pages of these origins may ask over HTTP from a browser.
    #[must_use]
    pub fn with_cors_origins(self, origins: Vec<Origin>) -> Self {
        Self { cors_origins: origins, ..self }
    }

    /// How many wrong tokens are taken from one address in a minute.
    #[must_use]
    pub fn with_wrong_tokens_per_minute(self, wrong_tokens: u32) -> Self {
        self.service.tokens.set_guesses_per_minute(wrong_tokens);
        self
    }

    /// How much may be there, whosever it is.
    #[must_use]
    pub fn with_limits(self, limits: ServerLimits) -> Self {
        self.service.set_limits(limits);
        self
    }

    /// While there is no token, everyone who reaches the server is served, from other machines too.
    #[must_use]
    pub fn allow_anonymous(self) -> Self {
        self.service.tokens.set_anonymous(Anonymous::Everyone);
        self
    }

    /// Refuses to listen at `addresses` if one of them would lay the server open; see [`Exposed`].
    ///
    /// # Errors
    /// [`Exposed`].
    pub fn check_exposure(&self, addresses: [SocketAddr; 2]) -> Result<(), Exposed> {
        let Some(address) = exposed(addresses) else { return Ok(()) };
        let tokens = &self.service.tokens;
        match tokens.anonymous() {
            Anonymous::Everyone | Anonymous::Refused => Ok(()),
            Anonymous::Local if tokens.is_empty() => Err(Exposed { address }),
            Anonymous::Local => {
                // Also when the last token is gone.
                tokens.set_anonymous(Anonymous::Refused);
                Ok(())
            }
        }
    }

    /// Serves both listeners until `shutdown` completes; then ends streams, commits and checkpoints
    /// every map, and closes the database.
    ///
    /// # Errors
    /// [`Exposed`], or if a listener fails.
    pub fn serve(
        self,
        grpc: TcpListener,
        http: TcpListener,
        shutdown: impl Future<Output = ()> + Send + 'static,
    ) -> BoxFuture<'static, anyhow::Result<Served>> {
        self.serve_until(grpc, http, Box::pin(shutdown))
    }

    /// [`Server::serve`] for one kind of `shutdown`: what is generic would be compiled where it is called.
    fn serve_until(
        self,
        grpc: TcpListener,
        http: TcpListener,
        shutdown: BoxFuture<'static, ()>,
    ) -> BoxFuture<'static, anyhow::Result<Served>> {
        Box::pin(async move {
            let addresses = [grpc.local_addr()?, http.local_addr()?];
            self.check_exposure(addresses)?;
            if let Some(address) = exposed(addresses).filter(|_| self.tls.is_none()) {
                tracing::warn!(
                    %address,
                    "without TLS, tokens and images can be read on the way; set tls_certificate and tls_key, or keep \
                     the network to yourself"
                );
            }
            let Self { service, tls, map_memory_bytes, strangers, cors_origins } = self;
            service.start_upkeep(map_memory_bytes);
            service.use_helpers(tls.as_ref().map(|tls| tls.neighbours.clone()));
            if let Err(error) = service.take_up_jobs().await {
                tracing::error!(%error, "jobs of an earlier server wait for the next start");
            }
            let stopping = service.stopping().clone();
            let signal = stopping.clone();
            let taken_over = service.taken_over();
            let lost = taken_over.clone();
            let losing = service.clone();
            let watch = tokio::spawn(async move {
                tokio::select! {
                    () = shutdown => {}
                    () = lost.happens() => {
                        tracing::error!("serving no more: the database may be another server's by now");
                        losing.abandon();
                    }
                }
                signal.cancel();
            });
            let metrics = service.metrics().clone();
            let upkeep = tokio::spawn(async move {
                loop {
                    tokio::time::sleep(METRICS_UPKEEP).await;
                    metrics.sum_up();
                }
            });
            let looked_at = service.clone();
            let looking = tokio::spawn(async move {
                loop {
                    looked_at.keep_metrics().await;
                    tokio::time::sleep(HISTORY_EVERY).await;
                }
            });
            let trimming = tokio::spawn(async {
                loop {
                    tokio::time::sleep(MEMORY_UPKEEP).await;
                    // It takes the allocator's locks for a moment.
                    drop(tokio::task::spawn_blocking(memory::give_back).await);
                }
            });
            let serving = async {
                tokio::try_join!(
                    grpc::serve(
                        service.clone(),
                        grpc,
                        tls.as_ref(),
                        strangers,
                        stopping.clone().cancelled_owned()
                    ),
                    http::serve(
                        service.clone(),
                        http,
                        tls.as_ref(),
                        strangers,
                        cors_origins,
                        stopping.clone().cancelled_owned()
                    ),
                )
            };
            let patience = async {
                stopping.cancelled().await;
                tokio::time::sleep(if taken_over.has_happened() { LOST_GRACE } else { GRACE }).await;
            };
            let served = tokio::select! {
                served = serving => served.map(drop),
                () = patience => {
                    tracing::warn!("some connections did not end in time and were cut");
                    Ok(())
                }
            };
            watch.abort();
            upkeep.abort();
            looking.abort();
            trimming.abort();
            if !taken_over.has_happened() {
                service.stop().await;
                return served.map(|()| Served::UntilStopped);
            }
            // A commit may wait for a database that is gone. Whatever comes of it, it is fenced, and nobody hears of it.
            let stopping = tokio::spawn(async move { service.stop().await });
            if tokio::time::timeout(LOST_GRACE, stopping).await.is_err() {
                tracing::warn!("some maps wait for the database still, and close later");
            }
            served.map(|()| Served::UntilTakenOver)
        })
    }
}

/// The first address that other machines can reach.
fn exposed(addresses: [SocketAddr; 2]) -> Option<SocketAddr> {
    addresses.into_iter().find(|address| !address.ip().to_canonical().is_loopback())
}

async fn open(location: &DataLocation, claim: Claim) -> anyhow::Result<Arc<Service>> {
    let DataLocation { storage, data_dir, media } = location;
    let storage = match storage {
        StorageAddress::Sqlite => Storage::open_with(data_dir, media).await?,
        StorageAddress::Postgres(url) => Storage::connect(url, data_dir, media, claim).await?,
    };
    let tokens = Tokens::load(&storage).await?;
    Ok(Arc::new(Service::new(storage, tokens, Metrics::new()?)))
}

/// Opens the database of `location` and serves until `shutdown` completes; see [`Server`].
///
/// # Errors
/// As [`Server::open`] and [`Server::serve`].
pub async fn serve(
    location: DataLocation,
    grpc: TcpListener,
    http: TcpListener,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> anyhow::Result<Served> {
    Server::open(location).await?.serve(grpc, http, shutdown).await
}

#[cfg(test)]
mod tests {
    use super::*;

    fn addresses(grpc: &str, http: &str) -> [SocketAddr; 2] {
        [grpc.parse().unwrap(), http.parse().unwrap()]
    }

    #[tokio::test]
    async fn only_loopback_is_served_without_a_token() {
        let directory = tempfile::tempdir().unwrap();
        let server = Server::open(directory.path().to_owned().into()).await.unwrap();
        for (grpc, http) in [("127.0.0.1:1", "127.9.9.9:2"), ("[::1]:1", "[::ffff:127.0.0.1]:2")] {
            assert_eq!(server.check_exposure(addresses(grpc, http)), Ok(()));
        }
        let exposed = [
            ("0.0.0.0:1", "127.0.0.1:2", 0),
            ("127.0.0.1:1", "[::]:2", 1),
            ("127.0.0.1:1", "192.0.2.1:2", 1),
        ];
        for (grpc, http, wrong) in exposed {
            let addresses = addresses(grpc, http);
            assert_eq!(server.check_exposure(addresses), Err(Exposed { address: addresses[wrong] }));
        }
        let message = Exposed { address: "0.0.0.0:1".parse().unwrap() }.to_string();
        assert!(message.contains("token create") && message.contains("--allow-anonymous"), "{message}");

        let server = server.allow_anonymous();
        assert_eq!(server.check_exposure(addresses("0.0.0.0:1", "0.0.0.0:2")), Ok(()));
        server.service.stop().await;
    }

    #[tokio::test]
    async fn with_a_token_any_address_will_do_and_the_last_one_stays() {
        let directory = tempfile::tempdir().unwrap();
        offline::create_token(directory.path().into(), "operator", Role::Admin, Default::default())
            .await
            .unwrap();
        let server = Server::open(directory.path().to_owned().into()).await.unwrap();
        assert_eq!(server.check_exposure(addresses("0.0.0.0:1", "127.0.0.1:2")), Ok(()));
        assert!(server.service.tokens.delete("tokens/operator").await.is_err());
        server.service.stop().await;
    }
}
