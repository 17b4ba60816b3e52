-- What the panoramas of a map have in common, so that a map opens without comparing them anew. Like a checkpoint it can
-- be deleted at any time: the log and the features say it all.
CREATE TABLE appearance_graphs (
    map_id     INTEGER NOT NULL PRIMARY KEY REFERENCES maps (id) ON DELETE CASCADE,
    -- By which links were found: those of other rules are not taken.
    rules      INTEGER NOT NULL,
    -- Places below have all their links to earlier ones.
    next_place INTEGER NOT NULL
) STRICT;

CREATE TABLE appearance_links (
    map_id     INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    place      INTEGER NOT NULL,
    earlier    INTEGER NOT NULL CHECK (earlier < place),
    similarity REAL    NOT NULL CHECK (similarity > 0 AND similarity <= 1),
    PRIMARY KEY (map_id, place, earlier)
) STRICT, WITHOUT ROWID;
