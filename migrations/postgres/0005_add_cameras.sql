-- As migrations/0014_add_cameras.sql.
ALTER TABLE sessions ADD COLUMN map                TEXT COLLATE "C";
ALTER TABLE sessions ADD COLUMN camera_number      BIGINT NOT NULL DEFAULT 0;
ALTER TABLE sessions ADD COLUMN last_camera_number BIGINT NOT NULL DEFAULT 0;

CREATE INDEX sessions_by_map ON sessions (map) WHERE map IS NOT NULL;

ALTER TABLE keyframes ADD COLUMN camera BIGINT NOT NULL DEFAULT 0;

CREATE TABLE added_cameras (
    session    BIGINT NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    camera     BIGINT NOT NULL,
    parameters TEXT   NOT NULL,
    PRIMARY KEY (session, camera)
);
