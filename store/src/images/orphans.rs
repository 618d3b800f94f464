//! Objects that no image of the database is in any more: of sessions that were deleted, of keyframes that
//! went, and of uploads whose commit never came.

use super::objects::{hours_in, now_hours};
use crate::engine::query;
use crate::{Store, StoreError};
use futures_util::TryStreamExt;

/// What was found in an object store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Collected {
    /// Objects there were, of this program.
    pub n_objects: u64,
    /// Of these, how many were removed.
    pub n_removed: u64,
    /// How many bytes those had.
    pub n_removed_bytes: u64,
}

impl Store {
    /// Removes objects that were written at least so many hours ago and that no image is in. What is uploaded
    /// now is named by the database well before that. The object store must be this database's alone.
    ///
    /// # Errors
    /// [`StoreError::Objects`] if there is none or it cannot be used, and whatever the database reports.
    pub async fn collect_orphans(&self, grace_hours: u64) -> Result<Collected, StoreError> {
        let objects = self.objects()?;
        // Of clocks that differ, and of an hour that is not over, nothing is removed too early.
        let written_before = now_hours().saturating_sub(grace_hours);
        let mut collected = Collected::default();
        let mut listed = objects.list();
        while let Some((name, n_bytes)) = listed.try_next().await? {
            let Some(hours) = hours_in(&name) else { continue };
            collected.n_objects += 1;
            if hours >= written_before || self.is_wanted(&name).await? {
                continue;
            }
            objects.remove(&name).await?;
            collected.n_removed += 1;
            collected.n_removed_bytes += n_bytes;
        }
        Ok(collected)
    }

    async fn is_wanted(&self, object: &str) -> Result<bool, StoreError> {
        let mut reader = self.reader().await?;
        let found: Option<i64> = query("SELECT keyframe FROM keyframe_images WHERE object = $1 LIMIT 1")
            .bind(object)
            .scalar(&mut reader)
            .await?;
        Ok(found.is_some())
    }
}
