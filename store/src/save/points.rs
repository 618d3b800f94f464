//! Points of an update, and their cells in the R*Tree.

use super::landmarks::{Landmark, LandmarkTables};
use crate::StoreError;
use crate::engine::{Columns, MultiRow, Row};
use crate::points::PointRow;
use crate::points::cell::Cell;
use nalgebra::Vector3;
use slam::Map;
use slam::map::{MapChanges, PointId, PointLandmark};
use std::collections::BTreeSet;

impl Landmark for PointLandmark {
    type Id = PointId;

    const TABLES: LandmarkTables = LandmarkTables {
        rows: MultiRow {
            table: "points",
            columns: "session, id, submap, x, y, z, descriptor, view_x, view_y, view_z, min_distance, \
              max_distance, created_by, n_visible, n_found, n_observations, observations",
            conflict: "ON CONFLICT (session, id) DO UPDATE SET submap = excluded.submap, x = excluded.x, \
                       y = excluded.y, z = excluded.z, descriptor = excluded.descriptor, view_x = excluded.view_x, \
                       view_y = excluded.view_y, view_z = excluded.view_z, min_distance = excluded.min_distance, \
                       max_distance = excluded.max_distance, n_visible = excluded.n_visible, n_found = excluded.n_found, \
                       n_observations = excluded.n_observations, observations = excluded.observations",
            is_virtual: false,
        },
        select_places: "SELECT id, x, y, z, max_distance FROM points
         WHERE session = $1 AND id IN IDS($2)",
        delete_rows: "DELETE FROM points WHERE session = $1 AND id IN IDS($2)",
        delete_cells: "DELETE FROM point_cells WHERE key IN IDS($1)",
        cells: MultiRow {
            table: "point_cells",
            columns: "key, session_min, session_max, x_min, x_max, y_min, y_max, z_min, z_max",
            conflict: "ON CONFLICT (key) DO UPDATE SET x_min = excluded.x_min, x_max = excluded.x_max, y_min = excluded.y_min, y_max = excluded.y_max, z_min = excluded.z_min, z_max = excluded.z_max",
            is_virtual: true,
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

    fn stored_cell(row: &Row) -> Result<Cell, StoreError> {
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
