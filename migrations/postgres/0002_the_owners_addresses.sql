-- Where the owner is asked by the other servers of its fleet, and the word by which it knows them.
ALTER TABLE lease
    ADD COLUMN grpc_address TEXT NOT NULL DEFAULT '',
    ADD COLUMN http_address TEXT NOT NULL DEFAULT '',
    ADD COLUMN secret       TEXT NOT NULL DEFAULT gen_random_uuid()::text;
