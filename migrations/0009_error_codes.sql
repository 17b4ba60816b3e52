-- The kind of an error beside its text, as in 'not_found'. Of earlier failures only the text is known.
ALTER TABLE jobs   ADD COLUMN error_code TEXT NOT NULL DEFAULT 'aborted';
ALTER TABLE merges ADD COLUMN error_code TEXT NOT NULL DEFAULT 'aborted';
