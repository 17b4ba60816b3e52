//! Whether what is acknowledged survives on a database of PostgreSQL.

use sqlx::postgres::PgConnection;

use crate::storage::StorageError;

/// The oldest that is tested.
const OLDEST_VERSION: i32 = 150_000;

/// Names and values of the settings that it hangs on.
pub(super) const SETTINGS: &str = "SELECT name, setting FROM pg_settings WHERE name IN \
     ('fsync', 'full_page_writes', 'synchronous_commit', 'data_checksums', 'synchronous_standby_names')";

/// The machines that follow this one, and not who copies it. What a server may not see of them is NULL.
pub(super) const FOLLOWERS: &str = "SELECT coalesce(nullif(application_name, ''), host(client_addr), 'unknown') AS name, \
     coalesce(state, 'unknown') AS state, coalesce(sync_state, 'unknown') AS sync_state, \
     CASE WHEN flush_lsn IS NOT NULL THEN greatest(pg_wal_lsn_diff(pg_current_wal_lsn(), flush_lsn), 0)::int8 END \
     AS lag_bytes FROM pg_stat_replication WHERE state IS DISTINCT FROM 'backup' \
     AND coalesce(application_name, '') NOT IN ('pg_basebackup', 'pg_receivewal') ORDER BY 1";

/// Refuses a database that cannot be used, and warns of one that may lose what is acknowledged.
pub(super) async fn check(connection: &mut PgConnection) -> Result<(), StorageError> {
    let version: i32 = sqlx::query_scalar("SELECT current_setting('server_version_num')::int4")
        .fetch_one(&mut *connection)
        .await?;
    if version < OLDEST_VERSION {
        return Err(StorageError::Unfit(format!(
            "the database is PostgreSQL {}; use {} or a later one",
            version / 10_000,
            OLDEST_VERSION / 10_000
        )));
    }
    let encoding: String =
        sqlx::query_scalar("SELECT current_setting('server_encoding')").fetch_one(&mut *connection).await?;
    if encoding != "UTF8" {
        return Err(StorageError::Unfit(format!(
            "the database has the encoding {encoding}; make one with UTF8, as by `createdb -E UTF8 -T template0 waypost`"
        )));
    }
    let settings = sqlx::query_as(SETTINGS).fetch_all(&mut *connection).await?;
    let standbys = sqlx::query(FOLLOWERS).fetch_all(&mut *connection).await?.len();
    for doubt in doubts(&settings, standbys) {
        tracing::warn!("{doubt}");
    }
    Ok(())
}

/// What of these settings may lose what is acknowledged, where so many machines follow.
pub(super) fn doubts(settings: &[(String, String)], standbys: usize) -> Vec<String> {
    let is = |name: &str, value: &str| settings.iter().any(|(of, is)| of == name && is == value);
    let mut doubts: Vec<String> = [
        ("fsync", "off", "a power cut may lose acknowledged frames, or the database"),
        ("full_page_writes", "off", "a power cut may damage the database"),
        ("synchronous_commit", "off", "a crash of the database may lose acknowledged frames"),
        ("synchronous_commit", "local", "a standby that takes over may lack acknowledged frames"),
        ("data_checksums", "off", "damage on the disk is found in logs alone; see `pg_checksums --enable`"),
    ]
    .into_iter()
    .filter(|(name, bad, _)| is(name, bad))
    .map(|(name, bad, then)| format!("PostgreSQL's {name} is {bad}: {then}"))
    .collect();
    if standbys > 0 && is("synchronous_standby_names", "") {
        doubts.push(
            "no standby is named in PostgreSQL's synchronous_standby_names: one that takes over may lack acknowledged frames"
                .to_owned(),
        );
    }
    doubts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_setting_that_may_lose_something_is_named() {
        let settings = |values: [&str; 5]| -> Vec<(String, String)> {
            let names = [
                "fsync",
                "full_page_writes",
                "synchronous_commit",
                "data_checksums",
                "synchronous_standby_names",
            ];
            names.into_iter().zip(values).map(|(name, value)| (name.to_owned(), value.to_owned())).collect()
        };
        assert!(doubts(&settings(["on", "on", "on", "on", "ANY 1 (one)"]), 2).is_empty());
        assert!(doubts(&settings(["on", "on", "remote_apply", "on", ""]), 0).is_empty());
        let bad = doubts(&settings(["off", "off", "local", "off", ""]), 1);
        let named: Vec<bool> = [
            "fsync is off",
            "full_page_writes is off",
            "synchronous_commit is local",
            "data_checksums is off",
        ]
        .into_iter()
        .chain(["synchronous_standby_names"])
        .zip(&bad)
        .map(|(name, doubt)| doubt.contains(name))
        .collect();
        assert_eq!(named, [true; 5], "{bad:?}");
    }
}
