//! Lines of an update, and their cells in the R*Tree.

use super::landmarks::{Landmark, LandmarkTables};
use crate::StoreError;
use crate::engine::{Columns, MultiRow, Row};
use crate::lines::LineRow;
use crate::points::cell::Cell;
use nalgebra::Vector3;
use slam::Map;
use slam::map::{LineId, LineLandmark, MapChanges};
use std::collections::BTreeSet;

impl Landmark for LineLandmark {
    type Id = LineId;

    const TABLES: LandmarkTables = LandmarkTables {
        rows: MultiRow {
            table: "lines",
            columns: "session, id, submap, moment_x, moment_y, moment_z, direction_x, direction_y, \
              direction_z, start_x, start_y, start_z, end_x, end_y, end_z, descriptor, \
              created_by, n_visible, n_found, primitive, n_observations, observations",
            conflict: "ON CONFLICT (session, id) DO UPDATE SET submap = excluded.submap, moment_x = excluded.moment_x, \
                       moment_y = excluded.moment_y, moment_z = excluded.moment_z, direction_x = excluded.direction_x, \
                       direction_y = excluded.direction_y, direction_z = excluded.direction_z, \
                       start_x = excluded.start_x, start_y = excluded.start_y, start_z = excluded.start_z, \
                       end_x = excluded.end_x, end_y = excluded.end_y, end_z = excluded.end_z, \
                       descriptor = excluded.descriptor, n_visible = excluded.n_visible, n_found = excluded.n_found, \
                       primitive = excluded.primitive, n_observations = excluded.n_observations, \
                       observations = excluded.observations",
            is_virtual: false,
        },
        select_places: "SELECT id, start_x, start_y, start_z, end_x, end_y, end_z FROM lines
         WHERE session = $1 AND id IN IDS($2)",
        delete_rows: "DELETE FROM lines WHERE session = $1 AND id IN IDS($2)",
        delete_cells: "DELETE FROM line_cells WHERE key IN IDS($1)",
        cells: MultiRow {
            table: "line_cells",
            columns: "key, session_min, session_max, x_min, x_max, y_min, y_max, z_min, z_max",
            conflict: "ON CONFLICT (key) DO UPDATE SET x_min = excluded.x_min, x_max = excluded.x_max, y_min = excluded.y_min, y_max = excluded.y_max, z_min = excluded.z_min, z_max = excluded.z_max",
            is_virtual: true,
        },
    };

    fn number(id: LineId) -> u64 {
        id.get()
    }

    fn find(map: &Map, id: LineId) -> Option<&Self> {
        map.line(id)
    }

    fn changed(changes: &MapChanges) -> &BTreeSet<LineId> {
        &changes.lines
    }

    fn removed(changes: &MapChanges) -> &BTreeSet<LineId> {
        &changes.removed_lines
    }

    fn id(&self) -> LineId {
        self.id
    }

    fn cell(&self) -> Cell {
        Cell::of_ends(&self.endpoints)
    }

    fn stored_cell(row: &Row) -> Result<Cell, StoreError> {
        let start = Vector3::new(row.try_get(1)?, row.try_get(2)?, row.try_get(3)?);
        let end = Vector3::new(row.try_get(4)?, row.try_get(5)?, row.try_get(6)?);
        Ok(Cell::of_ends(&[start, end]))
    }

    fn bind(&self, session: i64, columns: &mut Columns) -> Result<(), StoreError> {
        let row = LineRow::new(self)?;
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
    }
}
