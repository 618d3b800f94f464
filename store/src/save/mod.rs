//! Writing a map update: one transaction, and in it only the rows that changed.

mod keyframes;
mod landmarks;
mod lines;
mod points;
mod primitives;

use crate::cameras::{MapSessions, write_map_counts};
use crate::engine::{Connection, MultiRow, ids, postgres, query};
use crate::images::{Placed, write_images};
use crate::number::to_column;
use crate::open::WriteTransaction;
use crate::pose::finite_pose_columns;
use crate::segments::Segments;
use crate::session::{
    SessionCounts, read_session, state_column, write_correction, write_enlarged, write_progress,
};
use crate::{Store, StoreError};

use slam::map::{CameraId, FrameRecord, FrameState, KeyframeId, LineLandmark, MapUpdate, PointLandmark};

/// What the session's row says after an update, besides what the map tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionStatus {
    /// How tracking the last frame ended.
    pub state: FrameState,
}

/// The image of a keyframe as it was received.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyframeImage {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// What the bytes are, such as `image/png`.
    pub media_type: String,
    /// The encoded image.
    pub bytes: Vec<u8>,
}

/// What is durable after a commit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Committed {
    /// Every frame of the map's own camera handed over so far up to this sequence number is in the database;
    /// `None` before the first.
    pub last_sequence: Option<u64>,
    /// How many things the session has now.
    pub counts: SessionCounts,
}

/// How often an update is tried again at once after its transaction met another's. Those that write one
/// session wait for each other, so that they hardly meet.
const CONFLICT_RETRIES: usize = 3;

impl Store {
    /// Stores an update in one transaction: all of it is in the database afterwards, or none of it.
    ///
    /// Writes the rows that `update.changes` names, as they are in `update.map`, and `update.frames`, each to
    /// the session whose camera took it; frames of sessions that were deleted are left out, and so are images
    /// that are no longer in the map. After an error the database is as it was and
    /// the same update, alone or merged with later ones, can be tried again.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], [`StoreError::Io`], [`StoreError::Busy`], [`StoreError::Objects`] and
    /// [`StoreError::Unreachable`] may pass; the others will not. After [`StoreError::Gone`] the update is in
    /// a file that nobody will find again.
    pub async fn save_update(
        &self,
        session: &str,
        update: &MapUpdate,
        status: SessionStatus,
        images: &[KeyframeImage],
    ) -> Result<Committed, StoreError> {
        // Before the transaction, which must not wait for it.
        let images = &self.place_images(update, images).await?;
        let mut outcome = self.write_update(session, update, status, images).await;
        for _ in 0..CONFLICT_RETRIES {
            if !outcome.as_ref().is_err_and(postgres::is_conflict) {
                break;
            }
            outcome = self.write_update(session, update, status, images).await;
        }
        self.place().note(&outcome);
        outcome
    }

    /// As [`Self::save_update`], of an update that takes keyframes of another session in: their images come
    /// along. `keyframes` has their numbers there and here.
    ///
    /// # Errors
    /// As [`Self::save_update`].
    pub async fn save_merged(
        &self,
        session: &str,
        update: &MapUpdate,
        status: SessionStatus,
        (from, keyframes): (&str, &[(KeyframeId, KeyframeId)]),
    ) -> Result<Committed, StoreError> {
        let outcome = async {
            let mut transaction = self.begin_write().await?;
            let committed = write_update(&mut transaction, session, update, status, &[]).await?;
            let (number, _) = transaction.hold(session).await?;
            let (other, _) = read_session(&mut transaction, from).await?;
            keyframes::copy_images(&mut transaction, (other, number), keyframes).await?;
            transaction.commit().await?;
            Ok(committed)
        };
        let outcome = outcome.await;
        self.place().note(&outcome);
        outcome
    }

