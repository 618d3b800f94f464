-- As migrations/0015_add_image_objects.sql.
ALTER TABLE keyframe_images ADD COLUMN object TEXT;
ALTER TABLE keyframe_images ADD COLUMN object_bytes BIGINT NOT NULL DEFAULT 0;
CREATE INDEX keyframe_images_by_object ON keyframe_images (object) WHERE object IS NOT NULL;
