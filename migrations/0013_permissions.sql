-- Tokens may be limited: to reading, to some abilities, to some maps, to a time; and have their secrets replaced. Tokens that
-- are there already have none of these limits.
CREATE TABLE limited_tokens (
    name                 TEXT    NOT NULL PRIMARY KEY,
    role                 TEXT    NOT NULL CHECK (role IN ('reader', 'robot', 'admin')),
    -- SHA-256 of the secret. The secret is 256 random bits, so that nothing slower is needed.
    secret_sha256        BLOB    NOT NULL UNIQUE,
    created_ns           INTEGER NOT NULL,
    -- Names with commas between them. NULL: all that the role may do.
    abilities            TEXT,
    -- Names, or beginnings of names and an asterisk, with commas between them. NULL: all maps.
    maps                 TEXT,
    -- NULL: it does not expire.
    expires_ns           INTEGER,
    -- The secret before the last rotation, and until when it is good.
    former_secret_sha256 BLOB    UNIQUE,
    former_until_ns      INTEGER,
    CHECK ((former_secret_sha256 IS NULL) = (former_until_ns IS NULL))
) STRICT;
INSERT INTO limited_tokens (name, role, secret_sha256, created_ns)
    SELECT name, role, secret_sha256, created_ns FROM tokens;
DROP TABLE tokens;
ALTER TABLE limited_tokens RENAME TO tokens;

-- The maps that a job reads or writes: names with commas between them, empty if it is about none. NULL: not known, as of
-- jobs that were cut off or failed before this was noted. Those are shown to tokens for all maps alone.
ALTER TABLE jobs ADD COLUMN maps TEXT;
UPDATE jobs SET maps = '' WHERE kind = 'train_model';
