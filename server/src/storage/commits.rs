//! Who watches a map hears that its log has grown.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use super::{MapId, Storage};

/// The maps that are watched.
#[derive(Debug, Default)]
pub(super) struct Commits {
    watched: Mutex<HashMap<MapId, watch::Sender<()>>>,
}

impl Commits {
    /// Tells whoever watches the map; one that nobody watches any more is forgotten.
    pub(super) fn tell(&self, map: MapId) {
        let mut watched = self.watched();
        if watched.get(&map).is_some_and(|sender| sender.send(()).is_err()) {
            watched.remove(&map);
        }
    }

    fn watched(&self) -> MutexGuard<'_, HashMap<MapId, watch::Sender<()>>> {
        self.watched.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Storage {
    /// Changes with every commit to the map's log.
    pub(crate) fn commits_of(&self, map: MapId) -> watch::Receiver<()> {
        self.commits.watched().entry(map).or_insert_with(|| watch::channel(()).0).subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_that_nobody_watches_are_forgotten() {
        let commits = Commits::default();
        commits.tell(1);
        let sender = watch::channel(()).0;
        let mut watcher = sender.subscribe();
        commits.watched().insert(1, sender);
        commits.tell(1);
        commits.tell(2);
        assert!(watcher.has_changed().unwrap());
        watcher.borrow_and_update();
        drop(watcher);
        assert_eq!(commits.watched().len(), 1);
        commits.tell(1);
        assert!(commits.watched().is_empty());
    }
}
