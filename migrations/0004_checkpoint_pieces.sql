-- Checkpoints in pieces, so that one costs what changed and not what the map is. Former ones are dropped: a map is
-- replayed from its log once, and writes its new checkpoint then.
DROP TABLE checkpoint_places;
DROP TABLE checkpoints;

-- A checkpoint is the fold of the log up to `events`, so that a map opens without replaying it. It
-- can be deleted at any time. Rows of the other tables mean nothing without this one.
CREATE TABLE checkpoints (
    map_id INTEGER NOT NULL PRIMARY KEY REFERENCES maps (id) ON DELETE CASCADE,
    events INTEGER NOT NULL,
    -- How many places, links and sessions there are, with a checksum: pieces that do not add up are no map.
    head   BLOB    NOT NULL
) STRICT;

CREATE TABLE checkpoint_sessions (
    map_id  INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    session INTEGER NOT NULL,
    content BLOB    NOT NULL,
    PRIMARY KEY (map_id, session)
) STRICT, WITHOUT ROWID;

-- Links in order of creation, so many to a row that only the last row is written again.
CREATE TABLE checkpoint_links (
    map_id     INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    first_link INTEGER NOT NULL,
    content    BLOB    NOT NULL,
    PRIMARY KEY (map_id, first_link)
) STRICT;

-- Sealed: places that follow each other, up to a mebibyte of them, as of log position `events`.
CREATE TABLE checkpoint_blocks (
    map_id      INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    first_place INTEGER NOT NULL,
    places      INTEGER NOT NULL,
    events      INTEGER NOT NULL,
    content     BLOB    NOT NULL,
    PRIMARY KEY (map_id, first_place)
) STRICT;

-- Places that are not sealed yet, or have changed since: these rows hold over the blocks. When enough have come
-- together they are merged into their block.
CREATE TABLE checkpoint_places (
    map_id  INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    place   INTEGER NOT NULL,
    events  INTEGER NOT NULL,
    content BLOB    NOT NULL,
    PRIMARY KEY (map_id, place)
) STRICT, WITHOUT ROWID;
