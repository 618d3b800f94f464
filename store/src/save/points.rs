//! Points of an update, and their cells in the R*Tree.

use super::cells::LandmarkTables;
use super::rows::{MultiRow, id_list};
use crate::StoreError;
use crate::points::PointRow;
use crate::points::cell::Cell;
use nalgebra::Vector3;
use slam::map::{MapUpdate, PointLandmark};
use sqlx::{Row, SqliteConnection};
use std::collections::BTreeMap;

const POINT_ROWS: MultiRow = MultiRow {
    insert: "INSERT INTO points (session, id, submap, x, y, z, descriptor, view_x, view_y, view_z, min_distance, \
             max_distance, created_by, n_visible, n_found, n_observations, observations) VALUES ",
    n_columns: 17,
    conflict: " ON CONFLICT (session, id) DO UPDATE SET submap = excluded.submap, x = excluded.x, \
               y = excluded.y, z = excluded.z, descriptor = excluded.descriptor, view_x = excluded.view_x, \
               view_y = excluded.view_y, view_z = excluded.view_z, min_distance = excluded.min_distance, \
               max_distance = excluded.max_distance, n_visible = excluded.n_visible, n_found = excluded.n_found, \
               n_observations = excluded.n_observations, observations = excluded.observations",
};

const TABLES: LandmarkTables = LandmarkTables {
    delete_rows: "DELETE FROM points WHERE session = ? AND id IN (SELECT value FROM json_each(?))",
    delete_cells: "DELETE FROM point_cells WHERE key IN (SELECT value FROM json_each(?))",
    cells: MultiRow {
        insert: "INSERT OR REPLACE INTO point_cells (key, session_min, session_max, x_min, x_max, y_min, y_max, \
                 z_min, z_max) VALUES ",
        n_columns: 9,
        conflict: "",
    },
};

/// Deletes removed points, and changed ones that are not in the map any more.
pub(super) async fn delete_points(
    connection: &mut SqliteConnection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    let changes = &update.changes;
    let gone: Vec<u64> = changes
        .removed_points
        .union(&changes.points)
        .filter(|id| update.map.point(**id).is_none())
        .map(|id| id.get())
        .collect();
    TABLES.delete(connection, session, &gone).await
}

/// Writes changed points' rows, and the cells of those that are new or left their cell.
pub(super) async fn write_points(
    connection: &mut SqliteConnection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    let changed: Vec<&PointLandmark> =
        update.changes.points.iter().filter_map(|id| update.map.point(*id)).collect();
    if changed.is_empty() {
        return Ok(());
    }
    let stored_cells = read_cells(connection, session, &changed).await?;
    let mut moved: Vec<(i64, Cell)> = Vec::new();
    POINT_ROWS
        .write(connection, &changed, |columns, point| {
            let row = PointRow::new(point)?;
            let cell = Cell::of(&row.position, row.distance_range.1);
            if stored_cells.get(&row.id) != Some(&cell) {
                moved.push((row.id, cell));
            }
            columns.add(session)?;
            columns.add(row.id)?;
            columns.add(row.submap)?;
            row.position.iter().try_for_each(|value| columns.add(*value))?;
            columns.add(&row.descriptor[..])?;
            row.view.iter().try_for_each(|value| columns.add(*value))?;
            columns.add(row.distance_range.0)?;
            columns.add(row.distance_range.1)?;
            columns.add(row.created_by)?;
            columns.add(row.n_visible)?;
            columns.add(row.n_found)?;
            columns.add(row.n_observations)?;
            columns.add(row.observations)
        })
        .await?;
    TABLES.write_cells(connection, session, &moved).await
}

/// The cells of those of the points that are stored already; a cell follows from the row.
async fn read_cells(
    connection: &mut SqliteConnection,
    session: i64,
    points: &[&PointLandmark],
) -> Result<BTreeMap<i64, Cell>, StoreError> {
    let rows = sqlx::query(
        "SELECT id, x, y, z, max_distance FROM points
         WHERE session = ? AND id IN (SELECT value FROM json_each(?))",
    )
    .bind(session)
    .bind(id_list(points.iter().map(|point| point.id.get())))
    .fetch_all(connection)
    .await?;
    rows.iter()
        .map(|row| {
            let position = Vector3::new(row.try_get(1)?, row.try_get(2)?, row.try_get(3)?);
            Ok((row.try_get(0)?, Cell::of(&position, row.try_get(4)?)))
        })
        .collect()
}
