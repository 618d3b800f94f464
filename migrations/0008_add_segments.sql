-- Where a client said that its clock is another from here on: it was set, or the machine was started anew.
--
-- Times in frames and keyframes are the client's. Within a session the engine needs times that only go on: those are the
-- client's plus ahead_ns of the last segment that begins at or before the frame; 0 before the first.
CREATE TABLE segments (
    session        INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    first_sequence INTEGER NOT NULL,
    ahead_ns       INTEGER NOT NULL,
    PRIMARY KEY (session, first_sequence)
) STRICT, WITHOUT ROWID;
