-- What a job was asked for, as JSON, by which the next server goes on with it; NULL where none can, as with jobs of earlier
-- versions. And how many servers were killed while they worked on it: one that takes every server with it is given up.
ALTER TABLE jobs ADD COLUMN task  TEXT;
ALTER TABLE jobs ADD COLUMN begun INTEGER NOT NULL DEFAULT 0;
