-- What people call places. Labels decide nothing, so they are beside the log. Several places may bear one, as those of a
-- room do; a place bears one at most.
CREATE TABLE labels (
    map_id INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    place  INTEGER NOT NULL,
    label  TEXT    NOT NULL,
    PRIMARY KEY (map_id, place)
) STRICT, WITHOUT ROWID;
