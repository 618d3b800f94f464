//! What landmarks of every kind have in common: rows that go with their cells in an R*Tree.

use super::rows::{MultiRow, id_list};
use crate::StoreError;
use crate::points::cell::{Cell, cell_key};
use sqlx::SqliteConnection;

/// The table of a kind of landmark and the R*Tree that finds them by place.
pub(super) struct LandmarkTables {
    /// Deletes rows: of a session, by a list of ids.
    pub delete_rows: &'static str,
    /// Deletes cells, by a list of keys.
    pub delete_cells: &'static str,
    /// Writes cells, also over those that are there.
    pub cells: MultiRow,
}

impl LandmarkTables {
    /// Deletes landmarks with their cells.
    pub async fn delete(
        &self,
        connection: &mut SqliteConnection,
        session: i64,
        gone: &[u64],
    ) -> Result<(), StoreError> {
        if gone.is_empty() {
            return Ok(());
        }
        sqlx::query(self.delete_rows)
            .bind(session)
            .bind(id_list(gone.iter().copied()))
            .execute(&mut *connection)
            .await?;
        sqlx::query(self.delete_cells)
            .bind(id_list(gone.iter().map(|id| cell_key(session, *id as i64) as u64)))
            .execute(connection)
            .await?;
        Ok(())
    }

    /// Writes the cells of landmarks that are new or left theirs.
    pub async fn write_cells(
        &self,
        connection: &mut SqliteConnection,
        session: i64,
        moved: &[(i64, Cell)],
    ) -> Result<(), StoreError> {
        self.cells
            .write(connection, moved, |columns, (landmark, cell)| {
                columns.add(cell_key(session, *landmark))?;
                columns.add(session)?;
                columns.add(session)?;
                (0..3).try_for_each(|axis| {
                    columns.add(cell.low[axis])?;
                    columns.add(cell.high[axis])
                })
            })
            .await
    }
}
