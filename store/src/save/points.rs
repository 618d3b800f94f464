//! Points of an update, and their cells in the R*Tree.

use super::landmarks::{Landmark, LandmarkTables};
use super::rows::{Columns, MultiRow};
use crate::StoreError;
use crate::points::PointRow;
use crate::points::cell::Cell;
use nalgebra::Vector3;
use slam::Map;
use slam::map::{MapChanges, PointId, PointLandmark};
use sqlx::Row;
use sqlx::sqlite::SqliteRow;
use std::collections::BTreeSet;

impl Landmark for PointLandmark {
    type Id = PointId;

    const TABLES: LandmarkTables = LandmarkTables {
        rows: MultiRow {
            insert: "INSERT INTO points (session, id, submap, x, y, z, descriptor, view_x, view_y, view_z, min_distance, \
                     max_distance, created_by, n_visible, n_found, n_observations, observations) VALUES ",
            n_columns: 17,
            conflict: " ON CONFLICT (session, id) DO UPDATE SET submap = excluded.submap, x = excluded.x, \
                       y = excluded.y, z = excluded.z, descriptor = excluded.descriptor, view_x = excluded.view_x, \
                       view_y = excluded.view_y, view_z = excluded.view_z, min_distance = excluded.min_distance, \
                       max_distance = excluded.max_distance, n_visible = excluded.n_visible, n_found = excluded.n_found, \
                       n_observations = excluded.n_observations, observations = excluded.observations",
        },
        select_places: "SELECT id, x, y, z, max_distance FROM points
         WHERE session = ? AND id IN (SELECT value FROM json_each(?))",
        delete_rows: "DELETE FROM points WHERE session = ? AND id IN (SELECT value FROM json_each(?))",
        delete_cells: "DELETE FROM point_cells WHERE key IN (SELECT value FROM json_each(?))",
        cells: MultiRow {
            insert: "INSERT OR REPLACE INTO point_cells (key, session_min, session_max, x_min, x_max, y_min, y_max, \
                     z_min, z_max) VALUES ",
            n_columns: 9,
            conflict: "",
        },
    };

    fn number(id: PointId) -> u64 {
        id.get()
    }

    fn find(map: &Map, id: PointId) -> Option<&Self> {
        map.point(id)
    }

    fn changed(changes: &MapChanges) -> &BTreeSet<PointId> {
        &changes.points
    }

    fn removed(changes: &MapChanges) -> &BTreeSet<PointId> {
        &changes.removed_points
    }

    fn id(&self) -> PointId {
        self.id
    }

    fn cell(&self) -> Cell {
        Cell::of(&self.position, self.distance_range.1)
    }

    fn stored_cell(row: &SqliteRow) -> Result<Cell, StoreError> {
        let position = Vector3::new(row.try_get(1)?, row.try_get(2)?, row.try_get(3)?);
        Ok(Cell::of(&position, row.try_get(4)?))
    }

    fn bind(&self, session: i64, columns: &mut Columns) -> Result<(), StoreError> {
        let row = PointRow::new(self)?;
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
    }
}
