//! Lines of an update, and their cells in the R*Tree.

use super::cells::LandmarkTables;
use super::rows::{MultiRow, id_list};
use crate::StoreError;
use crate::lines::{LineRow, N_LINE_COLUMNS};
use crate::points::cell::Cell;
use nalgebra::Vector3;
use slam::map::{LineLandmark, MapUpdate};
use sqlx::{Row, SqliteConnection};
use std::collections::BTreeMap;

const LINE_ROWS: MultiRow = MultiRow {
    insert: "INSERT INTO lines (session, id, submap, moment_x, moment_y, moment_z, direction_x, direction_y, \
             direction_z, start_x, start_y, start_z, end_x, end_y, end_z, descriptor, created_by, n_visible, \
             n_found, primitive, n_observations, observations) VALUES ",
    n_columns: 1 + N_LINE_COLUMNS,
    conflict: " ON CONFLICT (session, id) DO UPDATE SET submap = excluded.submap, moment_x = excluded.moment_x, \
               moment_y = excluded.moment_y, moment_z = excluded.moment_z, direction_x = excluded.direction_x, \
               direction_y = excluded.direction_y, direction_z = excluded.direction_z, \
               start_x = excluded.start_x, start_y = excluded.start_y, start_z = excluded.start_z, \
               end_x = excluded.end_x, end_y = excluded.end_y, end_z = excluded.end_z, \
               descriptor = excluded.descriptor, n_visible = excluded.n_visible, n_found = excluded.n_found, \
               primitive = excluded.primitive, n_observations = excluded.n_observations, \
               observations = excluded.observations",
};

const TABLES: LandmarkTables = LandmarkTables {
    delete_rows: "DELETE FROM lines WHERE session = ? AND id IN (SELECT value FROM json_each(?))",
    delete_cells: "DELETE FROM line_cells WHERE key IN (SELECT value FROM json_each(?))",
    cells: MultiRow {
        insert: "INSERT OR REPLACE INTO line_cells (key, session_min, session_max, x_min, x_max, y_min, y_max, \
                 z_min, z_max) VALUES ",
        n_columns: 9,
        conflict: "",
    },
};

/// Deletes removed lines, and changed ones that are not in the map any more.
pub(super) async fn delete_lines(
    connection: &mut SqliteConnection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    let changes = &update.changes;
    let gone: Vec<u64> = changes
        .removed_lines
        .union(&changes.lines)
        .filter(|id| update.map.line(**id).is_none())
        .map(|id| id.get())
        .collect();
    TABLES.delete(connection, session, &gone).await
}

/// Writes changed lines' rows, and the cells of those that are new or left their cells.
pub(super) async fn write_lines(
    connection: &mut SqliteConnection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    let changed: Vec<&LineLandmark> =
        update.changes.lines.iter().filter_map(|id| update.map.line(*id)).collect();
    if changed.is_empty() {
        return Ok(());
    }
    let stored_cells = read_cells(connection, session, &changed).await?;
    let mut moved: Vec<(i64, Cell)> = Vec::new();
    LINE_ROWS
        .write(connection, &changed, |columns, line| {
            let row = LineRow::new(line)?;
            let cell = Cell::of_ends(&line.endpoints);
            if stored_cells.get(&row.id) != Some(&cell) {
                moved.push((row.id, cell));
            }
            columns.add(session)?;
            columns.add(row.id)?;
            columns.add(row.submap)?;
            row.place.iter().flat_map(|vector| vector.iter()).try_for_each(|value| columns.add(*value))?;
            columns.add(&row.descriptor[..])?;
            columns.add(row.created_by)?;
            columns.add(row.n_visible)?;
            columns.add(row.n_found)?;
            columns.add(row.primitive)?;
            columns.add(row.n_observations)?;
            columns.add(row.observations)
        })
        .await?;
    TABLES.write_cells(connection, session, &moved).await
}

/// The cells of those of the lines that are stored already; they follow from the row.
async fn read_cells(
    connection: &mut SqliteConnection,
    session: i64,
    lines: &[&LineLandmark],
) -> Result<BTreeMap<i64, Cell>, StoreError> {
    let rows = sqlx::query(
        "SELECT id, start_x, start_y, start_z, end_x, end_y, end_z FROM lines
         WHERE session = ? AND id IN (SELECT value FROM json_each(?))",
    )
    .bind(session)
    .bind(id_list(lines.iter().map(|line| line.id.get())))
    .fetch_all(connection)
    .await?;
    rows.iter()
        .map(|row| {
            let start = Vector3::new(row.try_get(1)?, row.try_get(2)?, row.try_get(3)?);
            let end = Vector3::new(row.try_get(4)?, row.try_get(5)?, row.try_get(6)?);
            Ok((row.try_get(0)?, Cell::of_ends(&[start, end])))
        })
        .collect()
}
