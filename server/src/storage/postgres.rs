//! A database of PostgreSQL: how it is opened, and whose it is.
//!
//! It may be on several machines, which follow the one that takes writes.
//! One server at a time owns it. The owner is a row with an epoch, which every transaction that writes holds on to: one
//! that was taken over writes nothing more. No clock decides about that, only about when somebody else may try.

mod cluster;
mod fitness;
mod helpers;
mod lease;
mod machines;
mod this_server;

use std::sync::Arc;
use std::time::Duration;

use sqlx::any::AnyPoolOptions;
use sqlx::migrate::{MigrateError, Migrator};
use sqlx::postgres::PgConnection;
use sqlx::{Any, AnyConnection, AnyPool, AssertSqlSafe, Connection, Transaction};
use tokio::sync::watch;
use tokio::task::AbortHandle;

pub(crate) use self::cluster::{ClusterRows, FleetLevels, ServerRow, StandbyRow};
pub(super) use self::cluster::{cluster, standbys};
use self::fitness::check;
pub(crate) use self::helpers::{HelperRow, model_file};
pub(crate) use self::lease::{Claim, Owner, WhileOwned};
use self::lease::{LEASE, renew, take};
use self::machines::{Machines, Primary};
pub(crate) use self::this_server::{Addresses, VERSION, cores, holder, host_name};
use super::sqlite::Inspection;
use super::values::from_sql;
use super::{EXPORTERS, Pools, READERS, StorageError, connections};

/// Statements, and waits for locks, are bounded in time: who asks gets an answer.
const STATEMENT_TIMEOUT: Duration = Duration::from_secs(60);
const LOCK_TIMEOUT: Duration = Duration::from_secs(10);
/// So is the wait for a connection, as to a machine that is gone.
const CONNECTION_TIMEOUT: Duration = Duration::from_secs(10);
/// And how long a transaction that writes waits for the next statement of its server.
const IDLE_TRANSACTION_TIMEOUT: Duration = Duration::from_secs(10);

// PostgreSQL gives up waiting for its standbys when a statement's time is over, and then says that a transaction is committed
// which no standby has. Who waits for so long no longer owns the database, and tells nobody.
const _: () = assert!(STATEMENT_TIMEOUT.as_millis() > 4 * LEASE.as_millis());

/// After which a database is looked for again that was there before.
const LOOK_AGAIN: Duration = Duration::from_millis(500);

static MIGRATIONS: Migrator = sqlx::migrate!("../migrations/postgres");

/// Size of the database.
pub(super) const SIZE_BYTES: &str = "SELECT pg_database_size(current_database())";

/// A database that this server owns.
#[derive(Clone, Debug)]
pub(super) struct Postgres {
    epoch: i64,
    /// By which the servers of a fleet know each other.
    secret: Arc<str>,
    taken_over: watch::Receiver<bool>,
    helpers: watch::Receiver<Vec<HelperRow>>,
    renewal: Arc<Renewal>,
}

/// The other servers of this one's database, as it knows them while it owns it.
#[derive(Clone, Debug)]
pub(crate) struct Fleet {
    /// By which they know each other.
    pub(crate) secret: Arc<str>,
    /// Those that look at images.
    pub(crate) helpers: watch::Receiver<Vec<HelperRow>>,
}

/// Ends with the last that needs it.
#[derive(Debug)]
struct Renewal(AbortHandle);