    async fn write_update(
        &self,
        session: &str,
        update: &MapUpdate,
        status: SessionStatus,
        images: &[Placed<'_>],
    ) -> Result<Committed, StoreError> {
        let mut transaction = self.begin_write().await?;
        let committed = write_update(&mut transaction, session, update, status, images).await?;
        transaction.commit().await?;
        Ok(committed)
    }
}

/// Writes an update's rows, without the commit.
async fn write_update(
    transaction: &mut WriteTransaction,
    session: &str,
    update: &MapUpdate,
    status: SessionStatus,
    images: &[Placed<'_>],
) -> Result<Committed, StoreError> {
    let (number, before) = transaction.hold(session).await?;
    let sessions = MapSessions::read(transaction, (number, &before)).await?;

    landmarks::delete::<PointLandmark>(transaction, number, update).await?;
    landmarks::delete::<LineLandmark>(transaction, number, update).await?;
    keyframes::write_keyframes(transaction, number, update, &sessions).await?;
    keyframes::write_features(transaction, number, update).await?;
    write_images(transaction, number, images).await?;
    primitives::write_vanishing(transaction, number, update).await?;
    landmarks::write::<PointLandmark>(transaction, number, update).await?;
    landmarks::write::<LineLandmark>(transaction, number, update).await?;
    primitives::write_primitives(transaction, number, update).await?;
    if update.changes.correction {
        write_correction(transaction, number, &update.map).await?;
    }
    if update.changes.enlarged {
        write_enlarged(transaction, number).await?;
    }
    let frames = frames_of(update, CameraId::default());
    let newest = frames.iter().max_by_key(|frame| frame.sequence).copied();
    let segments = &sessions.own;
    let n_new_frames = write_frames(transaction, number, frames, segments).await?;
    let newest = newest.map(|frame| (frame.sequence, segments.client_ns(frame.sequence, frame.timestamp_ns)));
    let last_frame = before.last_frame.max(newest);
    let counts = SessionCounts {
        n_frames: before.counts.n_frames + n_new_frames,
        n_keyframes: update.map.n_keyframes() as u64,
        n_points: update.map.n_points() as u64,
        n_lines: update.map.n_lines() as u64,
        n_primitives: update.map.n_primitives() as u64,
        n_submaps: update.map.submaps().len() as u32,
    };
    write_progress(transaction, number, status.state, last_frame, update.map.last_ids(), &counts).await?;
    for (camera, added) in &sessions.added {
        let frames = frames_of(update, *camera);
        if !frames.is_empty() {
            let n_new = write_frames(transaction, added.number, frames.clone(), &added.segments).await?;
            added.write_progress(transaction, &frames, n_new).await?;
        }
    }
    if !sessions.added.is_empty() {
        write_map_counts(transaction, (session, number), &counts, update.changes.correction).await?;
    }
    Ok(Committed { last_sequence: last_frame.map(|(sequence, _)| sequence), counts })
}

/// The frames of an update that one camera took.
fn frames_of(update: &MapUpdate, camera: CameraId) -> Vec<&FrameRecord> {
    update.frames.iter().filter(|frame| frame.camera == camera).collect()
}

const FRAME_ROWS: MultiRow<'static> = MultiRow {
    table: "frames",
    columns: "session, sequence, timestamp_ns, state, backfilled, submap, reference, reason, \
              qx, qy, qz, qw, tx, ty, tz",
    conflict: "ON CONFLICT (session, sequence) DO UPDATE SET timestamp_ns = excluded.timestamp_ns, \
               state = excluded.state, backfilled = excluded.backfilled, submap = excluded.submap, \
               reference = excluded.reference, reason = excluded.reason, qx = excluded.qx, qy = excluded.qy, qz = excluded.qz, \
               qw = excluded.qw, tx = excluded.tx, ty = excluded.ty, tz = excluded.tz",
    is_virtual: false,
};

/// Adds frames to the trajectory or replaces them there; how many were added.
async fn write_frames(
    connection: &mut Connection,
    session: i64,
    mut frames: Vec<&FrameRecord>,
    segments: &Segments,
) -> Result<u64, StoreError> {
    if frames.is_empty() {
        return Ok(0);
    }
    // Of two records of a frame the later one holds, in this update as between updates.
    frames.reverse();
    frames.sort_by_key(|frame| frame.sequence);
    frames.dedup_by_key(|frame| frame.sequence);

    let n_known: i64 = query("SELECT count(*) FROM frames WHERE session = $1 AND sequence IN IDS($2)")
        .bind(session)
        .bind(ids(frames.iter().map(|frame| frame.sequence)))
        .only(&mut *connection)
        .await?;

    FRAME_ROWS
        .write(connection, &frames, |columns, frame| {
            let pose = match &frame.pose {
                Some(pose) => Some(finite_pose_columns("a frame's pose", &pose.camera_from_reference)?),
                None => None,
            };
            columns.add(session)?;
            columns.add(to_column("sequence", frame.sequence)?)?;
            columns.add(segments.client_ns(frame.sequence, frame.timestamp_ns))?;
            columns.add(state_column(frame.state))?;
            columns.add(frame.backfilled)?;
            columns.add(frame.pose.map(|pose| i64::from(pose.submap.0)))?;
            columns
                .add(frame.pose.map(|pose| to_column("keyframe id", pose.reference.get())).transpose()?)?;
            columns.add(Some(frame.reason.as_str()).filter(|reason| !reason.is_empty()))?;
            (0..7).try_for_each(|idx| columns.add(pose.map(|pose| pose[idx])))
        })
        .await?;
    Ok(frames.len() as u64 - n_known as u64)
}
