-- Radial distortion of a session's camera that its calibration does not describe, as far as the session has found out: what
-- undistorted pixels of the calibration become also depends on it. See `geometry::CameraCorrection`.
ALTER TABLE sessions ADD COLUMN k1_correction REAL NOT NULL DEFAULT 0;
ALTER TABLE sessions ADD COLUMN k2_correction REAL NOT NULL DEFAULT 0;
