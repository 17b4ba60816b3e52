//! Whose a database of PostgreSQL is: one row, which says until when, and where the owner is asked.

use std::time::{Duration, Instant};

use sqlx::AnyPool;
use tokio::sync::watch;

use super::helpers::{HelperRow, Registration, who_helps};
use super::this_server::{Addresses, VERSION, cores, holder};
use crate::storage::StorageError;

/// Who has not said for this long that it is there has given the database up.
pub(super) const LEASE: Duration = Duration::from_secs(4);
const RENEWALS_PER_LEASE: u32 = 4;
/// How often one that waits looks whether the database is free.
const PATIENCE: Duration = Duration::from_millis(250);

/// How a server is to own a database.
#[derive(Debug)]
pub(crate) struct Claim {
    /// Where others ask it then.
    pub(crate) addresses: Addresses,
    pub(crate) while_owned: WhileOwned,
}

impl Claim {
    /// Without being asked anything, and refused while a server owns the database.
    pub(crate) fn at_once() -> Self {
        Self { addresses: Addresses::default(), while_owned: WhileOwned::Refuse }
    }

    /// Whether it is waited for a database that failed so: by who has seen an owner, as while a standby of PostgreSQL takes
    /// over.
    pub(super) fn waits_in_spite_of(&self, error: &StorageError) -> bool {
        let passes = matches!(error, StorageError::HeldUp(_) | StorageError::Unfit(_));
        match &self.while_owned {
            WhileOwned::Wait(tell) => passes && tell.borrow().is_some(),
            WhileOwned::Refuse => false,
        }
    }
}

/// What to do while another server owns a database.
#[derive(Debug)]
pub(crate) enum WhileOwned {
    /// Wait, and tell meanwhile which that is.
    Wait(watch::Sender<Option<Owner>>),
    Refuse,
}

/// The server that owns a database, as another one sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Owner {
    pub(crate) epoch: i64,
    /// For people.
    pub(crate) holder: String,
    pub(crate) addresses: Addresses,
    /// By which it knows the other servers.
    pub(crate) secret: String,
}

/// Becomes the owner, unless somebody else is; gives the epoch and the fleet's secret.
pub(super) async fn take(writer: &AnyPool, claim: &Claim) -> Result<(i64, String), StorageError> {
    let Claim { addresses, while_owned } = claim;
    let mut registration = Registration::new(holder(), addresses.clone());
    let mut watched = Watched::default();
    loop {
        // A machine that is gone is not waited for: another may be the primary by now.
        let taken = tokio::time::timeout(LEASE, try_to_take(writer, addresses, &watched)).await;
        match (taken.unwrap_or(Err(StorageError::HeldUp(sqlx::Error::PoolTimedOut)))?, while_owned) {
            (Taken::Yes { epoch, secret }, _) => {
                if let Err(error) = registration.withdraw(writer).await {
                    tracing::warn!(%error, "this server is still listed as one that helps the owner");
                }
                tracing::info!(epoch, "this server owns the database");
                return Ok((epoch, secret));
            }
            (Taken::No { owner, expires: _ }, WhileOwned::Refuse) => {
                return Err(StorageError::Owned { owner: owner.holder });
            }
            (Taken::No { owner, expires }, WhileOwned::Wait(tell)) => {
                watched.see(expires);
                tell_of(owner, tell);
                if let Err(error) = registration.renew(writer).await {
                    tracing::warn!(%error, "the owner of the database cannot be told that this server helps");
                }
            }
        }
        tokio::time::sleep(PATIENCE).await;
    }
}

/// A lease as one who waits has seen it. When it runs out is a time of the database's clock, and another machine that
/// takes over for PostgreSQL may have one that is hours behind: so it has run out, too, when nobody renewed it for as long as
/// a lease by the clock of who waits.
#[derive(Debug, Default)]
struct Watched {
    last: Option<(String, Instant)>,
}

impl Watched {
    fn see(&mut self, expires: String) {
        if self.last.as_ref().is_none_or(|(seen, _)| *seen != expires) {
            self.last = Some((expires, Instant::now()));
        }
    }

