-- Who may use the server: bearer tokens, each with a role and, but for administrators, an owner of sessions.
--
-- A session belongs to the owner whose name stands before `~` in sessions.id, `alice~kitchen`. Names of sessions and
-- owners have no `~` themselves, so that every owner has all names to choose from and cannot meet another's. Sessions
-- from before there were tokens have no owner; administrators alone see them.
--
-- Rows are never removed: a token that was revoked still says that the server is not open to everybody.
-- created_at_ns, expires_at_ns and revoked_at_ns are wall-clock time.
CREATE TABLE tokens (
    id               INTEGER PRIMARY KEY,
    name             TEXT    NOT NULL UNIQUE, -- what people call it
    -- SHA-256 of the token. Tokens are 256 random bits, which nobody finds by trying, so that a slow hash gains nothing.
    hash             BLOB    NOT NULL UNIQUE,
    role             INTEGER NOT NULL CHECK (role IN (1, 2, 3)), -- reader, writer, admin
    owner            TEXT    CHECK ((owner IS NULL) = (role = 3)),
    created_at_ns    INTEGER NOT NULL,
    expires_at_ns    INTEGER, -- NULL: never
    revoked_at_ns    INTEGER, -- NULL: it is good
    -- What the token may use at most; NULL is what the server's configuration says.
    max_sessions     INTEGER,
    max_streams      INTEGER,
    max_frames_per_s REAL,
    max_stored_bytes INTEGER
) STRICT;
