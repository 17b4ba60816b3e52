-- Where the owner is asked by the other servers of its fleet, and the word by which it knows them.
ALTER TABLE lease
    ADD COLUMN grpc_address TEXT NOT NULL DEFAULT '',
    ADD COLUMN http_address TEXT NOT NULL DEFAULT '',
    ADD COLUMN secret       TEXT NOT NULL DEFAULT gen_random_uuid()::text;

-- Servers that do not own the database, and look at images for the one that does.
CREATE TABLE helpers (
    id      BIGINT      NOT NULL GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    -- The server, for people.
    holder  TEXT        NOT NULL,
    -- Another version may look at images otherwise.
    version TEXT        NOT NULL,
    -- Where it is asked over HTTP.
    address TEXT        NOT NULL,
    -- Images that it can look at side by side.
    cores   BIGINT      NOT NULL,
    -- By this database's clock.
    seen    TIMESTAMPTZ NOT NULL
);
