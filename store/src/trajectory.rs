//! Trajectories, resolved when they are asked for.

use crate::cameras::Numbers;
use crate::engine::{Connection, Row, query};
use crate::number::{from_column, keyframe_id, to_column};
use crate::pose::{PoseBook, read_pose};
use crate::session::parse_state;
use crate::{Store, StoreError};
use futures_util::stream::{self, BoxStream, StreamExt, TryStreamExt};
use geometry::Pose;
use slam::map::{FrameState, KeyframeId, SubmapId};
use std::collections::BTreeMap;

/// Which poses a trajectory is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrajectoryKind {
    /// Every frame that has a pose.
    #[default]
    Frames,
    /// The keyframes in the map.
    Keyframes,
}

/// Whose poses are wanted; poses of a submap that was merged are in the one it became part of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SubmapChoice {
    /// Every submap's, each in its own frame of reference.
    #[default]
    All,
    /// The submap's with the most poses, the oldest of several.
    Largest,
    /// This one's.
    One(SubmapId),
}

/// Which part of a trajectory is wanted; by default all of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrajectoryFilter {
    /// First time, nanoseconds.
    pub from_timestamp_ns: Option<i64>,
    /// Last time, nanoseconds.
    pub to_timestamp_ns: Option<i64>,
    /// Poses of these submaps.
    pub submaps: SubmapChoice,
}

/// One pose of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryPose {
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// The submap whose frame of reference the pose is in.
    pub submap: SubmapId,
    /// How tracking ended; of keyframes, always tracked.
    pub state: FrameState,
    /// The pose was found after the frame was answered.
    pub backfilled: bool,
    /// The keyframe the pose hangs on; for keyframes, itself.
    pub reference: KeyframeId,
    /// Position and orientation of the camera, map units.
    pub world_from_camera: Pose,
}

/// Frames read at a time: no reader holds the database's log between steps, however slowly the stream is
/// drunk.
const FRAMES_PER_STEP: i64 = 512;

impl Store {
    /// The poses of a session in the order of their time, as the map stands now.
    ///
    /// Poses of keyframes are read at once, so that the whole trajectory belongs to one state of the map;
    /// frames are read as the stream goes on, up to the last one there is now. Frames whose keyframes were
    /// dropped with a whole submap have no place any more and are left out.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], before the stream begins.
    pub async fn trajectory(
        &self,
        session: &str,
        kind: TrajectoryKind,
        filter: TrajectoryFilter,
    ) -> Result<BoxStream<'static, Result<TrajectoryPose, StoreError>>, StoreError> {
        let mut transaction = self.begin_read().await?;
        let numbers = Numbers::of(&mut transaction, session).await?;
        let book = PoseBook::read(&mut transaction, numbers.map).await?;
        let last: Option<i64> = query("SELECT last_sequence FROM sessions WHERE number = $1")
            .bind(numbers.own)
            .only(&mut transaction)
            .await?;
        let submap = match filter.submaps {
            SubmapChoice::All => None,
            SubmapChoice::One(submap) => Some(submap),
            SubmapChoice::Largest => largest_submap(&mut transaction, numbers, kind, &book).await?,
        };
        transaction.commit().await?;
        let cursor = Cursor {
            store: self.clone(),
            numbers,
            kind,
            filter,
            submap,
            book,
            next: 0,
            last: last.unwrap_or(-1),
        };
        let steps = stream::try_unfold(cursor, |mut cursor| async move {
            let step = cursor.step().await?;
            Ok::<_, StoreError>(step.map(|poses| (stream::iter(poses).map(Ok::<_, StoreError>), cursor)))
        });
        Ok(steps.try_flatten().boxed())
    }

    /// How many poses of a kind each submap has.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn poses_by_submap(
        &self,
        session: &str,
        kind: TrajectoryKind,
    ) -> Result<BTreeMap<SubmapId, u64>, StoreError> {
        let mut transaction = self.begin_read().await?;
        let numbers = Numbers::of(&mut transaction, session).await?;
        let book = PoseBook::read(&mut transaction, numbers.map).await?;
        let n_poses = poses_by_submap(&mut transaction, numbers, kind, &book).await?;
        transaction.commit().await?;
        Ok(n_poses)
    }
}

/// How far a trajectory has been read.
struct Cursor {
    store: Store,
    numbers: Numbers,
    kind: TrajectoryKind,
    filter: TrajectoryFilter,
    /// The only submap whose poses are wanted.
    submap: Option<SubmapId>,
    book: PoseBook,
    /// First sequence not yet read.
    next: i64,
    /// Last sequence to read.
    last: i64,
}

const SELECT_FRAMES: &str = "SELECT sequence, timestamp_ns, state, backfilled, reference, \
     qx, qy, qz, qw, tx, ty, tz FROM frames \
     WHERE session = $1 AND sequence >= $2 AND sequence <= $3 AND reference IS NOT NULL \
     AND timestamp_ns BETWEEN $4 AND $5 ORDER BY sequence LIMIT $6";

/// Keyframes are few: those of the whole session are no more than a few steps' worth of frames. Times and
/// numbers of frames rise together, so one order is the other. State 2 is tracked. A keyframe is a pose of
/// the session whose camera took it.
const SELECT_KEYFRAMES: &str = "SELECT sequence, timestamp_ns, CAST(2 AS BIGINT), FALSE, id, qx, qy, qz, qw, tx, ty, tz \
     FROM keyframes WHERE session = $1 AND sequence >= $2 AND sequence <= $3 \
     AND timestamp_ns BETWEEN $4 AND $5 AND camera = $7 ORDER BY sequence LIMIT $6";

