-- What words and geometry together say of a loop closure; null where nothing was verified.
ALTER TABLE log ADD COLUMN probability REAL;
