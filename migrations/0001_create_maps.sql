-- Sessions and their maps: key frames, points, and the trajectory of every frame.
--
-- Conventions. A pose `target_from_source` is a unit quaternion (qx, qy, qz, qw; Hamilton) and a translation
-- (tx, ty, tz) in map units; a key frame's is camera_from_world, a frame's camera_from_reference. Times end in
-- _ns. Ids, sequences and timestamps are those of the engine. Blobs are described, with their format versions, in
-- store/src/blob/. The only column that holds wall-clock time is sessions.created_at_ns.
--
-- Every table but sessions begins its key with the session's number, so that a session's rows lie together and
-- need no further index. Tables of small rows are WITHOUT ROWID: one b-tree, no second look-up.

CREATE TABLE sessions (
    -- Internal short name; 23 bits, because a point's key in the R*Tree has no more room for it.
    number            INTEGER PRIMARY KEY CHECK (number BETWEEN 1 AND 8388607),
    -- The name the client knows; NULL while the rows of a deleted session are being cleared away.
    id                TEXT UNIQUE,
    camera            TEXT    NOT NULL, -- JSON, see store/src/session/
    options           TEXT    NOT NULL, -- JSON
    created_at_ns     INTEGER NOT NULL, -- wall clock, nanoseconds since 1970
    state             INTEGER NOT NULL, -- as frames.state
    -- The newest frame in `frames`; NULL before the first.
    last_sequence     INTEGER,
    last_timestamp_ns INTEGER,
    -- Highest ids ever given out, so that none is used twice.
    last_keyframe_id  INTEGER NOT NULL DEFAULT 0,
    last_point_id     INTEGER NOT NULL DEFAULT 0,
    n_frames          INTEGER NOT NULL DEFAULT 0,
    n_keyframes       INTEGER NOT NULL DEFAULT 0,
    n_points          INTEGER NOT NULL DEFAULT 0,
    n_submaps         INTEGER NOT NULL DEFAULT 0,
    -- Metres per map unit; NULL while the scale is free. Rows stay in map units.
    metres_per_unit   REAL
) STRICT;

CREATE TABLE keyframes (
    session      INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    id           INTEGER NOT NULL,
    submap       INTEGER NOT NULL,
    sequence     INTEGER NOT NULL,
    timestamp_ns INTEGER NOT NULL,
    -- camera_from_world
    qx REAL NOT NULL, qy REAL NOT NULL, qz REAL NOT NULL, qw REAL NOT NULL,
    tx REAL NOT NULL, ty REAL NOT NULL, tz REAL NOT NULL,
    -- The key frame this one hangs on in the spanning tree; NULL for the first of a submap.
    parent       INTEGER,
    n_keypoints  INTEGER NOT NULL,
    -- How many of them see a point.
    n_points     INTEGER NOT NULL,
    PRIMARY KEY (session, id),
    -- Deferred: one transaction may remove a key frame and re-hang its children in any order.
    FOREIGN KEY (session, parent) REFERENCES keyframes (session, id) DEFERRABLE INITIALLY DEFERRED
) STRICT, WITHOUT ROWID;

-- Removing a key frame looks for its children.
CREATE INDEX keyframes_by_parent ON keyframes (session, parent);

-- What the front end measured. Apart from keyframes because it never changes and is a hundred times larger: a key
-- frame that moves rewrites its pose alone.
CREATE TABLE keyframe_features (
    session  INTEGER NOT NULL,
    keyframe INTEGER NOT NULL,
    features BLOB    NOT NULL, -- keypoints and descriptors
    PRIMARY KEY (session, keyframe),
    FOREIGN KEY (session, keyframe) REFERENCES keyframes (session, id) ON DELETE CASCADE
) STRICT;

-- The image as it was received, where keeping images is on.
CREATE TABLE keyframe_images (
    session    INTEGER NOT NULL,
    keyframe   INTEGER NOT NULL,
    media_type TEXT    NOT NULL, -- such as image/png
    bytes      BLOB    NOT NULL,
    PRIMARY KEY (session, keyframe),
    FOREIGN KEY (session, keyframe) REFERENCES keyframes (session, id) ON DELETE CASCADE
) STRICT;

-- Where removed key frames were, so that frames that refer to them keep their place.
CREATE TABLE removed_keyframes (
    session INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    id      INTEGER NOT NULL,
    -- A key frame, or another removed one.
    anchor  INTEGER NOT NULL,
    -- camera_from_anchor
    qx REAL NOT NULL, qy REAL NOT NULL, qz REAL NOT NULL, qw REAL NOT NULL,
    tx REAL NOT NULL, ty REAL NOT NULL, tz REAL NOT NULL,
    PRIMARY KEY (session, id)
) STRICT, WITHOUT ROWID;

-- Points with who sees them. The observations are a packed list in the point's row and nowhere else: bundle
-- adjustment rewrites thousands of points at a time, and a row per sighting would be five times as many rows.
CREATE TABLE points (
    session        INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    id             INTEGER NOT NULL,
    submap         INTEGER NOT NULL,
    -- Position in the world.
    x REAL NOT NULL, y REAL NOT NULL, z REAL NOT NULL,
    descriptor     BLOB    NOT NULL CHECK (length(descriptor) = 32),
    -- Mean unit direction from the observing cameras.
    view_x REAL NOT NULL, view_y REAL NOT NULL, view_z REAL NOT NULL,
    -- Distances between which the pyramid can see the point; the greater may be infinite.
    min_distance   REAL    NOT NULL,
    max_distance   REAL    NOT NULL,
    -- The key frame that made it, which may have been removed since.
    created_by     INTEGER NOT NULL,
    n_visible      INTEGER NOT NULL,
    n_found        INTEGER NOT NULL,
    n_observations INTEGER NOT NULL,
    observations   BLOB    NOT NULL, -- key frame and keypoint of each sighting
    PRIMARY KEY (session, id)
) STRICT, WITHOUT ROWID;

-- Where points are: one box per point, by session. The box is the grid cell the point lies in (see
-- store/src/points/cell.rs), so that a point that moves a little leaves the tree alone; exact positions are compared
-- in `points`. `key` is session << 40 | id.
CREATE VIRTUAL TABLE point_cells USING rtree (
    key, session_min, session_max, x_min, x_max, y_min, y_max, z_min, z_max
);

-- The trajectory. Poses hang on key frames and are resolved when asked for, so a corrected map moves its frames
-- without rewriting them.
CREATE TABLE frames (
    session      INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
    sequence     INTEGER NOT NULL,
    timestamp_ns INTEGER NOT NULL,
    state        INTEGER NOT NULL, -- 1 initialising, 2 tracked, 3 weak, 4 lost
    backfilled   INTEGER NOT NULL, -- 1: the pose was found after the frame was answered
    submap       INTEGER,
    -- A key frame, or a removed one; NULL without a pose.
    reference    INTEGER,
    -- camera_from_reference
    qx REAL, qy REAL, qz REAL, qw REAL,
    tx REAL, ty REAL, tz REAL,
    PRIMARY KEY (session, sequence)
) STRICT, WITHOUT ROWID;
