-- Whether the session's small images are worked on enlarged: the pixels of its keyframes are then those of the enlarged image.
-- Sessions from before that was done go on with images as they are.
ALTER TABLE sessions ADD COLUMN enlarges_small_images INTEGER NOT NULL DEFAULT 0;
