-- What the motion sensors of a session's device measured, as the device sent it: kept for who works with it, not used by
-- the engine. Sent once more it stands in the same row.
CREATE TABLE motion (
    session    INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    -- Time of the first reading, of the client's clock as frames.timestamp_ns.
    first_ns   INTEGER NOT NULL,
    n_readings INTEGER NOT NULL,
    readings   BLOB    NOT NULL, -- see store/src/blob/motion.rs
    PRIMARY KEY (session, first_ns)
) STRICT;
