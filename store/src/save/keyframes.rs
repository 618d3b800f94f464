//! Keyframes of an update, and what removed ones hang on.

use crate::StoreError;
use crate::blob::encode_features;
use crate::cameras::MapSessions;
use crate::engine::{Connection, MultiRow, ids, query};
use crate::number::{keyframe_column, to_column};
use crate::pose::{finite, finite_pose_columns};
use slam::Keyframe;
use slam::map::{KeyframeId, MapUpdate, RemovedKeyframe};
use std::collections::BTreeSet;

const KEYFRAME_ROWS: MultiRow<'static> = MultiRow {
    table: "keyframes",
    columns: "session, id, submap, sequence, timestamp_ns, qx, qy, qz, qw, tx, ty, tz, unit, \
              parent, n_keypoints, n_points, n_segments, n_lines, camera",
    conflict: "ON CONFLICT (session, id) DO UPDATE SET submap = excluded.submap, qx = excluded.qx, \
               qy = excluded.qy, qz = excluded.qz, qw = excluded.qw, tx = excluded.tx, ty = excluded.ty, \
               tz = excluded.tz, unit = excluded.unit, parent = excluded.parent, n_points = excluded.n_points, \
               n_lines = excluded.n_lines",
    is_virtual: false,
};

const REMOVED_ROWS: MultiRow<'static> = MultiRow {
    table: "removed_keyframes",
    columns: "session, id, anchor, qx, qy, qz, qw, tx, ty, tz",
    conflict: "ON CONFLICT (session, id) DO UPDATE SET anchor = excluded.anchor, qx = excluded.qx, \
               qy = excluded.qy, qz = excluded.qz, qw = excluded.qw, tx = excluded.tx, ty = excluded.ty, \
               tz = excluded.tz",
    is_virtual: false,
};

/// Features are large: statements of one row, the text of which is prepared once.
const WRITE_FEATURES: &str = "INSERT INTO keyframe_features (session, keyframe, features) VALUES ($1, $2, $3)
     ON CONFLICT (session, keyframe) DO UPDATE SET features = excluded.features";

/// Writes changed keyframes' rows, deletes removed ones', and notes what those hang on.
pub(super) async fn write_keyframes(
    connection: &mut Connection,
    session: i64,
    update: &MapUpdate,
    sessions: &MapSessions,
) -> Result<(), StoreError> {
    let changed: Vec<&Keyframe> =
        update.changes.keyframes.iter().filter_map(|id| update.map.keyframe(*id)).collect();
    KEYFRAME_ROWS
        .write(connection, &changed, |columns, keyframe| {
            let pose = finite_pose_columns("a keyframe's pose", &keyframe.camera_from_world)?;
            columns.add(session)?;
            columns.add(keyframe_column(keyframe.id)?)?;
            columns.add(i64::from(keyframe.submap.0))?;
            columns.add(to_column("sequence", keyframe.sequence)?)?;
            let Keyframe { camera, sequence, timestamp_ns, .. } = *keyframe;
            columns.add(sessions.client_ns(camera.id, *sequence, *timestamp_ns))?;
            pose.into_iter().try_for_each(|value| columns.add(value))?;
            columns.add(finite("a keyframe's unit", keyframe.local_scale)?)?;
            columns.add(keyframe.parent.map(keyframe_column).transpose()?)?;
            columns.add(keyframe.features.len() as i64)?;
            columns.add(keyframe.n_points() as i64)?;
            columns.add(keyframe.lines.len() as i64)?;
            columns.add(keyframe.observed_lines().count() as i64)?;
            columns.add(i64::from(keyframe.camera.id.0))
        })
        .await?;
    delete_keyframes(connection, session, update).await
}

/// Copies images of keyframes of one session to those of another, given by their numbers there and here; what
/// has none, or is not in the map any more, is passed over.
pub(super) async fn copy_images(
    connection: &mut Connection,
    (from, into): (i64, i64),
    keyframes: &[(KeyframeId, KeyframeId)],
) -> Result<(), StoreError> {
    for (there, here) in keyframes {
        query(
            "INSERT INTO keyframe_images (session, keyframe, media_type, bytes, object, object_bytes)
             SELECT $1, $2, media_type, bytes, object, object_bytes FROM keyframe_images WHERE session = $3 AND keyframe = $4
             AND EXISTS (SELECT 1 FROM keyframes WHERE session = $1 AND id = $2)",
        )
        .bind(into)
        .bind(keyframe_column(*here)?)
        .bind(from)
        .bind(keyframe_column(*there)?)
        .execute(&mut *connection)
        .await?;
    }
    Ok(())
}

async fn delete_keyframes(
    connection: &mut Connection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    let changes = &update.changes;
    // A changed keyframe that is not in the map went in the same breath.
    let gone: BTreeSet<KeyframeId> = changes
        .removed_keyframes
        .union(&changes.keyframes)
        .copied()
        .filter(|id| update.map.keyframe(*id).is_none())
        .collect();
    if gone.is_empty() {
        return Ok(());
    }
    query("DELETE FROM keyframes WHERE session = $1 AND id IN IDS($2)")
        .bind(session)
        .bind(ids(gone.iter().map(|id| id.get())))
        .execute(&mut *connection)
        .await?;

    let removed: Vec<&RemovedKeyframe> =
        gone.iter().filter_map(|id| update.map.removed_keyframe(*id)).collect();
    REMOVED_ROWS
        .write(connection, &removed, |columns, removed| {
            let pose = finite_pose_columns("a removed keyframe's pose", &removed.camera_from_anchor)?;
            columns.add(session)?;
            columns.add(keyframe_column(removed.id)?)?;
            columns.add(keyframe_column(removed.anchor)?)?;
            pose.into_iter().try_for_each(|value| columns.add(value))
        })
        .await?;
    if removed.len() < gone.len() {
        // A whole submap went, and with it what hung on its keyframes.
        query("DELETE FROM removed_keyframes WHERE session = $1 AND id NOT IN IDS($2)")
            .bind(session)
            .bind(ids(update.map.removed_keyframes().map(|removed| removed.id.get())))
            .execute(connection)
            .await?;
    }
    Ok(())
}

/// Writes the features of keyframes that are new to the database, or that have them elsewhere than before.
pub(super) async fn write_features(
    connection: &mut Connection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    if update.changes.keyframes.is_empty() {
        return Ok(());
    }
    let known: Vec<i64> =
        query("SELECT keyframe FROM keyframe_features WHERE session = $1 AND keyframe IN IDS($2)")
            .bind(session)
            .bind(ids(update.changes.keyframes.iter().map(|id| id.get())))
            .scalars(&mut *connection)
            .await?;
    let known: BTreeSet<i64> = known.into_iter().collect();
    for keyframe in update.changes.keyframes.iter().filter_map(|id| update.map.keyframe(*id)) {
        let id = keyframe_column(keyframe.id)?;
        if !known.contains(&id) || update.changes.moved_features.contains(&keyframe.id) {
            query(WRITE_FEATURES)
                .bind(session)
                .bind(id)
                .bind(encode_features(&keyframe.features))
                .execute(&mut *connection)
                .await?;
        }
    }
    Ok(())
}
