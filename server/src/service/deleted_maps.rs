//! The rows of maps that were deleted, or given up half made: they go in the background, piece by piece.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::storage::{MapId, Removal, Storage, StorageError};

/// After a failure, on a full disk for example.
const RETRY: Duration = Duration::from_secs(10);

/// Deletes the rows of maps that are out of sight already. Cheap to clone.
#[derive(Clone, Debug)]
pub(super) struct DeletedMaps {
    storage: Storage,
    stopping: CancellationToken,
    wanted: Arc<Notify>,
    /// Imports that could not be marked as given up.
    abandoned: Arc<Mutex<Vec<MapId>>>,
}

impl DeletedMaps {
    pub(super) fn new(storage: Storage, stopping: CancellationToken) -> Self {
        Self { storage, stopping, wanted: Arc::default(), abandoned: Arc::default() }
    }

    /// Deletes, until the server stops, whatever is to be deleted.
    pub(super) async fn keep_deleting(self) {
        while !self.stopping.is_cancelled() {
            let removed = self.remove_all().await;
            let next = async {
                match removed {
                    Ok(()) => self.wanted.notified().await,
                    Err(error) => {
                        tracing::warn!(%error, "what was deleted could not be taken away; tried again soon");
                        tokio::time::sleep(RETRY).await;
                    }
                }
            };
            tokio::select! {
                () = next => {}
                () = self.stopping.cancelled() => {}
            }
        }
    }

    /// Says that there is something to delete.
    pub(super) fn wanted(&self) {
        self.wanted.notify_one();
    }

    /// Frees the name of a map that was being imported; its rows are deleted later.
    pub(super) async fn give_up_import(&self, map: MapId) {
        if let Err(error) = self.storage.retire_import(map).await {
            tracing::warn!(%error, "an import could not be given up; tried again soon");
            self.abandoned().push(map);
        }
    }

    async fn remove_all(&self) -> Result<(), StorageError> {
        loop {
            let Some(map) = self.abandoned().last().copied() else { break };
            self.storage.retire_import(map).await?;
            self.abandoned().retain(|&other| other != map);
        }
        let mut removed = Ok(());
        for map in self.storage.retired_maps().await? {
            // One that is damaged does not keep the others.
            if let Err(error) = self.remove(map).await {
                tracing::warn!(map, %error, "a deleted map cannot be taken away");
                removed = Err(error);
            }
        }
        // After the maps: a model that one still refers to stays.
        while self.storage.drop_unfinished_model().await? {}
        removed
    }

    /// As far as there is time.
    async fn remove(&self, map: MapId) -> Result<(), StorageError> {
        while !self.stopping.is_cancelled() && self.storage.delete_piece(map).await? == Removal::Under {}
        Ok(())
    }

    fn abandoned(&self) -> MutexGuard<'_, Vec<MapId>> {
        self.abandoned.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
