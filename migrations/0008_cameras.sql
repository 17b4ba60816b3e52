-- Cameras have a byte form of their own (server/src/camera/bytes.rs) and are no longer the messages that robots sent:
-- what the contract renames must not change what is stored. The server rewrites the messages as it opens the database,
-- for SQL cannot read them; one that is no camera stays where it is.
ALTER TABLE sessions RENAME COLUMN camera TO camera_message;
ALTER TABLE sessions ADD COLUMN camera BLOB;
