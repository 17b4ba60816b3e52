-- Models: immutable files, named by the hash of their content. What people ask about is kept in
-- columns beside the file, so that a list does not read megabytes.
CREATE TABLE models (
    hash         TEXT    NOT NULL PRIMARY KEY,
    display_name TEXT    NOT NULL,
    extractor    TEXT    NOT NULL,
    words        INTEGER NOT NULL,
    samples      INTEGER NOT NULL,
    -- Hash of extractor and vocabulary alone: words of models that share it mean the same.
    words_hash   TEXT    NOT NULL,
    size_bytes   INTEGER NOT NULL,
    created_ns   INTEGER NOT NULL,
    file         BLOB    NOT NULL
) STRICT;

-- AUTOINCREMENT: the number of a deleted map is never given again, so a late writer cannot reach
-- into another map.
CREATE TABLE maps (
    id         INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    name       TEXT    NOT NULL UNIQUE,
    -- A model that a map uses cannot be deleted.
    model      TEXT    NOT NULL REFERENCES models (hash),
    -- JSON with every setting spelled out: a later version's defaults must not change an old map.
    settings   TEXT    NOT NULL,
    created_ns INTEGER NOT NULL
) STRICT;

CREATE TABLE sessions (
    map_id    INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    number    INTEGER NOT NULL,
    name      TEXT    NOT NULL,
    -- The camera as it was declared, an encoded waypost.v1.Camera; NULL if none was.
    camera    BLOB,
    opened_ns INTEGER NOT NULL,
    PRIMARY KEY (map_id, number),
    UNIQUE (map_id, name)
) STRICT;

-- The truth: everything else about a map can be computed from its log. Rows are only ever added.
-- The columns beside the event repeat what it says, for those who ask in SQL.
CREATE TABLE log (
    map_id        INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    position      INTEGER NOT NULL,
    session       INTEGER NOT NULL,
    -- NULL where the event is not a frame; so for the columns that follow.
    sequence      INTEGER,
    stamp_ns      INTEGER,
    reason        TEXT,
    place         INTEGER,
    posterior     REAL,
    matched_frame INTEGER,
    -- The link that this frame added, if it did.
    link_from     INTEGER,
    link_to       INTEGER,
    event         BLOB    NOT NULL,
    PRIMARY KEY (map_id, position)
) STRICT;

-- A frame sent again finds its stored answer; and none can be stored twice.
CREATE UNIQUE INDEX log_by_sequence ON log (map_id, session, sequence) WHERE sequence IS NOT NULL;

-- Loop closures are few among many frames.
CREATE INDEX log_loop_closures ON log (map_id, position) WHERE reason = 'loop_closure';

-- How many places and links a map has is asked whenever maps are listed.
CREATE INDEX log_places ON log (map_id, place) WHERE place IS NOT NULL;
CREATE INDEX log_links ON log (map_id, position) WHERE link_to IS NOT NULL;

-- A checkpoint is the fold of the log up to `events`, so that a map opens without replaying it. It
-- can be deleted at any time. Places are rows of their own: only those that changed are written.
CREATE TABLE checkpoints (
    map_id INTEGER NOT NULL PRIMARY KEY REFERENCES maps (id) ON DELETE CASCADE,
    events INTEGER NOT NULL,
    graph  BLOB    NOT NULL
) STRICT;

CREATE TABLE checkpoint_places (
    map_id INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    place  INTEGER NOT NULL,
    -- The place's postings (word, hits) and looks, and the frames that it learnt from.
    content BLOB   NOT NULL,
    PRIMARY KEY (map_id, place)
) STRICT, WITHOUT ROWID;
