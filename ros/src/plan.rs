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
    /// Rises whenever the robot's clock was set back: what knows its stamps or its odometry begins anew.
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

    /// What is open has stamps of another time. It ends, and the next begins.
    pub(crate) fn clock_was_set_back(&mut self) {
        self.turn += 1;
        self.clock += 1;
    }

    /// Whether odometry that another plan's session placed on its map is placed there still.
    pub(crate) fn goes_on_from(&self, before: &Self) -> bool {
        // A simulation that begins again has the robot elsewhere, and its odometry at 0.
        (&self.map, self.clock) == (&before.map, before.clock)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_the_robot_is_holds_for_one_map_and_until_its_clock_is_set_back() {
        let hall = Plan {
            map: Some("hall".to_owned()),
            next_session: String::new(),
            mode: Mode::Localize,
            is_wanted: true,
            turn: 4,
            clock: 0,
        };
        assert!(Plan { turn: 5, mode: Mode::Map, ..hall.clone() }.goes_on_from(&hall));
        assert!(!Plan { map: Some("other".to_owned()), ..hall.clone() }.goes_on_from(&hall));
        let mut again = hall.clone();
        again.clock_was_set_back();
        assert_eq!(again.turn, 5);
        assert!(!again.goes_on_from(&hall));
    }
}
