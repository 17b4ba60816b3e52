//! What is deleted, or was given up half made, is taken away in the background, piece by piece.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::Notify;

use super::Service;
use crate::storage::{MapId, Removal, StorageError};

/// After a failure, on a full disk for example.
const RETRY: Duration = Duration::from_secs(10);

/// What is to be taken away.
#[derive(Debug, Default)]
pub(super) struct Removals {
    wanted: Notify,
    /// Imports that could not be marked as given up.
    abandoned: Mutex<Vec<MapId>>,
}

impl Service {
    /// Takes away, until the server stops, whatever is to be.
    pub(crate) fn start_removals(self: &Arc<Self>) {
        let service = self.clone();
        self.jobs.track(async move {
            while !service.stopping.is_cancelled() {
                let removed = service.remove_all().await;
                let next = async {
                    match removed {
                        Ok(()) => service.removals.wanted.notified().await,
                        Err(error) => {
                            tracing::warn!(%error, "what was deleted could not be taken away; tried again soon");
                            tokio::time::sleep(RETRY).await;
                        }
                    }
                };
                tokio::select! {
                    () = next => {}
                    () = service.stopping.cancelled() => {}
                }
            }
        });
    }

    /// Says that there is something to take away.
    pub(super) fn removal_wanted(&self) {
        self.removals.wanted.notify_one();
    }

    /// Frees the name of a map that was being imported; its rows are taken away later.
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
        while let Some(map) = self.storage.retired_map().await? {
            while self.storage.delete_piece(map).await? == Removal::Under {
                if self.stopping.is_cancelled() {
                    return Ok(());
                }
            }
        }
        // After the maps: a model that one still refers to stays.
        while self.storage.drop_unfinished_model().await? {}
        Ok(())
    }

    fn abandoned(&self) -> MutexGuard<'_, Vec<MapId>> {
        self.removals.abandoned.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