impl Drop for Renewal {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Why a text is no URL of a database, if it is none.
pub(crate) fn parse_postgres_address(address: &str) -> Result<(), String> {
    Machines::of(address).map(drop)
}

/// Opens the database at `address`, a URL as libpq has it: on the machine that takes writes, if it names several.
pub(super) async fn open(address: &str, claim: Claim) -> Result<(Postgres, Pools), StorageError> {
    loop {
        match open_where_written(address, &claim).await {
            Err(error) if claim.waits_in_spite_of(&error) => {
                tracing::warn!(%error, "the database is out of reach; it is looked for again");
                tokio::time::sleep(LOOK_AGAIN).await;
            }
            opened => return opened,
        }
    }
}

async fn open_where_written(address: &str, claim: &Claim) -> Result<(Postgres, Pools), StorageError> {
    let Primary { mut connection, address } = primary(address).await?;
    check(&mut connection).await?;
    migrate(&mut connection).await?;
    connection.close().await?;
    let writer = writing_pool().connect(&address).await?;
    let readers = pool(READERS).connect(&address).await?;
    let exporters = pool(EXPORTERS).connect_lazy(&address)?;
    let (epoch, secret) = take(&writer, claim).await?;
    let (tell, taken_over) = watch::channel(false);
    let (tell_helpers, helpers) = watch::channel(Vec::new());
    // A connection of its own: neither a long transaction nor readers hold it up.
    let renewing = tokio::spawn(renew(pool(1).connect_lazy(&address)?, epoch, tell, tell_helpers));
    let renewal = Arc::new(Renewal(renewing.abort_handle()));
    let postgres = Postgres { epoch, secret: secret.into(), taken_over, helpers, renewal };
    Ok((postgres, Pools { writer, readers, exporters }))
}

/// The machine of a database that takes writes.
async fn primary(address: &str) -> Result<Primary, StorageError> {
    Machines::of(address).map_err(StorageError::Unfit)?.primary().await
}

/// Looks at a database and changes nothing in it. `None` if it has no tables yet.
pub(crate) async fn inspect_postgres(address: &str) -> Result<Option<Inspection>, StorageError> {
    let Primary { mut connection, .. } = primary(address).await?;
    check(&mut connection).await?;
    let applied: Option<String> =
        sqlx::query_scalar("SELECT to_regclass('_sqlx_migrations')::text").fetch_one(&mut connection).await?;
    if applied.is_none() {
        return Ok(None);
    }
    let applied: Vec<i64> =
        sqlx::query_scalar("SELECT version FROM _sqlx_migrations").fetch_all(&mut connection).await?;
    let known = MIGRATIONS.iter().map(|migration| migration.version).collect::<Vec<_>>();
    if let Some(&schema) = applied.iter().find(|version| !known.contains(version)) {
        return Err(StorageError::Newer { schema });
    }
    let maps: i64 = sqlx::query_scalar("SELECT count(*) FROM maps").fetch_one(&mut connection).await?;
    let tokens: i64 = sqlx::query_scalar("SELECT count(*) FROM tokens").fetch_one(&mut connection).await?;
    connection.close().await?;
    Ok(Some(Inspection {
        maps: from_sql(maps)?,
        tokens: from_sql(tokens)?,
        outdated: applied.len() < known.len(),
    }))
}

fn pool(connections: u32) -> AnyPoolOptions {
    pool_with(connections, "")
}

/// Of an owner that vanishes in the middle of a transaction, as with its machine or its network, the database ends that:
/// nobody could take over before.
fn writing_pool() -> AnyPoolOptions {
    let idle = IDLE_TRANSACTION_TIMEOUT.as_millis();
    let settings = format!(
        "SET idle_in_transaction_session_timeout = {idle}; SET tcp_keepalives_idle = 5; \
         SET tcp_keepalives_interval = 2; SET tcp_keepalives_count = 3;"
    );
    pool_with(1, &settings)
}

fn pool_with(connections: u32, more: &str) -> AnyPoolOptions {
    let settings = Arc::new(format!(
        "SET statement_timeout = {}; SET lock_timeout = {}; {more}",
        STATEMENT_TIMEOUT.as_millis(),
        LOCK_TIMEOUT.as_millis()
    ));
    connections::pool(connections).acquire_timeout(CONNECTION_TIMEOUT).after_connect(move |connection, _| {
        let settings = settings.clone();
        Box::pin(async move {
            sqlx::raw_sql(AssertSqlSafe(settings.as_str())).execute(connection).await?;
            Ok(())
        })
    })
}

/// Brings the tables up to date; several servers that start together wait for each other.
async fn migrate(connection: &mut PgConnection) -> Result<(), StorageError> {
    let migrated = MIGRATIONS.run(connection).await;
    migrated.map_err(|error| match error {
        MigrateError::VersionMissing(schema) => StorageError::Newer { schema },
        MigrateError::Execute(error) => error.into(),
        other => StorageError::Migration(other),
    })
}

impl Postgres {
    /// [`StorageError::TakenOver`] if this is no longer the owner. Nobody else becomes it before the transaction ends: that
    /// changes the epoch, which is a key, and waits. To say that the owner is there changes no key, and does not.
    pub(super) async fn fence(&self, transaction: &mut Transaction<'_, Any>) -> Result<(), StorageError> {
        let owned = sqlx::query("SELECT 1 FROM lease WHERE id = 1 AND epoch = $1 FOR KEY SHARE")
            .bind(self.epoch)
            .fetch_optional(&mut **transaction)
            .await?;
        if owned.is_some() { Ok(()) } else { Err(StorageError::TakenOver) }
    }

