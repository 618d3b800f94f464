//! Global primitives of an update, and the vanishing points of its keyframes.

use crate::StoreError;
use crate::blob::{encode_covariance, encode_observations, encode_vanishing};
use crate::engine::{Connection, MultiRow, ids, query};
use crate::number::{keyframe_column, to_column};
use slam::Keyframe;
use slam::map::{GlobalPrimitive, MapUpdate, Observation};
use std::collections::BTreeMap;

const PRIMITIVE_ROWS: MultiRow<'static> = MultiRow {
    table: "primitives",
    columns: "session, id, submap, direction_x, direction_y, direction_z, covariance, \
              created_by, n_observations, observations",
    conflict: "ON CONFLICT (session, id) DO UPDATE SET submap = excluded.submap, \
               direction_x = excluded.direction_x, direction_y = excluded.direction_y, \
               direction_z = excluded.direction_z, covariance = excluded.covariance, \
               n_observations = excluded.n_observations, observations = excluded.observations",
    is_virtual: false,
};

/// Writes changed primitives' rows and deletes those that are not in the map any more.
pub(super) async fn write_primitives(
    connection: &mut Connection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    let changes = &update.changes;
    let changed: Vec<&GlobalPrimitive> =
        changes.primitives.iter().filter_map(|id| update.map.primitive(*id)).collect();
    PRIMITIVE_ROWS
        .write(connection, &changed, |columns, primitive| {
            let id = to_column("primitive id", primitive.id.get())?;
            if !primitive.is_finite() {
                return Err(StoreError::NotFinite(format!("primitive {id}")));
            }
            let seen = |seen: &slam::map::PrimitiveObservation| Observation {
                keyframe: seen.keyframe,
                feature_idx: seen.vanishing_idx,
            };
            let observations: Vec<Observation> = primitive.observations.iter().map(seen).collect();
            columns.add(session)?;
            columns.add(id)?;
            columns.add(i64::from(primitive.submap.0))?;
            primitive.direction.as_vector().iter().try_for_each(|value| columns.add(*value))?;
            columns.add(&encode_covariance(&primitive.covariance)[..])?;
            columns.add(keyframe_column(primitive.created_by)?)?;
            columns.add(observations.len() as i64)?;
            columns.add(encode_observations(&observations))
        })
        .await?;
    let gone: Vec<u64> = changes
        .removed_primitives
        .union(&changes.primitives)
        .filter(|id| update.map.primitive(**id).is_none())
        .map(|id| id.get())
        .collect();
    if !gone.is_empty() {
        query("DELETE FROM primitives WHERE session = $1 AND id IN IDS($2)")
            .bind(session)
            .bind(ids(gone))
            .execute(connection)
            .await?;
    }
    Ok(())
}

/// Writes the vanishing points of changed keyframes where they are not stored already, which they mostly
/// are.
pub(super) async fn write_vanishing(
    connection: &mut Connection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    let changed: Vec<&Keyframe> =
        update.changes.keyframes.iter().filter_map(|id| update.map.keyframe(*id)).collect();
    if changed.is_empty() {
        return Ok(());
    }
    let rows = query(
        "SELECT keyframe, vanishing FROM keyframe_vanishing
         WHERE session = $1 AND keyframe IN IDS($2)",
    )
    .bind(session)
    .bind(ids(changed.iter().map(|keyframe| keyframe.id.get())))
    .fetch_all(&mut *connection)
    .await?;
    let stored = rows
        .iter()
        .map(|row| Ok((row.try_get(0)?, row.try_get(1)?)))
        .collect::<Result<BTreeMap<i64, Vec<u8>>, StoreError>>()?;
    for keyframe in changed {
        let id = keyframe_column(keyframe.id)?;
        let is_finite = |seen: &slam::map::VanishingObservation| {
            seen.direction.iter().chain(seen.covariance.iter()).all(|value| value.is_finite())
        };
        if !keyframe.vanishing.iter().all(is_finite) {
            return Err(StoreError::NotFinite(format!("a vanishing point of keyframe {id}")));
        }
        let vanishing = (!keyframe.vanishing.is_empty()).then(|| encode_vanishing(&keyframe.vanishing));
        if stored.get(&id) == vanishing.as_ref() {
            continue;
        }
        let statement = match vanishing {
            Some(vanishing) => query(
                "INSERT INTO keyframe_vanishing (session, keyframe, vanishing) VALUES ($1, $2, $3)
                 ON CONFLICT (session, keyframe) DO UPDATE SET vanishing = excluded.vanishing",
            )
            .bind(session)
            .bind(id)
            .bind(vanishing),
            None => query("DELETE FROM keyframe_vanishing WHERE session = $1 AND keyframe = $2")
                .bind(session)
                .bind(id),
        };
        statement.execute(&mut *connection).await?;
    }
    Ok(())
}
