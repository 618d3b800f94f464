-- Whether images are worked on enlarged since a border, such as the rim of a lens, leaves a small part of
-- them: the pixels of the session's keyframes are then those of the enlarged image.
ALTER TABLE sessions ADD COLUMN enlarges_for_border INTEGER NOT NULL DEFAULT 0;
-- Whether the images were found to contradict the camera as it was given: its poses are weak ones from then
-- on.
ALTER TABLE sessions ADD COLUMN calibration_contradicted INTEGER NOT NULL DEFAULT 0;
