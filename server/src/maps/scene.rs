//! The map as a viewer draws it: columns of numbers in parts, all of it or what changed since a revision.
//!
//! The revision is taken before the database is read, so what is read is at least as new, and a viewer that
//! asks for the changes since then misses nothing: a row it has already is told again. Lengths are map units,
//! also in a session whose scale is known, so that a new scale changes no row.

use super::shades::ShadedSession;
use super::{Batches, MapQueries, ROWS_PER_BATCH, batches, batches_of_pages};
use crate::error::ApiError;
use crate::model::State;
use crate::options::working_camera;
use crate::session::{SceneChanges, SessionId, Since};
use futures_util::stream::{self, BoxStream, StreamExt};
use geometry::Pose;
use serde::Serialize;
use slam::map::{KeyframeId, LineLandmark, PointLandmark, PrimitiveId};
use std::collections::BTreeMap;
use std::sync::Arc;
use store::{FrameEntry, KeyframeRecord, PrimitiveRecord, SessionRecord};
use utoipa::ToSchema;

/// A part of a scene. The first is `scene`, the last `end`; a scene without `end` is incomplete.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScenePart {
    /// What follows.
    Scene(SceneHead),
    /// Rows that are gone.
    Removed(RemovedRows),
    /// Keyframes, new or changed.
    Keyframes(KeyframeColumns),
    /// Global primitives, new or changed.
    Primitives(PrimitiveColumns),
    /// Lines, new or changed.
    Lines(LineColumns),
    /// Points, new or changed.
    Points(PointColumns),
    /// Frames, new or moved.
    Frames(FrameColumns),
    /// The end.
    End(SceneEnd),
}

/// What a scene is of.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct SceneHead {
    /// The session.
    pub session_id: String,
    /// What to ask for as `since` the next time.
    pub revision: String,
    /// Whether this is the whole scene; otherwise it is what changed.
    pub full: bool,
    /// Metres per map unit; `null` while the scale is free. Lengths of a scene are map units all the same.
    pub metres_per_unit: Option<f64>,
    /// The camera's field of view: x and y of the image's corners at depth 1, its right and lower one then
    /// its left and upper one.
    pub frustum: [f32; 4],
}

/// Ids of rows that are gone.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct RemovedRows {
    keyframes: Vec<u64>,
    points: Vec<u64>,
    lines: Vec<u64>,
    primitives: Vec<u64>,
}

/// Keyframes, column by column.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct KeyframeColumns {
    ids: Vec<u64>,
    /// The submap whose frame of reference the pose is in.
    submap_ids: Vec<u32>,
    /// The client's number of the frame.
    sequences: Vec<u64>,
    /// `world_from_camera`: position, then the quaternion x y z w.
    poses: Vec<[f32; 7]>,
    /// Whether the image was kept.
    has_image: Vec<bool>,
}

/// Global primitives, column by column.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct PrimitiveColumns {
    ids: Vec<u64>,
    submap_ids: Vec<u32>,
    /// Unit vectors in the world, each of which means the same as its negative.
    directions: Vec<[f32; 3]>,
    /// The keyframes each ties.
    keyframe_ids: Vec<Vec<u64>>,
}

/// Lines, column by column.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct LineColumns {
    ids: Vec<u64>,
    submap_ids: Vec<u32>,
    /// Both ends of the part that was seen.
    ends: Vec<[f32; 6]>,
    primitive_ids: Vec<Option<u64>>,
    /// The keyframe that made it.
    created_by: Vec<u64>,
}

/// Points, column by column.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct PointColumns {
    ids: Vec<u64>,
    submap_ids: Vec<u32>,
    positions: Vec<[f32; 3]>,
    /// How bright the image is there, 0 to 255; `null` if no image was kept.
    grays: Vec<Option<u8>>,
    /// The keyframe that made it.
    created_by: Vec<u64>,
}

/// Frames, column by column, with and without a pose.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct FrameColumns {
    /// The client's number of the frame.
    sequences: Vec<u64>,
    /// Seconds of the client's clock.
    times_s: Vec<f64>,
    states: Vec<State>,
    /// Whether the pose was found after the frame was answered.
    backfilled: Vec<bool>,
    submap_ids: Vec<Option<u32>>,
    /// `world_from_camera`: position, then the quaternion x y z w.
    poses: Vec<Option<[f32; 7]>>,
    /// Why there is no pose or a weak one, by the frame's number, where that is still known.
    reasons: BTreeMap<u64, String>,
}

/// The end of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct SceneEnd {
    /// As at the beginning.
    pub revision: String,
}

/// A scene, part by part, read as fast as it is taken.
pub type SceneParts = BoxStream<'static, Result<ScenePart, ApiError>>;

