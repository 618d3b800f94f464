-- How a session's camera differs from its calibration, as far as the session has found out. `sessions.camera` stays as it was
-- given, and so do the pixels of all key frames; what changes is which rays they belong to.

-- Relative change of both focal lengths.
ALTER TABLE sessions ADD COLUMN focal_correction REAL NOT NULL DEFAULT 0;
-- Shift of the principal point to the right and downwards, in focal lengths.
ALTER TABLE sessions ADD COLUMN centre_x_correction REAL NOT NULL DEFAULT 0;
ALTER TABLE sessions ADD COLUMN centre_y_correction REAL NOT NULL DEFAULT 0;
