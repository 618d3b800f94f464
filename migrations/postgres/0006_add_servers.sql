-- The servers of this database, as they report themselves, so that each knows where the others are and who has room.
CREATE TABLE servers (
    name        TEXT PRIMARY KEY,
    grpc_url    TEXT    NOT NULL,
    http_url    TEXT    NOT NULL,
    version     TEXT    NOT NULL,
    -- Sessions in its memory, and how many of them a client streams into.
    n_loaded    BIGINT  NOT NULL,
    n_streams   BIGINT  NOT NULL,
    -- Streams it takes beyond these.
    n_free      BIGINT  NOT NULL,
    -- It is about to stop: it takes no further sessions and hands over those it has.
    is_leaving  BOOLEAN NOT NULL,
    -- By this database's clock. One that is not heard of is left out from then on.
    expires_at  TIMESTAMPTZ NOT NULL
) WITH (fillfactor = 50);

-- What servers of one database prove to each other that they are: 244 random bits.
CREATE TABLE fleet_key (
    only_row    BOOLEAN PRIMARY KEY DEFAULT TRUE CHECK (only_row),
    secret      BYTEA NOT NULL
);
INSERT INTO fleet_key (secret)
VALUES (decode(replace(gen_random_uuid()::text || gen_random_uuid()::text, '-', ''), 'hex'));
