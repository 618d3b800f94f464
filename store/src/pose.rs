//! Poses as seven columns, and poses of keyframes that may have been removed.

use crate::StoreError;
use crate::engine::{Connection, Row, query};
use crate::number::{keyframe_id, submap_id};
use geometry::Pose;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use slam::map::{KeyframeId, RemovedKeyframe, SubmapId};
use std::collections::BTreeMap;

/// A stored quaternion's length may differ from one by this: far more than rounding in any product of poses
/// makes.
const MAX_NORM_ERROR: f64 = 1e-6;

/// A pose in the order of the columns: `qx, qy, qz, qw, tx, ty, tz`.
pub(crate) fn pose_columns(pose: &Pose) -> [f64; 7] {
    let (q, t) = (pose.rotation.coords, pose.translation);
    [q.x, q.y, q.z, q.w, t.x, t.y, t.z]
}

/// As [`pose_columns`], refusing numbers that are not finite.
pub(crate) fn finite_pose_columns(what: &str, pose: &Pose) -> Result<[f64; 7], StoreError> {
    if pose.is_finite() { Ok(pose_columns(pose)) } else { Err(StoreError::NotFinite(what.to_owned())) }
}

/// The number, refused if it is not finite.
pub(crate) fn finite(what: &str, value: f64) -> Result<f64, StoreError> {
    if value.is_finite() { Ok(value) } else { Err(StoreError::NotFinite(what.to_owned())) }
}

/// The pose in the seven columns from `first` on; bit for bit what was stored.
pub(crate) fn read_pose(row: &Row, first: usize) -> Result<Pose, StoreError> {
    let mut columns = [0.0_f64; 7];
    for (offset, value) in columns.iter_mut().enumerate() {
        *value = row.try_get(first + offset)?;
    }
    let [qx, qy, qz, qw, tx, ty, tz] = columns;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let is_unit = (quaternion.norm() - 1.0).abs() <= MAX_NORM_ERROR;
    let pose = Pose::new(UnitQuaternion::new_unchecked(quaternion), Vector3::new(tx, ty, tz));
    if is_unit && pose.is_finite() {
        Ok(pose)
    } else {
        Err(StoreError::Corrupt("a pose is not a finite translation and a unit quaternion".into()))
    }
}

/// Where a keyframe is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Anchor {
    submap: SubmapId,
    camera_from_world: Pose,
    /// Map units per unit of the offsets of what hangs on it.
    local_scale: f64,
}

/// Where every keyframe of a session is, and what removed ones hang on: some hundred bytes for each.
#[derive(Debug, Default)]
pub(crate) struct PoseBook {
    pub(crate) keyframes: BTreeMap<KeyframeId, Anchor>,
    pub(crate) removed: BTreeMap<KeyframeId, RemovedKeyframe>,
}

impl PoseBook {
    /// Reads the poses of a session; the connection should be in a transaction.
    pub async fn read(connection: &mut Connection, session: i64) -> Result<Self, StoreError> {
        let rows =
            query("SELECT id, qx, qy, qz, qw, tx, ty, tz, submap, unit FROM keyframes WHERE session = $1")
                .bind(session)
                .fetch_all(&mut *connection)
                .await?;
        let keyframes = rows
            .iter()
            .map(|row| Ok((keyframe_id(row.try_get(0)?)?, read_anchor(row)?)))
            .collect::<Result<_, StoreError>>()?;
        let removed = read_removed(connection, session)
            .await?
            .into_iter()
            .map(|removed| (removed.id, removed))
            .collect();
        Ok(Self { keyframes, removed })
    }

    /// The submap and the pose, `camera_from_world`, of a camera that hangs on a keyframe that is or was in
    /// the map; `None` if that hangs on nothing.
    pub fn locate(&self, reference: KeyframeId, camera_from_reference: &Pose) -> Option<(SubmapId, Pose)> {
        let mut camera_from_current = *camera_from_reference;
        let mut current = reference;
        // The bound ends the walk where damaged rows form a ring.
        for _ in 0..=self.removed.len() {
            if let Some(anchor) = self.keyframes.get(&current) {
                camera_from_current.translation *= anchor.local_scale;
                return Some((anchor.submap, camera_from_current * anchor.camera_from_world));
            }
            let removed = self.removed.get(&current)?;
            camera_from_current = camera_from_current * removed.camera_from_anchor;
            current = removed.anchor;
        }
        None
    }

    /// The keyframes on which one that is or was in the map hangs, from itself to the one that is in the map.
    pub fn way_of(&self, reference: KeyframeId) -> Option<Vec<KeyframeId>> {
        let mut way = vec![reference];
        let mut current = reference;
        while !self.keyframes.contains_key(&current) {
            current = self.removed.get(&current)?.anchor;
            // Damaged rows may form a ring.
            if way.len() > self.removed.len() {
                return None;
            }
            way.push(current);
        }
        Some(way)
    }
}

fn read_anchor(row: &Row) -> Result<Anchor, StoreError> {
    Ok(Anchor {
        submap: submap_id(row.try_get(8)?)?,
        camera_from_world: read_pose(row, 1)?,
        local_scale: read_local_scale(row, 9)?,
    })
}

/// A keyframe's unit, which is finite and positive.
pub(crate) fn read_local_scale(row: &Row, column: usize) -> Result<f64, StoreError> {
    let local_scale: f64 = row.try_get(column)?;
    if local_scale.is_finite() && local_scale > 0.0 {
        Ok(local_scale)
    } else {
        Err(StoreError::Corrupt("a keyframe's unit is not a positive number".into()))
    }
}

/// The removed keyframes of a session in the order of their ids.
pub(crate) async fn read_removed(
    connection: &mut Connection,
    session: i64,
) -> Result<Vec<RemovedKeyframe>, StoreError> {
    let rows = query(
        "SELECT id, anchor, qx, qy, qz, qw, tx, ty, tz FROM removed_keyframes WHERE session = $1 ORDER BY id",
    )
    .bind(session)
    .fetch_all(connection)
    .await?;
    rows.iter()
        .map(|row| {
            Ok(RemovedKeyframe {
                id: keyframe_id(row.try_get(0)?)?,
                anchor: keyframe_id(row.try_get(1)?)?,
                camera_from_anchor: read_pose(row, 2)?,
            })
        })
        .collect()
}
