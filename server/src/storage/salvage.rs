//! What can still be read of a damaged log.

use std::ops::Range;

use topomap::log::MapEvent;

use super::damage::Where;
use super::row_sums::{CHAIN_START, StoredEvent};
use super::{MapId, Storage, StorageError};

/// What is left of an event.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Salvaged {
    /// It is as it was written.
    Whole(MapEvent),
    /// It is not; what it was, as far as that can be told.
    Lost(String),
}

impl Storage {
    /// What is left of the events at `positions` of a log, one for each.
    pub(crate) async fn salvage(
        &self,
        map: MapId,
        positions: Range<u64>,
        vocabulary_len: usize,
    ) -> Result<Vec<Salvaged>, StorageError> {
        // With the neighbours, which say whether an event is of this log.
        let from = positions.start.saturating_sub(1);
        let rows = self.readable_events(map, from..positions.end + 1).await?;
        let row = |position: u64| rows.get((position - from) as usize).and_then(Option::as_ref);
        let mut salvaged = Vec::new();
        for position in positions {
            let before = match position.checked_sub(1) {
                Some(before) => row(before).map(StoredEvent::chain),
                None => Some(CHAIN_START),
            };
            let event = row(position)
                .filter(|event| is_of_this_log(event, before, row(position + 1)))
                .and_then(|event| event.decode(vocabulary_len).ok());
            salvaged.push(match event {
                Some(event) => Salvaged::Whole(event),
                None => Salvaged::Lost(self.lost(map, position).await),
            });
        }
        Ok(salvaged)
    }

    /// What an event was that is damaged, as far as that can be told; its map takes nothing more.
    async fn lost(&self, map: MapId, position: u64) -> String {
        let place = Where::Event(position);
        if self.damage(map).is_none() {
            self.note_rot(map, place, "what is stored of it is not what was written").await;
        }
        self.named(map, place).await
    }

    /// The rows at `positions` that can be read, and have the checksums of what they hold.
    async fn readable_events(
        &self,
        map: MapId,
        positions: Range<u64>,
    ) -> Result<Vec<Option<StoredEvent>>, StorageError> {
        let mut found = vec![None; (positions.end - positions.start) as usize];
        let rows = match self.stored_events(map, positions.clone()).await {
            Ok(rows) => rows,
            // One by one: a damaged page takes no more with it than it holds.
            Err(StorageError::Rot(_)) => {
                let mut rows = Vec::new();
                for position in positions.clone() {
                    match self.stored_events(map, position..position + 1).await {
                        Ok(row) => rows.extend(row),
                        Err(StorageError::Rot(_)) => {}
                        Err(error) => return Err(error),
                    }
                }
                rows
            }
            Err(error) => return Err(error),
        };
        for row in rows.into_iter().filter(|row| row.check().is_ok()) {
            if let Some(place) = found.get_mut((row.position - positions.start) as usize) {
                *place = Some(row);
            }
        }
        Ok(found)
    }
}

/// Whether an event that is whole in itself is the one that was here: it follows the one before it, whose link is
/// `before`, or the one after follows it. Where neither can be read, nothing speaks against it.
fn is_of_this_log(event: &StoredEvent, before: Option<i64>, after: Option<&StoredEvent>) -> bool {
    let position = event.position;
    let follows = before.map(|before| event.follow(position, before).is_ok());
    let is_followed = after.map(|after| after.follow(position + 1, event.chain()).is_ok());
    match (follows, is_followed) {
        (Some(true), _) | (_, Some(true)) | (None, None) => true,
        (Some(false), Some(false) | None) | (None, Some(false)) => false,
    }
}
