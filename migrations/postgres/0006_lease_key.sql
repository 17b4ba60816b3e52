-- Whose the database is changes with the epoch. As a key, that waits for what the owner writes just now, while to say that the
-- owner is there does not.
CREATE UNIQUE INDEX lease_epoch ON lease (epoch);
