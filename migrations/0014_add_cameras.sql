-- Sessions whose camera extends the map of another session: that one's rows hold the map, theirs the frames.

-- The session whose map it is; NULL: it has one of its own.
ALTER TABLE sessions ADD COLUMN map TEXT;
-- Which of the map's cameras it is; 0 is the map's own.
ALTER TABLE sessions ADD COLUMN camera_number INTEGER NOT NULL DEFAULT 0;
-- The highest number that was given to a camera of the map, so that none is given twice.
ALTER TABLE sessions ADD COLUMN last_camera_number INTEGER NOT NULL DEFAULT 0;

CREATE INDEX sessions_by_map ON sessions (map) WHERE map IS NOT NULL;

-- The camera that took a keyframe.
ALTER TABLE keyframes ADD COLUMN camera INTEGER NOT NULL DEFAULT 0;

-- Cameras that were added to a map. They stay when their session is deleted: keyframes are theirs.
CREATE TABLE added_cameras (
    session    INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE, -- whose map it is
    camera     INTEGER NOT NULL,
    parameters TEXT    NOT NULL, -- as sessions.camera
    PRIMARY KEY (session, camera)
) STRICT, WITHOUT ROWID;
