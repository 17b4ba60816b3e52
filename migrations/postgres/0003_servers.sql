-- What the servers of a database say of themselves to whoever looks after them.
ALTER TABLE lease
    ADD COLUMN version TEXT   NOT NULL DEFAULT '',
    ADD COLUMN cores   BIGINT NOT NULL DEFAULT 0;
ALTER TABLE helpers
    ADD COLUMN grpc_address TEXT NOT NULL DEFAULT '';
