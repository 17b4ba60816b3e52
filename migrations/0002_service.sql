-- A map that is being brought in, or taken away piece by piece, is there but not to be seen.
ALTER TABLE maps ADD COLUMN state TEXT NOT NULL DEFAULT 'live' CHECK (state IN ('live', 'importing', 'deleting'));

-- Models that a map was bound to before, and the log position from which each no longer was: who asks why
-- an old frame was decided as it was needs the model of that time. No reference: an old model may be deleted.
CREATE TABLE map_models (
    map_id       INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    until_events INTEGER NOT NULL,
    model        TEXT    NOT NULL,
    PRIMARY KEY (map_id, until_events)
) STRICT, WITHOUT ROWID;

-- What a map keeps of a frame beside its words. Apart from the log, which is read often and whole.
CREATE TABLE frame_media (
    map_id   INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    -- The frame's position in the log.
    position INTEGER NOT NULL,
    kind     TEXT    NOT NULL CHECK (kind IN ('features', 'thumbnail', 'image')),
    content  BLOB    NOT NULL,
    PRIMARY KEY (map_id, position, kind)
) STRICT;

-- Jobs outlive the server as far as their fate goes: one that still runs when the server starts was cut off.
CREATE TABLE jobs (
    number     INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    kind       TEXT    NOT NULL CHECK (kind IN ('train_model', 'import_map')),
    state      TEXT    NOT NULL CHECK (state IN ('running', 'succeeded', 'failed', 'cancelled')),
    -- What it is, or was last, busy with.
    stage      TEXT    NOT NULL,
    -- What it made: models/{hash} or maps/{map}.
    result     TEXT,
    -- Why it failed, for the user.
    error      TEXT,
    created_ns INTEGER NOT NULL,
    ended_ns   INTEGER
) STRICT;

-- Who may use the server. The secret itself is not kept.
CREATE TABLE tokens (
    name          TEXT    NOT NULL PRIMARY KEY,
    role          TEXT    NOT NULL CHECK (role IN ('robot', 'admin')),
    -- SHA-256 of the secret. The secret is 256 random bits, so that nothing slower is needed.
    secret_sha256 BLOB    NOT NULL UNIQUE,
    created_ns    INTEGER NOT NULL
) STRICT;
