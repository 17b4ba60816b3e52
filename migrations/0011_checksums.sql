-- Rot shows: every event of a log has a checksum, and the checksums of a log are chained, so that an event that is gone or
-- another in its place shows. (Pages of the file have checksums of their own, below SQL.) What was stored before gets its
-- checksums when the server starts next.
ALTER TABLE log ADD COLUMN checksum INTEGER;
ALTER TABLE log ADD COLUMN chain    INTEGER;

-- What is still to be done to rows of earlier versions.
CREATE TABLE upkeep (
    task TEXT NOT NULL PRIMARY KEY
) STRICT, WITHOUT ROWID;
INSERT INTO upkeep (task) VALUES ('log_checksums');

-- Maps of which something was found damaged: nothing is added to them.
CREATE TABLE map_damage (
    map_id   INTEGER NOT NULL PRIMARY KEY REFERENCES maps (id) ON DELETE CASCADE,
    -- What was found first, for people.
    found    TEXT    NOT NULL,
    found_ns INTEGER NOT NULL
) STRICT;
