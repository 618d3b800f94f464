//! A whole map, piece by piece, as of one commit.

use crate::blob::positions;
use crate::engine::{Connection, query};
use crate::keyframes::select_keyframes;
use crate::lines::{LineCursor, LineQuery};
use crate::number::{from_column, keyframe_column};
use crate::points::{WHOLE, select_points};
use crate::primitives::read_primitives;
use crate::session::read_session;
use crate::{KeyframeRecord, PointQuery, SessionRecord, Store, StoreError};
use slam::map::{GlobalPrimitive, KeyframeId, LineId, LineLandmark, PointId, PointLandmark, SubmapId};

/// Points or keyframes read at a time: a statement takes about a millisecond.
const ROWS_PER_STEP: usize = 512;

/// A session as of one commit, read in steps. While it lives the log cannot be folded into the file, so read
/// it to the end without waiting for anything slow, such as a client.
pub struct MapSnapshot {
    transaction: Connection,
    session: i64,
    record: SessionRecord,
}

impl Store {
    /// A session as of the last commit.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn snapshot(&self, session: &str) -> Result<MapSnapshot, StoreError> {
        let mut transaction = self.begin_read().await?;
        let (mut session, mut record) = read_session(&mut transaction, session).await?;
        if let Some(map) = record.map {
            (session, record) = read_session(&mut transaction, &map).await?;
        }
        Ok(MapSnapshot { transaction, session, record })
    }
}

impl MapSnapshot {
    /// The session whose map it is.
    pub fn record(&self) -> &SessionRecord {
        &self.record
    }

    pub(crate) fn session(&self) -> i64 {
        self.session
    }

    pub(crate) fn connection(&mut self) -> &mut Connection {
        &mut self.transaction
    }

    /// Points and lines there are, of one submap or of all.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn n_landmarks(&mut self, submap: Option<SubmapId>) -> Result<(u64, u64), StoreError> {
        let mut counts = [0; 2];
        for (count, table) in counts.iter_mut().zip(["points", "lines"]) {
            let sql =
                format!("SELECT count(*) FROM {table} WHERE session = $1 AND submap = coalesce($2, submap)");
            let n = query(sql)
                .bind(self.session)
                .bind(submap.map(|submap| submap.0))
                .only(&mut self.transaction)
                .await?;
            *count = from_column("a count", n)?;
        }
        Ok(counts.into())
    }

    /// The next points with ids above the given one; none at the end.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn points_after(
        &mut self,
        after: Option<PointId>,
        submap: Option<SubmapId>,
    ) -> Result<Vec<PointLandmark>, StoreError> {
        let query = PointQuery { submap, ..PointQuery::default() };
        let after = after.map_or(0, |id| id.get() as i64);
        select_points(&mut self.transaction, &WHOLE, self.session, &query, after, ROWS_PER_STEP).await
    }

    /// The next lines with ids above the given one; none at the end.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn lines_after(
        &mut self,
        after: Option<LineId>,
        submap: Option<SubmapId>,
    ) -> Result<Vec<LineLandmark>, StoreError> {
        let query = LineQuery { submap, ..LineQuery::default() };
        let after = after.map_or(0, |id| id.get() as i64);
        let mut cursor = LineCursor::new(&mut self.transaction, self.session, query, after).await?;
        Ok(cursor.step(&mut self.transaction).await?.unwrap_or_default())
    }

    /// The next keyframes with ids above the given one; none at the end.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn keyframes_after(
        &mut self,
        after: Option<KeyframeId>,
    ) -> Result<Vec<KeyframeRecord>, StoreError> {
        let first = after.map(keyframe_column).transpose()?.unwrap_or(0).saturating_add(1);
        select_keyframes(&mut self.transaction, self.session, first, i64::MAX, ROWS_PER_STEP as i64).await
    }

    /// What a keyframe's image is, such as `image/jpeg`; `None` if it was not kept.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn image_media_type(&mut self, id: KeyframeId) -> Result<Option<String>, StoreError> {
        let sql = "SELECT media_type FROM keyframe_images WHERE session = $1 AND keyframe = $2";
        let media_type = query(sql).bind(self.session).bind(keyframe_column(id)?);
        media_type.scalar(&mut self.transaction).await
    }

    /// Every primitive; there are some dozens.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn primitives(&mut self) -> Result<Vec<GlobalPrimitive>, StoreError> {
        read_primitives(&mut self.transaction, self.session).await
    }

    /// Where a keyframe's keypoints are, pixels of the working image with the lens's distortion.
    ///
    /// # Errors
    /// If the database cannot be read or the keyframe's features are damaged.
    pub async fn keypoints(&mut self, id: KeyframeId) -> Result<Vec<[f32; 2]>, StoreError> {
        let features: Option<Vec<u8>> =
            query("SELECT features FROM keyframe_features WHERE session = $1 AND keyframe = $2")
                .bind(self.session)
                .bind(keyframe_column(id)?)
                .scalar(&mut self.transaction)
                .await?;
        let features =
            features.ok_or_else(|| StoreError::Corrupt(format!("keyframe {id} has no features")))?;
        positions(&features).map_err(|error| StoreError::Corrupt(format!("keyframe {id}: {error}")))
    }
}
