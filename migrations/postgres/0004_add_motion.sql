-- As migrations/0013_add_motion.sql.
CREATE TABLE motion (
    session    BIGINT NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    first_ns   BIGINT NOT NULL,
    n_readings BIGINT NOT NULL,
    readings   BYTEA  NOT NULL,
    PRIMARY KEY (session, first_ns)
);
