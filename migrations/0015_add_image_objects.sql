-- Images may lie in an object store instead (`storage.objects`): then `bytes` is empty, and this names the object and says how
-- many bytes it has.
ALTER TABLE keyframe_images ADD COLUMN object TEXT;
ALTER TABLE keyframe_images ADD COLUMN object_bytes INTEGER NOT NULL DEFAULT 0;

-- Whether an object is still wanted is asked when those are looked for that are not.
CREATE INDEX keyframe_images_by_object ON keyframe_images (object) WHERE object IS NOT NULL;
