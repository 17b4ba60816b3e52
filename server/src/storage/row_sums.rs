//! Checksums of a log's events, and the chain that they make.

use sqlx::{Any, Transaction};
use topomap::log::MapEvent;

use super::values::to_sql;
use super::{MapId, Storage, StorageError};

/// Events that are summed at a time.
const PIECE: u32 = 500;

/// The chain is a polynomial of the checksums, so that SQL can go on with it where an event is inserted.
const FACTOR: i64 = 48_271;
const MODULUS: i64 = 2_147_483_647;

/// What the first event of a log follows.
pub(super) const CHAIN_START: i64 = 0;

/// The checksum of an event at a position of a log.
pub(super) fn checksum(position: i64, event: &[u8]) -> i64 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&position.to_le_bytes());
    hasher.update(event);
    i64::from(hasher.finalize())
}

/// The next link of a log's chain.
pub(super) fn chained(before: i64, checksum: i64) -> i64 {
    (before * FACTOR + checksum) % MODULUS
}

/// How the link of an event follows from that of one that stands further back: (back * factor + sum) % 2147483647.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChainStep {
    pub(super) factor: i64,
    pub(super) sum: i64,
}

impl ChainStep {
    /// The link itself.
    pub(super) const NONE: Self = Self { factor: 1, sum: 0 };

    /// By one event more.
    pub(super) fn then(self, checksum: i64) -> Self {
        Self { factor: self.factor * FACTOR % MODULUS, sum: chained(self.sum, checksum) }
    }
}

/// An event as it is stored. Read with its `position`, `event`, `checksum` and `chain`.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(super) struct StoredEvent {
    #[sqlx(try_from = "i64")]
    pub(super) position: u64,
    #[sqlx(rename = "event")]
    pub(super) bytes: Vec<u8>,
    checksum: Option<i64>,
    chain: Option<i64>,
}

impl StoredEvent {
    /// The event, if it is as it was written.
    pub(super) fn decode(&self, vocabulary_len: usize) -> Result<MapEvent, StorageError> {
        self.check()?;
        MapEvent::from_bytes(&self.bytes, vocabulary_len)
            .map_err(|error| StorageError::Damaged(error.to_string()))
    }

    /// Its link in the log's chain, as it is stored.
    pub(super) fn chain(&self) -> i64 {
        self.chain.unwrap_or_default()
    }

    /// [`StorageError::Rot`] unless it is as it was written.
    pub(super) fn check(&self) -> Result<(), StorageError> {
        if self.checksum == Some(checksum(to_sql(self.position), &self.bytes)) {
            return Ok(());
        }
        Err(StorageError::Rot("what is stored of it is not what was written".to_owned()))
    }

    /// The same, and [`StorageError::Rot`] unless it follows the event before it, whose link is `before`. Gives its own.
    pub(super) fn follow(&self, position: u64, before: i64) -> Result<i64, StorageError> {
        self.check()?;
        if self.position != position {
            return Err(StorageError::Rot(format!("event {position} of the log is gone")));
        }
        let chain = chained(before, self.checksum.unwrap_or_default());
        if self.chain == Some(chain) {
            return Ok(chain);
        }
        Err(StorageError::Rot("it does not follow the event before it in the log".to_owned()))
    }
}

impl Storage {
    /// Gives events that earlier servers stored their checksums.
    pub(super) async fn sum_old_rows(&self) -> Result<(), StorageError> {
        let to_do = sqlx::query("SELECT 1 FROM upkeep WHERE task = 'log_checksums'");
        if to_do.fetch_optional(&self.readers).await?.is_none() {
            return Ok(());
        }
        let maps: Vec<MapId> = sqlx::query_scalar("SELECT id FROM maps").fetch_all(&self.readers).await?;
        for map in maps {
            let mut next = Some((0, CHAIN_START));
            while let Some((from, chain)) = next {
                next = self.write(async |transaction| sum_piece(transaction, map, from, chain).await).await?;
            }
        }
        self.write(async |transaction| {
            let done = sqlx::query("DELETE FROM upkeep WHERE task = 'log_checksums'");
            done.execute(&mut **transaction).await?;
            Ok(())
        })
        .await
    }
}

/// Sums events from a position on; where the next piece begins and what it follows, if there is one.
async fn sum_piece(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    from: i64,
    mut chain: i64,
) -> Result<Option<(i64, i64)>, StorageError> {
    let events: Vec<(i64, Vec<u8>)> = sqlx::query_as(
        "SELECT position, event FROM log WHERE map_id = $1 AND position >= $2 ORDER BY position LIMIT $3",
    )
    .bind(map)
    .bind(from)
    .bind(i64::from(PIECE))
    .fetch_all(&mut **transaction)
    .await?;
    for (position, event) in &events {
        let checksum = checksum(*position, event);
        chain = chained(chain, checksum);
        sqlx::query("UPDATE log SET checksum = $1, chain = $2 WHERE map_id = $3 AND position = $4")
            .bind(checksum)
            .bind(chain)
            .bind(map)
            .bind(position)
            .execute(&mut **transaction)
            .await?;
    }
    Ok(events.last().map(|(last, _)| (last + 1, chain)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_steps_lead_where_one_by_one_leads() {
        let checksums = [u32::MAX, 0, 1, 2_147_483_647, 2_147_483_648, 77].map(i64::from);
        for start in [CHAIN_START, 1, MODULUS - 1] {
            let (mut link, mut step) = (start, ChainStep::NONE);
            for checksum in checksums {
                (link, step) = (chained(link, checksum), step.then(checksum));
                assert_eq!((start * step.factor + step.sum) % MODULUS, link);
            }
        }
    }

    #[test]
    fn an_event_that_is_another_gone_or_elsewhere_shows() {
        let stored = |position: u64, bytes: &[u8], before: i64| {
            let sum = checksum(to_sql(position), bytes);
            StoredEvent {
                position,
                bytes: bytes.to_vec(),
                checksum: Some(sum),
                chain: Some(chained(before, sum)),
            }
        };
        let first = stored(0, b"first", CHAIN_START);
        let chain = first.follow(0, CHAIN_START).unwrap();
        let second = stored(1, b"second", chain);
        assert!(second.follow(1, chain).is_ok());
        // Whole in itself, and not what followed.
        assert!(stored(1, b"other", 7).follow(1, chain).is_err());
        assert!(second.follow(2, chain).is_err());
        assert!(StoredEvent { position: 2, ..second.clone() }.check().is_err());
        assert!(StoredEvent { checksum: None, ..second.clone() }.check().is_err());
        let mut bytes = second.bytes.clone();
        bytes[3] ^= 1;
        assert!(StoredEvent { bytes, ..second }.check().is_err());
    }
}
