-- What of a session's images is not the scene: black borders, watermarks, a car's bonnet. It is left out of points and lines.

-- The share of the image that is left out; NULL while nothing is.
ALTER TABLE sessions ADD COLUMN mask_share REAL;
-- Whether it was given with the session, and not found.
ALTER TABLE sessions ADD COLUMN mask_given INTEGER NOT NULL DEFAULT 0;

CREATE TABLE session_masks (
    session INTEGER PRIMARY KEY REFERENCES sessions (number) ON DELETE CASCADE,
    runs    BLOB    NOT NULL -- see vision/src/mask/runs.rs
) STRICT;
