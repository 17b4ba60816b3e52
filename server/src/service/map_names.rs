//! Names that maps have, or are about to have.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::error::ServiceError;
use crate::storage::Storage;

/// Which names are free for a map. Cheap to clone.
#[derive(Clone, Debug)]
pub(super) struct MapNames {
    storage: Storage,
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
    /// The token that the map is to count for.
    owner: Option<String>,
    among: Arc<ReservedNames>,
}

impl MapNames {
    pub(super) fn new(storage: Storage) -> Self {
        Self { storage, reserved: Arc::default() }
    }

    /// Refuses a name that is reserved.
    pub(super) fn check_unreserved(&self, map: &str) -> Result<(), ServiceError> {
        if self.reserved.lock().contains(map) { Err(reserved(map)) } else { Ok(()) }
    }

    /// Keeps a name for a map that is being imported, or made of others, and counts for the quota of `owner`.
    pub(super) async fn reserve(&self, map: &str, owner: Option<&str>) -> Result<Reservation, ServiceError> {
        // Looked at again when the map is made; by then it has cost some work.
        self.storage.quotas().check_map(owner)?;
        if !self.reserved.lock().insert(map.to_owned()) {
            return Err(reserved(map));
        }
        let owner = owner.map(str::to_owned);
        let reservation = Reservation { name: map.to_owned(), owner, among: self.reserved.clone() };
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

    /// The token that the map is to count for.
    pub(super) fn owner(&self) -> Option<&str> {
        self.owner.as_deref()
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

pub(super) fn map_exists(map: &str) -> ServiceError {
    ServiceError::AlreadyExists {
        message: format!("there is a map {map} already; choose another name, or delete it first"),
    }
}
