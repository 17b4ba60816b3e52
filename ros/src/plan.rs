//! What the robot is to do with which map; services change it while the bridge runs.

use crate::settings::{Mode, Settings};

/// Sessions as they are wanted, one at a time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Plan {
    /// None until one is chosen.
    pub(crate) map: Option<String>,
    /// Name of the next session to be opened; empty for the server to choose.
    pub(crate) next_session: String,
    pub(crate) mode: Mode,
    /// Whether a session is wanted.
    pub(crate) is_wanted: bool,
    /// Rises whenever the session that is open is to end: then, if one is wanted, the next begins.
    pub(crate) turn: u64,
    /// Rises whenever the robot's clock was set back: what knows its stamps begins anew.
    pub(crate) clock: u64,
}

impl Plan {
    pub(crate) fn first(settings: &Settings) -> Self {
        let (map, next_session) = (settings.map.clone(), settings.session.clone());
        Self { is_wanted: map.is_some(), map, next_session, mode: settings.mode, turn: 0, clock: 0 }
    }

    /// The map to open a session of, if one is wanted.
    pub(crate) fn wanted_map(&self) -> Option<&str> {
        self.map.as_deref().filter(|_| self.is_wanted)
    }
}
