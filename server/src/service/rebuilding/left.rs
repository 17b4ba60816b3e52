//! What is left of a damaged map.

use topomap::log::{Correction, CorrectionEvent, MapEvent};

use crate::storage::{MapId, Salvaged, StorageError};

/// Whether one of the corrections is the other, said of the frames of another map.
pub(super) fn is_said_again(said: &CorrectionEvent, again: &CorrectionEvent) -> bool {
    let kind = std::mem::discriminant::<Correction>;
    (&said.by, said.said_ns, kind(&said.correction)) == (&again.by, again.said_ns, kind(&again.correction))
}

/// What was read; none if it is damaged.
pub(super) fn unless_damaged<T>(read: Result<T, StorageError>) -> Result<Option<T>, StorageError> {
    match read {
        Ok(read) => Ok(Some(read)),
        Err(StorageError::Rot(_)) => Ok(None),
        Err(error) => Err(error),
    }
}

/// An event that can be brought back, and the map that keeps what belongs to it; or what is lost.
pub(super) enum Left {
    Event(MapId, MapEvent),
    Nothing(String),
}

impl Left {
    /// Whether the damaged map does not have it.
    pub(super) fn is_not_of(&self, damaged: MapId) -> bool {
        match self {
            Self::Event(map, _) => *map != damaged,
            Self::Nothing(_) => true,
        }
    }

    pub(super) fn of(map: MapId, salvaged: Salvaged) -> Self {
        match salvaged {
            Salvaged::Whole(event) => Self::Event(map, event),
            Salvaged::Lost(what) => Self::Nothing(what),
        }
    }
}
