-- Lines and global primitives: line landmarks with who sees them, vanishing points of key frames, and the directions
-- of the world that key frames share. Conventions as in 0001. What was stored before has none of them, which the
-- defaults say.
--
-- Segments need no table: they are in keyframe_features, from format version 2 on.

ALTER TABLE sessions ADD COLUMN last_line_id      INTEGER NOT NULL DEFAULT 0;
ALTER TABLE sessions ADD COLUMN last_primitive_id INTEGER NOT NULL DEFAULT 0;
ALTER TABLE sessions ADD COLUMN n_lines           INTEGER NOT NULL DEFAULT 0;
ALTER TABLE sessions ADD COLUMN n_primitives      INTEGER NOT NULL DEFAULT 0;

-- Segments measured in the key frame, and how many of them see a line.
ALTER TABLE keyframes ADD COLUMN n_segments INTEGER NOT NULL DEFAULT 0;
ALTER TABLE keyframes ADD COLUMN n_lines    INTEGER NOT NULL DEFAULT 0;

-- Vanishing points of key frames that show some. Which primitive each belongs to is in `primitives` alone, so that
-- these rows are written once.
CREATE TABLE keyframe_vanishing (
    session   INTEGER NOT NULL,
    keyframe  INTEGER NOT NULL,
    vanishing BLOB    NOT NULL, -- direction, covariance and segments of each
    PRIMARY KEY (session, keyframe),
    FOREIGN KEY (session, keyframe) REFERENCES keyframes (session, id) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

-- Lines with who sees them; observations as those of points.
CREATE TABLE lines (
    session        INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    id             INTEGER NOT NULL,
    submap         INTEGER NOT NULL,
    -- The infinite line in the world, in Plücker coordinates: moment and unit direction.
    moment_x REAL NOT NULL, moment_y REAL NOT NULL, moment_z REAL NOT NULL,
    direction_x REAL NOT NULL, direction_y REAL NOT NULL, direction_z REAL NOT NULL,
    -- The ends of the part that was seen.
    start_x REAL NOT NULL, start_y REAL NOT NULL, start_z REAL NOT NULL,
    end_x REAL NOT NULL, end_y REAL NOT NULL, end_z REAL NOT NULL,
    descriptor     BLOB    NOT NULL CHECK (length(descriptor) = 32),
    -- The key frame that made it, which may have been removed since.
    created_by     INTEGER NOT NULL,
    n_visible      INTEGER NOT NULL,
    n_found        INTEGER NOT NULL,
    -- The primitive whose direction it has; NULL while none is known.
    primitive      INTEGER,
    n_observations INTEGER NOT NULL,
    observations   BLOB    NOT NULL, -- key frame and segment of each sighting
    PRIMARY KEY (session, id)
) STRICT, WITHOUT ROWID;

-- Asking for a primitive's lines.
CREATE INDEX lines_by_primitive ON lines (session, primitive) WHERE primitive IS NOT NULL;

-- Where lines are: the box of cells the ends lie in (see store/src/lines/cells.rs), as point_cells.
CREATE VIRTUAL TABLE line_cells USING rtree (
    key, session_min, session_max, x_min, x_max, y_min, y_max, z_min, z_max
);

-- Global primitives: directions of the world with the key frames they tie. A session has some dozens.
CREATE TABLE primitives (
    session        INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    id             INTEGER NOT NULL,
    submap         INTEGER NOT NULL,
    -- Unit vector in the world; it equals its negative.
    direction_x REAL NOT NULL, direction_y REAL NOT NULL, direction_z REAL NOT NULL,
    -- Nine doubles, row by row; radians squared.
    covariance     BLOB    NOT NULL CHECK (length(covariance) = 72),
    -- The key frame that made it, which may have been removed since.
    created_by     INTEGER NOT NULL,
    n_observations INTEGER NOT NULL,
    observations   BLOB    NOT NULL, -- key frame and vanishing point of each sighting
    PRIMARY KEY (session, id)
) STRICT, WITHOUT ROWID;
