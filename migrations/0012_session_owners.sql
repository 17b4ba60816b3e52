-- A session is gone on with by the token that opened it, and by admins. NULL: it was opened without one, or before there were
-- owners, and whoever may stream may go on with it.
ALTER TABLE sessions ADD COLUMN owner TEXT;
