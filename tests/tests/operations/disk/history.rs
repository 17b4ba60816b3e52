//! What a database held, commit by commit.

use std::collections::HashMap;

use super::contents::{Contents, contents};
use super::record::{Call, Record};
use super::scratch;
use super::simulated::{Image, Lie, SimulatedDisk, write_image};

pub(super) struct State {
    /// The call before which it was there.
    pub(super) call: usize,
    pub(super) contents: Contents,
}

pub(super) struct History {
    pub(super) states: Vec<State>,
    last_with: HashMap<u64, usize>,
}

impl History {
    /// Opens the database as it was before each sync, which is where transactions end.
    pub(super) async fn of(record: &Record, before: &Image) -> Self {
        let mut disk = SimulatedDisk::new(record, before, Lie::Nothing);
        let mut states: Vec<State> = Vec::new();
        let mut written = true;
        for (call, recorded) in record.calls.iter().enumerate() {
            written |=
                matches!(recorded.call, Call::Wrote { .. } | Call::Renamed { .. } | Call::Unlinked { .. });
            let ends = matches!(recorded.call, Call::SyncBegan { .. }) || call + 1 == record.calls.len();
            if !(ends && std::mem::take(&mut written)) {
                continue;
            }
            disk.run_to(call);
            let folder = scratch();
            write_image(folder.path(), &disk.kept());
            let contents = contents(&folder.path().join("data")).await.unwrap();
            if states.last().is_none_or(|last| last.contents != contents) {
                states.push(State { call, contents });
            }
        }
        let last_with =
            states.iter().enumerate().map(|(number, state)| (state.contents.digest(), number)).collect();
        Self { states, last_with }
    }

    /// The last state with these contents, if there was one.
    pub(super) fn state_of(&self, contents: &Contents) -> Option<usize> {
        self.last_with.get(&contents.digest()).copied()
    }

    /// The state that was there when so much was recorded.
    pub(super) fn state_at(&self, record: &Record, recorded: u64) -> usize {
        let made = record.calls.partition_point(|call| call.end <= recorded);
        self.states.partition_point(|state| state.call <= made) - 1
    }

    /// The first state with so many frames of a session.
    pub(super) fn first_with(&self, session: &(String, String), frames: u64) -> usize {
        let has = |state: &State| state.contents.frames.get(session).is_some_and(|count| *count >= frames);
        self.states.iter().position(has).expect("what was acknowledged was written")
    }
}
