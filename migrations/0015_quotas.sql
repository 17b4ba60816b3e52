-- Tokens may have quotas: of maps, sessions, frames a second and of what their sessions keep. NULL: there is no limit, as for
-- the tokens that are there already.
ALTER TABLE tokens ADD COLUMN max_maps              INTEGER;
ALTER TABLE tokens ADD COLUMN max_sessions          INTEGER;
ALTER TABLE tokens ADD COLUMN max_frames_per_second REAL;
ALTER TABLE tokens ADD COLUMN max_kept_mib          INTEGER;

-- The token that made a map, whose quota it counts for. NULL: it was made without one, or before this was noted.
ALTER TABLE maps ADD COLUMN owner TEXT;

-- What a session keeps: events of the log, features, thumbnails and images. Noted with each commit, so that no frame costs a
-- look at all that is there. What is there already is counted when the server starts next.
ALTER TABLE sessions ADD COLUMN kept_bytes INTEGER NOT NULL DEFAULT 0;
INSERT INTO upkeep (task) VALUES ('kept_bytes');
