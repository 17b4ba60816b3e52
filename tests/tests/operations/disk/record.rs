//! What the library recorded, call by call, in the order in which they were made.

use std::ops::Range;
use std::path::Path;

/// A file that a process has opened.
pub(super) type Handle = (u32, u32);

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Call {
    Began,
    Opened {
        handle: Handle,
        path: String,
        /// With its content thrown away.
        emptied: bool,
    },
    /// Its bytes are those of the record.
    Wrote {
        handle: Handle,
        at: usize,
        bytes: Range<usize>,
    },
    Sized {
        handle: Handle,
        bytes: usize,
    },
    SyncBegan {
        handle: Handle,
        number: u64,
    },
    SyncEnded {
        handle: Handle,
        number: u64,
    },
    SyncFailed,
    Renamed {
        from: String,
        to: String,
    },
    Unlinked {
        path: String,
    },
    MadeDirectory {
        path: String,
    },
}

/// A call, and where its record ends.
#[derive(Clone, Debug)]
pub(super) struct Recorded {
    pub(super) call: Call,
    pub(super) end: u64,
}

pub(super) struct Record {
    pub(super) bytes: Vec<u8>,
    pub(super) calls: Vec<Recorded>,
}

/// Bytes before those of a call: what, process, handle and count, of four bytes each, and a place of eight.
const HEAD_BYTES: usize = 24;

impl Record {
    /// Reads a record that may still grow.
    pub(super) fn read(file: &Path) -> Self {
        let bytes = std::fs::read(file).unwrap();
        let mut calls = Vec::new();
        let mut at = 0;
        while let Some(head) = bytes.get(at..at + HEAD_BYTES) {
            let word = |at: usize| u32::from_ne_bytes(head[at..at + 4].try_into().unwrap());
            let place = u64::from_ne_bytes(head[16..].try_into().unwrap());
            let content = at + HEAD_BYTES..at + HEAD_BYTES + word(12) as usize;
            let Some(said) = bytes.get(content.clone()) else { break };
            at = content.end;
            let handle = (word(4), word(8));
            let text = || String::from_utf8(said.to_vec()).unwrap();
            let call = match u8::try_from(word(0)).unwrap() {
                b'P' => Call::Began,
                b'O' => Call::Opened { handle, path: text(), emptied: place & 2 != 0 },
                b'W' => Call::Wrote { handle, at: place as usize, bytes: content },
                b'T' => Call::Sized { handle, bytes: place as usize },
                b'B' => Call::SyncBegan { handle, number: place },
                b'E' => Call::SyncEnded { handle, number: place },
                b'X' => Call::SyncFailed,
                b'N' => {
                    let (from, to) =
                        text().split_once('\0').map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
                    Call::Renamed { from, to }
                }
                b'U' => Call::Unlinked { path: text() },
                b'D' => Call::MadeDirectory { path: text() },
                other => panic!("a call that is none: {other}"),
            };
            calls.push(Recorded { call, end: at as u64 });
        }
        Self { bytes, calls }
    }

    /// Whether every file that was to reach the disk has reached it.
    pub(super) fn has_no_sync_under_way(&self) -> bool {
        let mut under_way = 0;
        for Recorded { call, .. } in &self.calls {
            match call {
                Call::SyncBegan { .. } => under_way += 1,
                Call::SyncEnded { .. } | Call::SyncFailed => under_way -= 1,
                // What a process had under way when it was killed is nobody's.
                Call::Began => under_way = 0,
                Call::Opened { .. }
                | Call::Wrote { .. }
                | Call::Sized { .. }
                | Call::Renamed { .. }
                | Call::Unlinked { .. }
                | Call::MadeDirectory { .. } => {}
            }
        }
        under_way == 0
    }
}