    /// [`StorageError::TakenOver`] if this is no longer the owner.
    pub(super) async fn check_owned(&self, readers: &AnyPool) -> Result<(), StorageError> {
        let owned = sqlx::query("SELECT 1 FROM lease WHERE id = 1 AND epoch = $1").bind(self.epoch);
        let owned = owned.fetch_optional(readers).await?;
        if owned.is_some() { Ok(()) } else { Err(StorageError::TakenOver) }
    }

    pub(super) fn fleet(&self) -> Fleet {
        Fleet { secret: self.secret.clone(), helpers: self.helpers.clone() }
    }

    /// How often the database had changed hands when this server got it.
    pub(super) fn epoch(&self) -> i64 {
        self.epoch
    }

    pub(super) fn taken_over(&self) -> watch::Receiver<bool> {
        self.taken_over.clone()
    }

    /// The next server need not wait until the lease has run out.
    pub(super) async fn hand_over(&self, writer: &AnyPool) {
        self.renewal.0.abort();
        if *self.taken_over.borrow() {
            return;
        }
        let expire =
            sqlx::query("UPDATE lease SET expires = now() WHERE id = 1 AND epoch = $1").bind(self.epoch);
        if let Err(error) = expire.execute(writer).await {
            tracing::warn!(%error, "the database could not be handed over; the next server waits for {LEASE:?}");
        }
    }
}

/// The last number that a table gave.
pub(super) const LAST_NUMBER: &str = "SELECT pg_sequence_last_value(pg_get_serial_sequence($1, \
     CASE $1 WHEN 'maps' THEN 'id' ELSE 'number' END)::regclass)";

/// The next number that a table gives in its column is above `last`.
pub(super) async fn give_no_number_up_to(
    transaction: &mut Transaction<'_, Any>,
    (table, column): (&str, &str),
    last: i64,
) -> Result<(), StorageError> {
    if last > 0 {
        sqlx::query("SELECT setval(pg_get_serial_sequence($1, $2)::regclass, $3)")
            .bind(table)
            .bind(column)
            .bind(last)
            .execute(&mut **transaction)
            .await?;
    }
    Ok(())
}

/// The database at an address, to read all of it; a server may own it.
pub(super) async fn open_to_read(address: &str) -> Result<AnyConnection, StorageError> {
    match inspect_postgres(address).await? {
        Some(Inspection { outdated: false, .. }) => {}
        Some(_) | None => {
            let message = "the source has no tables of this version: start this version's server on it once";
            return Err(StorageError::Unfit(message.to_owned()));
        }
    }
    sqlx::any::install_default_drivers();
    let Primary { connection, address } = primary(address).await?;
    connection.close().await?;
    Ok(AnyConnection::connect(&address).await?)
}

/// Where the media of the database at an address lie outside it, with the mark of that store.
pub(super) async fn media_store(address: &str) -> Result<Option<(String, String)>, StorageError> {
    let Primary { mut connection, .. } = primary(address).await?;
    let table: Option<String> =
        sqlx::query_scalar("SELECT to_regclass('media_store')::text").fetch_one(&mut connection).await?;
    let known = match table {
        Some(_) => {
            let select = sqlx::query_as("SELECT address, mark FROM media_store WHERE id = 1");
            select.fetch_optional(&mut connection).await?
        }
        None => None,
    };
    connection.close().await?;
    Ok(known)
}

/// Old versions of rows are kept until a vacuum. PostgreSQL does that by itself, and it is asked to do it now.
/// Beside what is written, by a connection of its own.
pub(super) async fn wipe_deleted(exporters: &AnyPool) -> Result<(), StorageError> {
    let mut connection = exporters.acquire().await?;
    // Takes as long as it takes; the next one has its time limit again.
    sqlx::raw_sql("SET statement_timeout = 0").execute(&mut *connection).await?;
    connection.close_on_drop();
    sqlx::query("VACUUM").execute(&mut *connection).await?;
    Ok(())
}
