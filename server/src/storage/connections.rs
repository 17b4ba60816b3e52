//! Connections to a database, whichever it is.

use sqlx::any::AnyPoolOptions;
use sqlx::pool::PoolOptions;
use sqlx::{Connection, Database};

/// So many connections at most. One whose transaction could not be rolled back, as on a disk that fails, is not used
/// again: whatever was begun on it would be nested in that transaction.
pub(super) fn pool(connections: u32) -> AnyPoolOptions {
    sqlx::any::install_default_drivers();
    of_any_age(AnyPoolOptions::new()).max_connections(connections).before_acquire(|connection, _| {
        let sound = !connection.is_in_transaction();
        Box::pin(async move { Ok(sound) })
    })
}

/// Connections are kept for as long as they work. sqlx 0.9 looks for old ones in as many steps as it counts idle connections,
/// and one that is taken in the moment in which it comes back makes the count wrap below zero. A thread of the runtime was seen
/// in that search after 54,000 simulated disks: it took a core, and never came back.
pub(super) fn of_any_age<D: Database>(options: PoolOptions<D>) -> PoolOptions<D> {
    options.max_lifetime(None).idle_timeout(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_looks_for_old_connections() {
        let options = pool(4);
        assert_eq!((options.get_max_lifetime(), options.get_idle_timeout()), (None, None));
    }
}
