-- How long the camera takes to read the rows of an image, nanoseconds, and its standard deviation, where that was
-- not told and the session has found it: it is taken out of what the keyframes measured. NULL until then.
ALTER TABLE sessions ADD COLUMN found_readout_ns INTEGER;
ALTER TABLE sessions ADD COLUMN found_readout_sigma_ns INTEGER;
