//! What is brought from one database into another: every table, by its key and its other columns.

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Whole,
    Real,
    Text,
    Bytes,
}

use Kind::{Bytes, Real, Text, Whole};

/// A table, by its key and its other columns.
pub(super) struct Table {
    pub(super) name: &'static str,
    pub(super) key: &'static [(&'static str, Kind)],
    pub(super) rest: &'static [(&'static str, Kind)],
    /// Rows that are read and written at a time.
    pub(super) page: usize,
}

pub(super) const MODELS: Table = Table {
    name: "models",
    key: &[("hash", Text)],
    rest: &[
        ("display_name", Text),
        ("extractor", Text),
        ("words", Whole),
        ("samples", Whole),
        ("words_hash", Text),
        ("size_bytes", Whole),
        ("created_ns", Whole),
        ("file", Bytes),
    ],
    page: 1,
};

pub(super) const TOKENS: Table = Table {
    name: "tokens",
    key: &[("name", Text)],
    rest: &[
        ("role", Text),
        ("secret_sha256", Bytes),
        ("created_ns", Whole),
        ("abilities", Text),
        ("maps", Text),
        ("expires_ns", Whole),
        ("former_secret_sha256", Bytes),
        ("former_until_ns", Whole),
        ("max_maps", Whole),
        ("max_sessions", Whole),
        ("max_frames_per_second", Real),
        ("max_kept_mib", Whole),
    ],
    page: 500,
};

/// Without what a server goes on by: the other database's may be doing it.
pub(super) const JOBS: Table = Table {
    name: "jobs",
    key: &[("number", Whole)],
    rest: &[
        ("kind", Text),
        ("state", Text),
        ("stage", Text),
        ("result", Text),
        ("error", Text),
        ("error_code", Text),
        ("created_ns", Whole),
        ("ended_ns", Whole),
        ("maps", Text),
    ],
    page: 500,
};

/// Without the map, which may be one that is being deleted.
pub(super) const MERGES: Table = Table {
    name: "merges",
    key: &[("number", Whole)],
    rest: &[
        ("target", Text),
        ("job", Whole),
        ("state", Text),
        ("report", Text),
        ("picture", Text),
        ("error", Text),
        ("error_code", Text),
        ("created_ns", Whole),
    ],
    page: 50,
};

/// Tables of a map, without their column `map_id`.
pub(super) const OF_MAPS: [Table; 14] = [
    Table { name: "map_models", key: &[("until_events", Whole)], rest: &[("model", Text)], page: 500 },
    Table {
        name: "sessions",
        key: &[("number", Whole)],
        rest: &[
            ("name", Text),
            ("camera", Bytes),
            ("opened_ns", Whole),
            ("merge", Whole),
            ("owner", Text),
            ("kept_bytes", Whole),
        ],
        page: 500,
    },
    Table {
        name: "log",
        key: &[("position", Whole)],
        rest: &[
            ("session", Whole),
            ("sequence", Whole),
            ("stamp_ns", Whole),
            ("reason", Text),
            ("place", Whole),
            ("posterior", Real),
            ("matched_frame", Whole),
            ("probability", Real),
            ("link_from", Whole),
            ("link_to", Whole),
            ("event", Bytes),
            ("checksum", Whole),
            ("chain", Whole),
        ],
        page: 500,
    },
    Table {
        name: "frame_media",
        key: &[("position", Whole), ("kind", Text)],
        rest: &[("content", Bytes), ("object", Text), ("object_bytes", Whole), ("object_sha256", Bytes)],
        page: 8,
    },
    Table { name: "frame_notes", key: &[("position", Whole)], rest: &[("note", Text)], page: 500 },
    Table { name: "labels", key: &[("place", Whole)], rest: &[("label", Text)], page: 500 },
    Table { name: "checkpoint_sessions", key: &[("session", Whole)], rest: &[("content", Bytes)], page: 100 },
    Table { name: "checkpoint_links", key: &[("first_link", Whole)], rest: &[("content", Bytes)], page: 100 },
    Table {
        name: "checkpoint_blocks",
        key: &[("first_place", Whole)],
        rest: &[("places", Whole), ("events", Whole), ("content", Bytes)],
        page: 8,
    },
    Table {
        name: "checkpoint_places",
        key: &[("place", Whole)],
        rest: &[("events", Whole), ("content", Bytes)],
        page: 500,
    },
    // After its pieces: without it they are nothing.
    Table { name: "checkpoints", key: &[("events", Whole)], rest: &[("head", Bytes)], page: 1 },
    Table {
        name: "appearance_links",
        key: &[("place", Whole), ("earlier", Whole)],
        rest: &[("similarity", Real)],
        page: 500,
    },
    Table { name: "appearance_graphs", key: &[("rules", Whole)], rest: &[("next_place", Whole)], page: 1 },
    Table { name: "map_damage", key: &[("found", Text)], rest: &[("found_ns", Whole)], page: 1 },
];

/// A map, without what shows it.
pub(super) const MAPS: Table = Table {
    name: "maps",
    key: &[("id", Whole)],
    rest: &[
        ("name", Text),
        ("model", Text),
        ("settings", Text),
        ("created_ns", Whole),
        ("edition", Whole),
        ("owner", Text),
    ],
    page: 500,
};

/// Tables whose numbers are never given twice, with the column.
pub(super) const NUMBERED: [(&str, &str); 3] = [("maps", "id"), ("jobs", "number"), ("merges", "number")];
