-- Corrections of a map may change the scale of a part of it. What hangs on a key frame, frames and removed key frames,
-- keeps its offset in the key frame's own unit and needs no change then.

-- Map units per unit of the offsets of what hangs on the key frame.
ALTER TABLE keyframes ADD COLUMN unit REAL NOT NULL DEFAULT 1;
