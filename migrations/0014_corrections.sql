-- What people say of loop closures is in the log, as events that are no frames and have a reason: closure_withdrawn,
-- closure_confirmed, correction_undone. matched_frame is the frame that the first two are of, and the position of the
-- correction that the last one undoes. Every list of frames or loop closures asks for them, and they are few.
CREATE INDEX log_corrections ON log (map_id, position) WHERE sequence IS NULL AND reason IS NOT NULL;
