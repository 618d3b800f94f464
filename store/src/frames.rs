//! Every frame of a session, with or without a pose, and which keyframe moves it.

use crate::cameras::Numbers;
use crate::engine::{Row, query};
use crate::number::{from_column, keyframe_id, to_column};
use crate::pose::{PoseBook, read_pose};
use crate::session::parse_state;
use crate::{Store, StoreError};
use futures_util::stream::{self, BoxStream, StreamExt, TryStreamExt};
use geometry::Pose;
use slam::map::{FrameState, KeyframeId, SubmapId};

/// One frame of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEntry {
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// How tracking ended.
    pub state: FrameState,
    /// The pose was found after the frame was answered.
    pub backfilled: bool,
    /// Why the pose is not good, in a plain sentence; empty if it is.
    pub reason: String,
    /// Where the camera was, if that is known.
    pub place: Option<FramePlace>,
}

/// Where a frame's camera was.
#[derive(Clone, Debug, PartialEq)]
pub struct FramePlace {
    /// The submap whose frame of reference the pose is in.
    pub submap: SubmapId,
    /// The keyframes the pose moves with: its own, and while that was removed, the one that hangs on, to the
    /// one in the map.
    pub way: Vec<KeyframeId>,
    /// Position and orientation of the camera, map units.
    pub world_from_camera: Pose,
}

/// Frames read at a time, so that no reader holds the database's log for long.
const FRAMES_PER_STEP: i64 = 512;

const SELECT_FRAMES: &str = "SELECT sequence, timestamp_ns, state, backfilled, reference, \
     qx, qy, qz, qw, tx, ty, tz, reason FROM frames WHERE session = $1 AND sequence >= $2 ORDER BY sequence LIMIT $3";

impl Store {
    /// Every frame of a session in the order of their numbers. Poses of keyframes are read at once, frames as
    /// the stream goes on.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], before the stream begins.
    pub async fn frames(
        &self,
        session: &str,
    ) -> Result<BoxStream<'static, Result<FrameEntry, StoreError>>, StoreError> {
        let mut transaction = self.begin_read().await?;
        let Numbers { own: number, map, .. } = Numbers::of(&mut transaction, session).await?;
        let book = PoseBook::read(&mut transaction, map).await?;
        transaction.commit().await?;
        let start = (self.clone(), book, 0_u64);
        let steps = stream::try_unfold(start, move |(store, book, next)| async move {
            let rows = query(SELECT_FRAMES)
                .bind(number)
                .bind(to_column("sequence", next)?)
                .bind(FRAMES_PER_STEP)
                .fetch_all(&mut store.reader().await?)
                .await?;
            let frames = rows.iter().map(|row| parse_frame(row, &book)).collect::<Result<Vec<_>, _>>()?;
            let Some(last) = frames.last() else { return Ok::<_, StoreError>(None) };
            let next = last.sequence.saturating_add(1);
            Ok(Some((stream::iter(frames).map(Ok::<_, StoreError>), (store, book, next))))
        });
        Ok(steps.try_flatten().boxed())
    }
}

fn parse_frame(row: &Row, book: &PoseBook) -> Result<FrameEntry, StoreError> {
    let reference: Option<i64> = row.try_get(4)?;
    let place = match reference {
        None => None,
        Some(reference) => {
            let (reference, camera_from_reference) = (keyframe_id(reference)?, read_pose(row, 5)?);
            let located = book.locate(reference, &camera_from_reference);
            located.zip(book.way_of(reference)).map(|((submap, camera_from_world), way)| FramePlace {
                submap,
                way,
                world_from_camera: camera_from_world.inverse(),
            })
        }
    };
    Ok(FrameEntry {
        sequence: from_column("a sequence", row.try_get(0)?)?,
        timestamp_ns: row.try_get(1)?,
        state: parse_state(row.try_get(2)?)?,
        backfilled: row.try_get(3)?,
        reason: row.try_get::<Option<String>, _>(12)?.unwrap_or_default(),
        place,
    })
}
