-- What robots call their frames, as by the file that an image came from. Beside the log, which decides nothing by
-- it; frames of earlier versions have none.
CREATE TABLE frame_notes (
    map_id   INTEGER NOT NULL REFERENCES maps (id) ON DELETE CASCADE,
    -- The frame's position in the log.
    position INTEGER NOT NULL,
    note     TEXT    NOT NULL,
    PRIMARY KEY (map_id, position)
) STRICT, WITHOUT ROWID;
