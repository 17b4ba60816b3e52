//! Connections to a database, whichever it is.

use sqlx::Connection;
use sqlx::any::AnyPoolOptions;

/// So many connections at most. One whose transaction could not be rolled back, as on a disk that fails, is not used
/// again: whatever was begun on it would be nested in that transaction.
pub(super) fn pool(connections: u32) -> AnyPoolOptions {
    sqlx::any::install_default_drivers();
    AnyPoolOptions::new().max_connections(connections).before_acquire(|connection, _| {
        let sound = !connection.is_in_transaction();
        Box::pin(async move { Ok(sound) })
    })
}