impl MapQueries {
    /// The scene, or what changed of it.
    ///
    /// # Errors
    /// If there is no such session.
    pub async fn scene(&self, id: &SessionId, since: Since) -> Result<SceneParts, ApiError> {
        let record = self.store.get_session(id.as_str()).await?;
        let Since { revision, changes } = since;
        let changes = changes.map(Arc::new);
        let revision = revision.to_string();
        let head = ScenePart::Scene(SceneHead {
            session_id: id.to_string(),
            revision: revision.clone(),
            full: changes.is_none(),
            metres_per_unit: record.metres_per_unit,
            frustum: frustum(&record)?,
        });
        let removed = changes.as_deref().map(|changes| Ok(ScenePart::Removed(RemovedRows::of(changes))));
        let parts = stream::iter([Ok(head)].into_iter().chain(removed))
            .chain(self.keyframe_parts(id, changes.clone()))
            .chain(self.primitive_parts(id, changes.clone()))
            .chain(self.line_parts(id, changes.as_deref()).await?)
            .chain(self.point_parts(id, &record, changes.as_deref()).await?)
            .chain(self.frame_parts(id, changes).await?)
            .chain(stream::once(async { Ok(ScenePart::End(SceneEnd { revision })) }));
        Ok(parts.boxed())
    }

    fn keyframe_parts(&self, id: &SessionId, changes: Option<Arc<SceneChanges>>) -> SceneParts {
        let (store, id) = (self.store.clone(), id.clone());
        // Those that changed lie together: the newest, as a rule.
        let before = changes.as_ref().map(|changes| match changes.map.keyframes.first() {
            Some(first) => KeyframeId::new(first.get() - 1),
            None => KeyframeId::new(u64::MAX >> 1),
        });
        let read = move |after: Option<KeyframeId>| {
            let (store, id) = (store.clone(), id.clone());
            let after = after.or(before.flatten());
            async move { store.keyframes(id.as_str(), after, ROWS_PER_BATCH as u32).await }
        };
        let wanted = move |record: &KeyframeRecord| {
            changes.as_ref().is_none_or(|changes| changes.map.keyframes.contains(&record.id))
        };
        parts(batches_of_pages(read, |record| record), move |rows| {
            ScenePart::Keyframes(KeyframeColumns::of(rows.into_iter().filter(&wanted)))
        })
    }

    fn primitive_parts(&self, id: &SessionId, changes: Option<Arc<SceneChanges>>) -> SceneParts {
        let (store, id) = (self.store.clone(), id.clone());
        let read = move |after| {
            let (store, id) = (store.clone(), id.clone());
            async move { store.primitives_page(id.as_str(), None, after, ROWS_PER_BATCH as u32).await }
        };
        let wanted = move |record: &PrimitiveRecord| {
            changes.as_ref().is_none_or(|changes| changes.map.primitives.contains(&record.primitive.id))
        };
        parts(batches_of_pages(read, |record| record), move |rows| {
            ScenePart::Primitives(PrimitiveColumns::of(rows.into_iter().filter(&wanted)))
        })
    }

    async fn line_parts(
        &self,
        id: &SessionId,
        changes: Option<&SceneChanges>,
    ) -> Result<SceneParts, ApiError> {
        let lines = match changes {
            Some(changes) => self.store.lines_of(id.as_str(), &changes.map.lines).await?,
            None => self.store.lines(id.as_str(), store::LineQuery::default()).await?,
        };
        Ok(parts(batches(lines, |line| line), |lines| ScenePart::Lines(LineColumns::of(&lines))))
    }

    async fn point_parts(
        &self,
        id: &SessionId,
        record: &SessionRecord,
        changes: Option<&SceneChanges>,
    ) -> Result<SceneParts, ApiError> {
        let points = match changes {
            Some(changes) => self.store.points_of(id.as_str(), &changes.map.points).await?,
            None => self.store.points(id.as_str(), store::PointQuery::default()).await?,
        };
        let working_width_px = working_camera(&self.store.map_of(&record.id).await?)?.width();
        let session =
            Arc::new(ShadedSession { id: id.clone(), created_at_ns: record.created_at_ns, working_width_px });
        let (store, shades) = (self.store.clone(), self.shades.clone());
        let shaded = batches(points, |point| point).then(move |points| {
            let (store, shades, session) = (store.clone(), shades.clone(), session.clone());
            async move {
                let points = points?;
                let grays = shades.of_points(&store, &session, &points).await?;
                Ok(ScenePart::Points(PointColumns::of(&points, grays)))
            }
        });
        Ok(shaded.boxed())
    }

    async fn frame_parts(
        &self,
        id: &SessionId,
        changes: Option<Arc<SceneChanges>>,
    ) -> Result<SceneParts, ApiError> {
        let frames = self.store.frames(id.as_str()).await?;
        let wanted = move |frame: &FrameEntry| {
            changes.as_ref().is_none_or(|changes| {
                let map = &changes.map;
                let is_other = |id| map.keyframes.contains(id) || map.removed_keyframes.contains(id);
                let moved = frame.place.as_ref().is_some_and(|place| place.way.iter().any(is_other));
                moved || changes.sequences.contains(&frame.sequence)
            })
        };
        Ok(parts(batches(frames, |frame| frame), move |frames| {
            ScenePart::Frames(FrameColumns::of(frames.into_iter().filter(&wanted)))
        }))
    }
}

