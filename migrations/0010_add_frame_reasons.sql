-- Why a frame has no good pose, in a plain sentence; NULL for a good one, and for frames of before.
ALTER TABLE frames ADD COLUMN reason TEXT;
