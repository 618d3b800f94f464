-- Which server works with which session, so that several serve one database.
--
-- A session's epoch rises whenever it is taken by a server. What a server writes into a session it has taken carries the
-- epoch it took it with, and is refused if that is not the newest: so a server that stood still writes nothing into what
-- another has taken meanwhile. Both happen under the lock of the session's row, so that a taker waits for a transaction
-- that is under way.
ALTER TABLE sessions ADD COLUMN epoch BIGINT NOT NULL DEFAULT 0;

-- Apart from sessions: renewed every few seconds, without waiting for who writes the session.
CREATE TABLE leases (
    session      BIGINT PRIMARY KEY REFERENCES sessions (number) ON DELETE CASCADE,
    epoch        BIGINT NOT NULL,
    -- The server: no two that run at the same time are called the same.
    owner        TEXT   NOT NULL,
    -- Where clients reach it.
    grpc_url     TEXT   NOT NULL,
    http_url     TEXT   NOT NULL,
    -- By this database's clock.
    expires_at   TIMESTAMPTZ NOT NULL
) WITH (fillfactor = 50);
