-- Media may lie outside the database: then a row names its object, with how many bytes that has and their SHA-256, and its
-- content is empty. Merged maps name the same objects as those they were made of.
ALTER TABLE frame_media
    ADD COLUMN object        TEXT COLLATE "C",
    ADD COLUMN object_bytes  BIGINT,
    ADD COLUMN object_sha256 BYTEA,
    ADD CHECK ((object IS NULL) = (object_bytes IS NULL) AND (object IS NULL) = (object_sha256 IS NULL));
CREATE INDEX frame_media_objects ON frame_media (object) WHERE object IS NOT NULL;

-- Where they lie. The store has an object with the same mark: that tells it from an empty one, and from that of another
-- database.
CREATE TABLE media_store (
    id      BIGINT NOT NULL PRIMARY KEY CHECK (id = 1),
    address TEXT COLLATE "C" NOT NULL,
    mark    TEXT COLLATE "C" NOT NULL
);
