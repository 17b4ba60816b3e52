//! Several servers over one database: one owns it, and the others ask that one whatever they are asked.

mod carried;
mod relay;
mod upstream;

use std::future::Future;
use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::time::Duration;

use futures::future::{BoxFuture, LocalBoxFuture};
use tokio::net::TcpListener;
use tokio::sync::watch;

use self::relay::Relay;
use crate::config::{DataLocation, StorageAddress};
use crate::metrics::Metrics;
use crate::net::standing::Strangers;
use crate::net::tls::Tls;
use crate::storage::{Addresses, Claim, WhileOwned, host_name, inspect_media_store, inspect_postgres};
use crate::{Exposed, Server, exposed};

/// Where a server listens, and how it speaks there.
#[derive(Debug)]
pub struct Ports {
    /// Where robots connect.
    pub grpc: TcpListener,
    /// Where people look.
    pub http: TcpListener,
    /// Both speak TLS, if they do.
    pub tls: Option<Tls>,
    /// What connections are granted on which no call was admitted.
    pub strangers: Strangers,
    /// By which name other servers reach this one; `None` for the address that it listens on.
    pub advertised_host: Option<String>,
    /// While there is no token, everyone who reaches it is served, from other machines too.
    pub allow_anonymous: bool,
}

impl Ports {
    /// Where other servers reach this one.
    fn addresses(&self) -> anyhow::Result<Addresses> {
        let reach = |listener: &TcpListener| Ok::<_, std::io::Error>(self.reached_at(listener.local_addr()?));
        Ok(Addresses { grpc: reach(&self.grpc)?, http: reach(&self.http)? })
    }

    fn reached_at(&self, address: SocketAddr) -> String {
        let port = address.port();
        match &self.advertised_host {
            Some(host) => format!("{host}:{port}"),
            // Whoever listens everywhere is known by its name.
            None if address.ip().is_unspecified() => format!("{}:{port}", host_name()),
            None => address.to_string(),
        }
    }

    /// The same ports, for who serves there now: gRPC, then HTTP.
    ///
    /// # Errors
    /// If the process has too many files open.
    pub fn shared(&self) -> std::io::Result<(TcpListener, TcpListener)> {
        Ok((shared(&self.grpc)?, shared(&self.http)?))
    }

    /// The same as [`Server::check_exposure`] of a server that does not own its database yet.
    async fn check_exposure(&self, database: &str) -> anyhow::Result<()> {
        let addresses = [self.grpc.local_addr()?, self.http.local_addr()?];
        match exposed(addresses) {
            Some(address) if !self.allow_anonymous => {
                let there = inspect_postgres(database).await?;
                anyhow::ensure!(there.is_some_and(|there| there.tokens > 0), Exposed { address });
                Ok(())
            }
            Some(_) | None => Ok(()),
        }
    }
}

/// A second handle of what listens.
fn shared(listener: &TcpListener) -> std::io::Result<TcpListener> {
    TcpListener::from_std(listener.as_fd().try_clone_to_owned()?.into())
}

/// How often a database is tried that this server had owned.
const OPEN_AGAIN: Duration = Duration::from_secs(1);

/// Which time it is that a server opens its database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Opening {
    /// What is wrong is told to who starts the server.
    First,
    /// It had owned the database. What is wrong passes, as while another machine takes over for PostgreSQL.
    Again,
}

/// Opens the database of `location` for a server with these ports. While another server owns the database, whatever is
/// asked at them is asked of that one. `None` if `shutdown` came first.
///
/// # Errors
/// As [`Server::open`] and [`Server::check_exposure`], or if a port cannot be served.
pub fn open_beside_others<'a>(
    location: &'a DataLocation,
    ports: &'a Ports,
    opening: Opening,
    shutdown: impl Future<Output = ()> + Send + 'a,
) -> LocalBoxFuture<'a, anyhow::Result<Option<Server>>> {
    open_or_relay(location, ports, opening, Box::pin(shutdown))
}

/// [`open_beside_others`] for one kind of `shutdown`: what is generic would be compiled where it is called.
fn open_or_relay<'a>(
    location: &'a DataLocation,
    ports: &'a Ports,
    opening: Opening,
    shutdown: BoxFuture<'a, ()>,
) -> LocalBoxFuture<'a, anyhow::Result<Option<Server>>> {
    Box::pin(async move {
        let StorageAddress::Postgres(database) = &location.storage else {
            return Server::open(location.clone()).await.map(Some);
        };
        let (tell, owner) = watch::channel(None);
        if opening == Opening::First {
            inspect_media_store(database, &location.media).await?;
        }
        let relay = Relay::new(owner, database, ports.tls.as_ref(), Metrics::new()?);
        let (grpc, http) = ports.shared()?;
        let addresses = ports.addresses()?;
        let opened = async {
            loop {
                let claim =
                    Claim { addresses: addresses.clone(), while_owned: WhileOwned::Wait(tell.clone()) };
                match (Server::open_with(location, claim).await, opening) {
                    (Err(error), Opening::Again) => {
                        tracing::warn!("the database cannot be opened again yet: {error:#}");
                        tell.send_replace(None);
                        tokio::time::sleep(OPEN_AGAIN).await;
                    }
                    (opened, Opening::First | Opening::Again) => return opened.map(Some),
                }
            }
        };
        let relaying = async {
            if opening == Opening::First {
                ports.check_exposure(database).await?;
            }
            relay.serve(grpc, http, ports).await
        };
        tokio::select! {
            opened = opened => opened,
            failed = relaying => failed.map(|()| None),
            () = shutdown => Ok(None),
        }
    })
}