impl Cursor {
    /// The next poses; `None` at the end.
    async fn step(&mut self) -> Result<Option<Vec<TrajectoryPose>>, StoreError> {
        if self.next > self.last {
            return Ok(None);
        }
        let Numbers { own, map, camera } = self.numbers;
        let (sql, session) = match self.kind {
            TrajectoryKind::Frames => (SELECT_FRAMES, own),
            TrajectoryKind::Keyframes => (SELECT_KEYFRAMES, map),
        };
        let mut reader = self.store.reader().await?;
        let select = query(sql)
            .bind(session)
            .bind(self.next)
            .bind(self.last)
            .bind(self.filter.from_timestamp_ns.unwrap_or(i64::MIN))
            .bind(self.filter.to_timestamp_ns.unwrap_or(i64::MAX))
            .bind(FRAMES_PER_STEP);
        let select = if self.kind == TrajectoryKind::Keyframes { select.bind(camera) } else { select };
        let rows = select.fetch_all(&mut reader).await?;
        drop(reader);
        let Some(last_row) = rows.last() else { return Ok(None) };
        self.next = last_row.try_get::<i64, _>(0)?.saturating_add(1);
        let poses = rows.iter().filter_map(|row| self.resolve(row).transpose());
        poses.collect::<Result<Vec<_>, _>>().map(Some)
    }

    /// The pose of a row, where its keyframe has a place.
    fn resolve(&self, row: &Row) -> Result<Option<TrajectoryPose>, StoreError> {
        let reference = keyframe_id(row.try_get(4)?)?;
        let camera_from_reference = match self.kind {
            TrajectoryKind::Frames => read_pose(row, 5)?,
            TrajectoryKind::Keyframes => Pose::identity(),
        };
        let Some((submap, camera_from_world)) = self.book.locate(reference, &camera_from_reference) else {
            return Ok(None);
        };
        // Submaps merge, so which one a pose is in is known by its keyframe alone.
        if self.submap.is_some_and(|wanted| wanted != submap) {
            return Ok(None);
        }
        Ok(Some(TrajectoryPose {
            sequence: from_column("a sequence", row.try_get(0)?)?,
            timestamp_ns: row.try_get(1)?,
            submap,
            state: parse_state(row.try_get(2)?)?,
            backfilled: row.try_get(3)?,
            reference,
            world_from_camera: camera_from_world.inverse(),
        }))
    }
}

/// The submap with the most poses of a kind; `None` if there are none.
async fn largest_submap(
    connection: &mut Connection,
    numbers: Numbers,
    kind: TrajectoryKind,
    book: &PoseBook,
) -> Result<Option<SubmapId>, StoreError> {
    let n_poses = poses_by_submap(connection, numbers, kind, book).await?;
    let largest = n_poses.into_iter().max_by_key(|(submap, n)| (*n, std::cmp::Reverse(*submap)));
    Ok(largest.map(|(submap, _)| submap))
}

async fn poses_by_submap(
    connection: &mut Connection,
    Numbers { own, map, camera }: Numbers,
    kind: TrajectoryKind,
    book: &PoseBook,
) -> Result<BTreeMap<SubmapId, u64>, StoreError> {
    let select = match kind {
        TrajectoryKind::Frames => query(
            "SELECT reference, count(*) FROM frames WHERE session = $1 AND reference IS NOT NULL GROUP BY reference",
        )
        .bind(own),
        TrajectoryKind::Keyframes => {
            query("SELECT id, CAST(1 AS BIGINT) FROM keyframes WHERE session = $1 AND camera = $2")
                .bind(map)
                .bind(camera)
        }
    };
    let mut n_poses: BTreeMap<SubmapId, u64> = BTreeMap::new();
    for row in select.fetch_all(connection).await? {
        if let Some((submap, _)) = book.locate(keyframe_id(row.try_get(0)?)?, &Pose::identity()) {
            *n_poses.entry(submap).or_default() += from_column("a count", row.try_get(1)?)?;
        }
    }
    Ok(n_poses)
}

/// What one frame of a session came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredFrame {
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// How tracking ended.
    pub state: FrameState,
    /// The submap and the camera's pose in it, where there is one; map units.
    pub world_from_camera: Option<(SubmapId, Pose)>,
}

impl Store {
    /// One frame of the trajectory, with or without a pose; for answering a repeated sequence.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn frame(&self, session: &str, sequence: u64) -> Result<Option<StoredFrame>, StoreError> {
        let mut transaction = self.begin_read().await?;
        let Numbers { own: number, map, .. } = Numbers::of(&mut transaction, session).await?;
        let row = query(
            "SELECT timestamp_ns, state, reference, qx, qy, qz, qw, tx, ty, tz FROM frames
             WHERE session = $1 AND sequence = $2",
        )
        .bind(number)
        .bind(to_column("sequence", sequence)?)
        .fetch_optional(&mut transaction)
        .await?;
        let Some(row) = row else { return Ok(None) };
        let reference: Option<i64> = row.try_get(2)?;
        let world_from_camera = match reference {
            Some(reference) => {
                let book = PoseBook::read(&mut transaction, map).await?;
                let placed = book.locate(keyframe_id(reference)?, &read_pose(&row, 3)?);
                placed.map(|(submap, camera_from_world)| (submap, camera_from_world.inverse()))
            }
            None => None,
        };
        let state = parse_state(row.try_get(1)?)?;
        Ok(Some(StoredFrame { sequence, timestamp_ns: row.try_get(0)?, state, world_from_camera }))
    }
}
