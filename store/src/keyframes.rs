//! Keyframes without their features, and their images.

use crate::cameras::map_number;
use crate::engine::{Connection, Row, query};
use crate::number::{from_column, from_column_u32, keyframe_column, keyframe_id, submap_id};
use crate::pose::read_pose;
use crate::{Page, Store, StoreError};
use geometry::Pose;
use slam::map::{KeyframeId, SubmapId};

/// A stored keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframeRecord {
    /// Identity within the session.
    pub id: KeyframeId,
    /// The submap whose frame of reference the pose is in.
    pub submap: SubmapId,
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// Pose; lengths in map units.
    pub camera_from_world: Pose,
    /// The keyframe it hangs on in the spanning tree.
    pub parent: Option<KeyframeId>,
    /// Keypoints measured in it.
    pub n_keypoints: u32,
    /// Keypoints that see a point.
    pub n_points: u32,
    /// Segments measured in it.
    pub n_segments: u32,
    /// Segments that see a line.
    pub n_lines: u32,
    /// Whether its image was kept.
    pub has_image: bool,
}

/// The image of a keyframe as it was received.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredImage {
    /// What the bytes are, such as `image/png`.
    pub media_type: String,
    /// The encoded image.
    pub bytes: Vec<u8>,
}

const SELECT_KEYFRAMES: &str = "SELECT id, submap, sequence, timestamp_ns, qx, qy, qz, qw, tx, ty, tz, parent, \
     n_keypoints, n_points, n_segments, n_lines, \
     EXISTS (SELECT 1 FROM keyframe_images i WHERE i.session = k.session AND i.keyframe = k.id) \
     FROM keyframes k WHERE session = $1 AND id BETWEEN $2 AND $3 ORDER BY id LIMIT $4";

impl Store {
    /// Up to `page_size` keyframes with ids above the given one.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn keyframes(
        &self,
        session: &str,
        after: Option<KeyframeId>,
        page_size: u32,
    ) -> Result<Page<KeyframeRecord, KeyframeId>, StoreError> {
        let first = after.map(keyframe_column).transpose()?.unwrap_or(0).saturating_add(1);
        let keyframes = self.select_keyframes(session, first, i64::MAX, i64::from(page_size) + 1).await?;
        Ok(Page::of(keyframes, page_size, |last| last.id))
    }

    /// One keyframe; `None` if the session has none with this id, or no longer.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn keyframe(
        &self,
        session: &str,
        id: KeyframeId,
    ) -> Result<Option<KeyframeRecord>, StoreError> {
        let id = keyframe_column(id)?;
        Ok(self.select_keyframes(session, id, id, 1).await?.pop())
    }

    async fn select_keyframes(
        &self,
        session: &str,
        first: i64,
        last: i64,
        limit: i64,
    ) -> Result<Vec<KeyframeRecord>, StoreError> {
        let mut reader = self.reader().await?;
        let number = map_number(&mut reader, session).await?;
        select_keyframes(&mut reader, number, first, last, limit).await
    }
}

/// Keyframes with ids from `first` to `last`, at most `limit`.
pub(crate) async fn select_keyframes(
    connection: &mut Connection,
    session: i64,
    first: i64,
    last: i64,
    limit: i64,
) -> Result<Vec<KeyframeRecord>, StoreError> {
    let rows = query(SELECT_KEYFRAMES)
        .bind(session)
        .bind(first)
        .bind(last)
        .bind(limit)
        .fetch_all(connection)
        .await?;
    rows.iter().map(parse_keyframe).collect()
}

fn parse_keyframe(row: &Row) -> Result<KeyframeRecord, StoreError> {
    let parent: Option<i64> = row.try_get(11)?;
    Ok(KeyframeRecord {
        id: keyframe_id(row.try_get(0)?)?,
        submap: submap_id(row.try_get(1)?)?,
        sequence: from_column("a sequence", row.try_get(2)?)?,
        timestamp_ns: row.try_get(3)?,
        camera_from_world: read_pose(row, 4)?,
        parent: parent.map(keyframe_id).transpose()?,
        n_keypoints: from_column_u32("n_keypoints", row.try_get(12)?)?,
        n_points: from_column_u32("n_points", row.try_get(13)?)?,
        n_segments: from_column_u32("n_segments", row.try_get(14)?)?,
        n_lines: from_column_u32("n_lines", row.try_get(15)?)?,
        has_image: row.try_get(16)?,
    })
}
