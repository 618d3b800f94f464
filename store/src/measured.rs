//! What one keyframe measured, and which landmarks it sees by that.

use crate::blob::{decode_observations, decode_vanishing, measured};
use crate::cameras::map_number;
use crate::engine::{Connection, Row, query};
use crate::load::blocking;
use crate::number::{keyframe_column, line_id, point_id};
use crate::primitives::read_primitives;
use crate::{Store, StoreError};
use slam::features::LineFeature;
use slam::map::{KeyframeId, LineId, PointId, VanishingObservation};

/// What a keyframe measured.
#[derive(Clone, Debug)]
pub struct MeasuredKeyframe {
    /// Where its keypoints are, pixels of the working image with the lens's distortion.
    pub keypoints: Vec<[f32; 2]>,
    /// The point each keypoint sees.
    pub points: Vec<Option<PointId>>,
    /// Its segments, pixels of the ideal pinhole camera.
    pub segments: Vec<LineFeature>,
    /// The line each segment sees.
    pub lines: Vec<Option<LineId>>,
    /// Its vanishing points with the primitives they belong to.
    pub vanishing: Vec<VanishingObservation>,
}

/// Landmarks whose observations are looked through at a time.
const LANDMARKS_PER_STEP: i64 = 4096;

impl Store {
    /// What a keyframe measured, and which landmarks see it; `None` if there is no such keyframe. Looks
    /// through the session's landmarks, since observations are kept with them.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], or if the keyframe's rows are damaged.
    pub async fn measured_keyframe(
        &self,
        session: &str,
        id: KeyframeId,
    ) -> Result<Option<MeasuredKeyframe>, StoreError> {
        let mut transaction = self.begin_read().await?;
        let session = map_number(&mut transaction, session).await?;
        let Some((keypoints, segments, mut vanishing)) = read_measured(&mut transaction, session, id).await?
        else {
            return Ok(None);
        };
        for primitive in read_primitives(&mut transaction, session).await? {
            let seen = primitive.observations.iter().find(|seen| seen.keyframe == id);
            if let Some(entry) = seen.and_then(|seen| vanishing.get_mut(seen.vanishing_idx as usize)) {
                entry.primitive = Some(primitive.id);
            }
        }
        let points = seen_by(&mut transaction, session, "points", id, keypoints.len()).await?;
        let lines = seen_by(&mut transaction, session, "lines", id, segments.len()).await?;
        let points = points.into_iter().map(|id| id.map(point_id).transpose()).collect::<Result<_, _>>()?;
        let lines = lines.into_iter().map(|id| id.map(line_id).transpose()).collect::<Result<_, _>>()?;
        Ok(Some(MeasuredKeyframe { keypoints, points, segments, lines, vanishing }))
    }

    /// Where a keyframe's keypoints are, pixels of the working image with the lens's distortion; `None` if
    /// there is no such keyframe.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], or if the keyframe's features are damaged.
    pub async fn keypoints(
        &self,
        session: &str,
        id: KeyframeId,
    ) -> Result<Option<Vec<[f32; 2]>>, StoreError> {
        let mut reader = self.reader().await?;
        let session = map_number(&mut reader, session).await?;
        Ok(read_measured(&mut reader, session, id).await?.map(|(keypoints, _, _)| keypoints))
    }

    /// The newest keyframe whose image was kept.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn newest_image(&self, session: &str) -> Result<Option<KeyframeId>, StoreError> {
        let mut reader = self.reader().await?;
        let session = map_number(&mut reader, session).await?;
        let newest: Option<i64> = query("SELECT max(keyframe) FROM keyframe_images WHERE session = $1")
            .bind(session)
            .only(&mut reader)
            .await?;
        newest.map(crate::number::keyframe_id).transpose()
    }
}

type Measured = (Vec<[f32; 2]>, Vec<LineFeature>, Vec<VanishingObservation>);

async fn read_measured(
    connection: &mut Connection,
    session: i64,
    id: KeyframeId,
) -> Result<Option<Measured>, StoreError> {
    let row = query(
        "SELECT features, vanishing FROM keyframe_features f
         LEFT JOIN keyframe_vanishing v ON v.session = f.session AND v.keyframe = f.keyframe
         WHERE f.session = $1 AND f.keyframe = $2",
    )
    .bind(session)
    .bind(keyframe_column(id)?)
    .fetch_optional(connection)
    .await?;
    let Some(row) = row else { return Ok(None) };
    let corrupt = |what: crate::blob::BlobError| StoreError::Corrupt(format!("keyframe {id}: {what}"));
    let (keypoints, segments) = measured(row.try_get(0)?).map_err(corrupt)?;
    let vanishing: Option<&[u8]> = row.try_get(1)?;
    let vanishing = vanishing.map(|blob| decode_vanishing(blob, segments.len())).transpose();
    Ok(Some((keypoints, segments, vanishing.map_err(corrupt)?.unwrap_or_default())))
}

/// The landmark of a table that each of a keyframe's features sees.
async fn seen_by(
    connection: &mut Connection,
    session: i64,
    table: &str,
    keyframe: KeyframeId,
    n_features: usize,
) -> Result<Vec<Option<i64>>, StoreError> {
    let sql = format!(
        "SELECT id, observations FROM {table} WHERE session = $1 AND id > $2 ORDER BY id LIMIT {LANDMARKS_PER_STEP}"
    );
    let (mut seen, mut after) = (vec![None; n_features], 0_i64);
    loop {
        // Safe: the text is made of constants.
        let rows: Vec<Row> = query(sql.clone()).bind(session).bind(after).fetch_all(&mut *connection).await?;
        let Some(last) = rows.last() else { return Ok(seen) };
        after = last.try_get(0)?;
        let entered = blocking(move || {
            for row in &rows {
                let observations = decode_observations(row.try_get(1)?)
                    .map_err(|error| StoreError::Corrupt(error.to_string()))?;
                let found = observations.iter().find(|seen| seen.keyframe == keyframe);
                if let Some(slot) = found.and_then(|found| seen.get_mut(found.feature_idx as usize)) {
                    *slot = Some(row.try_get(0)?);
                }
            }
            Ok(seen)
        });
        seen = entered.await?;
    }
}