    /// What it said, if that was so for too long.
    fn run_out(&self) -> Option<String> {
        self.last.as_ref().filter(|(_, since)| since.elapsed() > LEASE).map(|(expires, _)| expires.clone())
    }
}

fn tell_of(owner: Owner, tell: &watch::Sender<Option<Owner>>) {
    tell.send_if_modified(|known| {
        if known.as_ref() == Some(&owner) {
            return false;
        }
        tracing::info!(
            owner = owner.holder,
            at = owner.addresses.grpc,
            epoch = owner.epoch,
            "another server owns the database; it is asked for this one until it stops"
        );
        *known = Some(owner);
        true
    });
}

enum Taken {
    Yes {
        epoch: i64,
        secret: String,
    },
    /// `expires` is a text that changes with each renewal.
    No {
        owner: Owner,
        expires: String,
    },
}

async fn try_to_take(
    writer: &AnyPool,
    addresses: &Addresses,
    watched: &Watched,
) -> Result<Taken, StorageError> {
    let taken = sqlx::query_as(
        "INSERT INTO lease (id, epoch, holder, expires, grpc_address, http_address, version, cores) \
         VALUES (1, 1, $1, now() + $2 * interval '1 millisecond', $3, $4, $6, $7) \
         ON CONFLICT (id) DO UPDATE SET epoch = lease.epoch + 1, holder = excluded.holder, \
         expires = excluded.expires, grpc_address = excluded.grpc_address, http_address = excluded.http_address, \
         version = excluded.version, cores = excluded.cores WHERE lease.expires <= now() OR lease.expires::text = $5 RETURNING epoch, secret",
    )
    .bind(holder())
    .bind(LEASE.as_millis() as i64)
    .bind(&addresses.grpc)
    .bind(&addresses.http)
    .bind(watched.run_out())
    .bind(VERSION)
    .bind(cores() as i64)
    .fetch_optional(writer)
    .await?;
    if let Some((epoch, secret)) = taken {
        return Ok(Taken::Yes { epoch, secret });
    }
    let (epoch, holder, grpc, http, secret, expires) = sqlx::query_as(
        "SELECT epoch, holder, grpc_address, http_address, secret, expires::text FROM lease WHERE id = 1",
    )
    .fetch_one(writer)
    .await?;
    Ok(Taken::No { owner: Owner { epoch, holder, addresses: Addresses { grpc, http }, secret }, expires })
}

/// Says again and again that the owner is there; tells when it no longer is, or may no longer be.
///
/// Meanwhile it tells who helps.
pub(super) async fn renew(
    pool: AnyPool,
    epoch: i64,
    taken_over: watch::Sender<bool>,
    helpers: watch::Sender<Vec<HelperRow>>,
) {
    let mut owned = Instant::now();
    loop {
        tokio::time::sleep(LEASE / RENEWALS_PER_LEASE).await;
        let asked = Instant::now();
        let renewal = sqlx::query(
            "UPDATE lease SET expires = now() + $1 * interval '1 millisecond' WHERE id = 1 AND epoch = $2",
        )
        .bind(LEASE.as_millis() as i64)
        .bind(epoch);
        let renewed = tokio::time::timeout(LEASE / RENEWALS_PER_LEASE, renewal.execute(&pool)).await;
        match renewed {
            Ok(Ok(done)) if done.rows_affected() == 1 => {
                owned = asked;
                let there = tokio::time::timeout(LEASE / RENEWALS_PER_LEASE, who_helps(&pool)).await;
                // Those that were known stay where it cannot be seen.
                if let Ok(Ok(there)) = there {
                    helpers.send_if_modified(|known| std::mem::replace(known, there.clone()) != there);
                }
            }
            Ok(Ok(_none)) => {
                tracing::error!(epoch, "another server has taken the database over");
                taken_over.send_replace(true);
                return;
            }
            Ok(Err(error)) => tracing::warn!(%error, "the database cannot be told that its owner is there"),
            Err(_late) => tracing::warn!("the database does not answer its owner in time"),
        }
        if owned.elapsed() > LEASE {
            tracing::error!(
                epoch,
                "the database was out of reach for too long; another server may own it by now"
            );
            taken_over.send_replace(true);
            return;
        }
    }
}
