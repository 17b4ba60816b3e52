-- Media may lie outside the database: then a row names its object, with how many bytes that has and their SHA-256, and its
-- content is empty. That is for PostgreSQL alone; the columns are here because both databases get the same statements.
ALTER TABLE frame_media ADD COLUMN object        TEXT;
ALTER TABLE frame_media ADD COLUMN object_bytes  INTEGER;
ALTER TABLE frame_media ADD COLUMN object_sha256 BLOB;
