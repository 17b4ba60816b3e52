//! Snapshots: a map with its model as one checksummed file, out and in.

mod check;
mod export;
mod format;
mod import;

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Semaphore;

use super::Service;
use super::maps::map_exists;
use crate::error::ServiceError;
use crate::storage::EXPORTERS;

/// What exports and imports under way share.
#[derive(Debug)]
pub(super) struct Snapshots {
    exports: Arc<Semaphore>,
    uploads: Arc<Semaphore>,
    reserved: Arc<ReservedNames>,
}

/// Names of maps that are being imported, or made of others.
#[derive(Debug, Default)]
struct ReservedNames {
    names: Mutex<BTreeSet<String>>,
}

/// A name that nobody else can take for a map. Free again when dropped.
#[derive(Debug)]
pub(super) struct Reservation {
    name: String,
    among: Arc<ReservedNames>,
}

impl Default for Snapshots {
    fn default() -> Self {
        Self {
            exports: Arc::new(Semaphore::new(EXPORTERS as usize)),
            uploads: Arc::new(Semaphore::new(import::MAX_IMPORTS)),
            reserved: Arc::default(),
        }
    }
}

impl Snapshots {
    /// Refuses a name that an import has reserved.
    pub(super) fn check_unreserved(&self, map: &str) -> Result<(), ServiceError> {
        if self.reserved.lock().contains(map) { Err(reserved(map)) } else { Ok(()) }
    }
}

impl Service {
    /// Keeps a name for a map that is being imported, or made of others.
    pub(super) async fn reserve(&self, map: &str) -> Result<Reservation, ServiceError> {
        if !self.snapshots.reserved.lock().insert(map.to_owned()) {
            return Err(reserved(map));
        }
        let reservation = Reservation { name: map.to_owned(), among: self.snapshots.reserved.clone() };
        match self.storage.map(map).await? {
            None => Ok(reservation),
            Some(_) => Err(map_exists(map)),
        }
    }
}

impl Reservation {
    pub(super) fn name(&self) -> &str {
        &self.name
    }
}

impl ReservedNames {
    fn lock(&self) -> MutexGuard<'_, BTreeSet<String>> {
        self.names.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.among.lock().remove(&self.name);
    }
}

fn reserved(map: &str) -> ServiceError {
    ServiceError::AlreadyExists {
        message: format!(
            "a map {map} is being imported or made of others; choose another name, or cancel or discard that first"
        ),
    }
}
