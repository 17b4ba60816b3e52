-- Jobs of more kinds. The table is made anew, since a constraint cannot be changed; no number is given twice.
CREATE TABLE jobs_of_all_kinds (
    number     INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    kind       TEXT    NOT NULL,
    state      TEXT    NOT NULL CHECK (state IN ('running', 'succeeded', 'failed', 'cancelled')),
    -- What it is, or was last, busy with.
    stage      TEXT    NOT NULL,
    -- What it made: models/{hash}, maps/{map} or merges/{number}.
    result     TEXT,
    -- Why it failed, for the user.
    error      TEXT,
    created_ns INTEGER NOT NULL,
    ended_ns   INTEGER
) STRICT;

INSERT INTO jobs_of_all_kinds SELECT number, kind, state, stage, result, error, created_ns, ended_ns FROM jobs;
DELETE FROM sqlite_sequence WHERE name = 'jobs_of_all_kinds';
INSERT INTO sqlite_sequence (name, seq) SELECT 'jobs_of_all_kinds', seq FROM sqlite_sequence WHERE name = 'jobs';
DROP TABLE jobs;
ALTER TABLE jobs_of_all_kinds RENAME TO jobs;

-- Maps that become one: looked for, waiting for somebody to decide, or decided.
CREATE TABLE merges (
    number     INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    -- The name of the map that the sources go into.
    target     TEXT    NOT NULL,
    -- That map, once it has them.
    map_id     INTEGER REFERENCES maps (id) ON DELETE SET NULL,
    -- What works on it, or did last.
    job        INTEGER NOT NULL,
    state      TEXT    NOT NULL
        CHECK (state IN ('searching', 'proposed', 'apart', 'committed', 'discarded', 'undone', 'failed')),
    -- What was found, as JSON.
    report     TEXT    NOT NULL,
    -- The maps before and after, as SVG; NULL until they are known.
    picture    TEXT,
    -- Why it failed, for the user.
    error      TEXT,
    created_ns INTEGER NOT NULL
) STRICT;

-- The merge that brought a session; NULL for one that drove into this map itself.
ALTER TABLE sessions ADD COLUMN merge INTEGER;

-- How often the map's log was told anew, without some sessions. What was found out about an earlier edition means
-- nothing for a later one.
ALTER TABLE maps ADD COLUMN edition INTEGER NOT NULL DEFAULT 0;