/// A part of each batch.
fn parts<T: Send + 'static>(
    batches: Batches<T>,
    part: impl Fn(Vec<T>) -> ScenePart + Send + 'static,
) -> SceneParts {
    batches.map(move |rows| rows.map(&part)).filter(|part| std::future::ready(!is_empty(part))).boxed()
}

/// Whether a part tells nothing: all of its rows were as they had been.
fn is_empty(part: &Result<ScenePart, ApiError>) -> bool {
    match part {
        Ok(ScenePart::Keyframes(columns)) => columns.ids.is_empty(),
        Ok(ScenePart::Primitives(columns)) => columns.ids.is_empty(),
        Ok(ScenePart::Frames(columns)) => columns.sequences.is_empty(),
        _ => false,
    }
}

/// Corners of the field of view at depth 1, lens distortion left out.
fn frustum(record: &SessionRecord) -> Result<[f32; 4], ApiError> {
    let camera = record.checked_camera()?;
    let pinhole = camera.pinhole();
    let (width, height) = (f64::from(camera.width()), f64::from(camera.height()));
    // Pixel centers are at integers, so the image ends half a pixel beyond the last one.
    let corner = |x: f64, y: f64| [(x - pinhole.cx) / pinhole.fx, (y - pinhole.cy) / pinhole.fy];
    let ([right, lower], [left, upper]) = (corner(width - 0.5, height - 0.5), corner(-0.5, -0.5));
    Ok([right as f32, lower as f32, left as f32, upper as f32])
}

fn pose_columns(pose: &Pose) -> [f32; 7] {
    let (t, q) = (&pose.translation, pose.rotation.quaternion());
    [t.x, t.y, t.z, q.i, q.j, q.k, q.w].map(|number| number as f32)
}

impl RemovedRows {
    fn of(changes: &SceneChanges) -> Self {
        let map = &changes.map;
        Self {
            keyframes: map.removed_keyframes.iter().map(|id| id.get()).collect(),
            points: map.removed_points.iter().map(|id| id.get()).collect(),
            lines: map.removed_lines.iter().map(|id| id.get()).collect(),
            primitives: map.removed_primitives.iter().map(|id| id.get()).collect(),
        }
    }
}

impl KeyframeColumns {
    fn of(records: impl Iterator<Item = KeyframeRecord>) -> Self {
        let mut columns = Self::default();
        for record in records {
            columns.ids.push(record.id.get());
            columns.submap_ids.push(record.submap.0);
            columns.sequences.push(record.sequence);
            columns.poses.push(pose_columns(&record.camera_from_world.inverse()));
            columns.has_image.push(record.has_image);
        }
        columns
    }
}

impl PrimitiveColumns {
    fn of(records: impl Iterator<Item = PrimitiveRecord>) -> Self {
        let mut columns = Self::default();
        for PrimitiveRecord { primitive, .. } in records {
            columns.ids.push(primitive.id.get());
            columns.submap_ids.push(primitive.submap.0);
            columns.directions.push((*primitive.direction.as_vector()).map(|number| number as f32).into());
            columns
                .keyframe_ids
                .push(primitive.observations.iter().map(|seen| seen.keyframe.get()).collect());
        }
        columns
    }
}

impl LineColumns {
    fn of(lines: &[LineLandmark]) -> Self {
        let ends = |line: &LineLandmark| {
            let [start, end] = line.endpoints.map(|end| end.map(|length| length as f32));
            [start.x, start.y, start.z, end.x, end.y, end.z]
        };
        Self {
            ids: lines.iter().map(|line| line.id.get()).collect(),
            submap_ids: lines.iter().map(|line| line.submap.0).collect(),
            ends: lines.iter().map(ends).collect(),
            primitive_ids: lines.iter().map(|line| line.primitive.map(PrimitiveId::get)).collect(),
            created_by: lines.iter().map(|line| line.created_by.get()).collect(),
        }
    }
}

impl PointColumns {
    fn of(points: &[PointLandmark], grays: Vec<Option<u8>>) -> Self {
        Self {
            ids: points.iter().map(|point| point.id.get()).collect(),
            submap_ids: points.iter().map(|point| point.submap.0).collect(),
            positions: points.iter().map(|point| point.position.map(|length| length as f32).into()).collect(),
            grays,
            created_by: points.iter().map(|point| point.created_by.get()).collect(),
        }
    }
}

impl FrameColumns {
    fn of(frames: impl Iterator<Item = FrameEntry>) -> Self {
        let mut columns = Self::default();
        for frame in frames {
            columns.sequences.push(frame.sequence);
            columns.times_s.push(frame.timestamp_ns as f64 * 1e-9);
            columns.states.push(frame.state.into());
            columns.backfilled.push(frame.backfilled);
            let place = frame.place.as_ref();
            columns.submap_ids.push(place.map(|place| place.submap.0));
            columns.poses.push(place.map(|place| pose_columns(&place.world_from_camera)));
            if !frame.reason.is_empty() {
                columns.reasons.insert(frame.sequence, frame.reason);
            }
        }
        columns
    }
}
