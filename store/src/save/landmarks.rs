//! What landmarks of every kind have in common: rows that go with their cells in an R*Tree.

use crate::StoreError;
use crate::engine::{Columns, Connection, MultiRow, Row, ids, query};
use crate::points::cell::{Cell, cell_key};
use slam::Map;
use slam::map::{MapChanges, MapUpdate};
use std::collections::{BTreeMap, BTreeSet};

/// A kind of landmark.
pub(super) trait Landmark: Sized + Sync {
    /// Its identity within a map.
    type Id: Copy + Ord;

    const TABLES: LandmarkTables;

    fn number(id: Self::Id) -> u64;

    fn find(map: &Map, id: Self::Id) -> Option<&Self>;

    fn changed(changes: &MapChanges) -> &BTreeSet<Self::Id>;

    fn removed(changes: &MapChanges) -> &BTreeSet<Self::Id>;

    fn id(&self) -> Self::Id;

    fn cell(&self) -> Cell;

    /// The cell of a row of [`LandmarkTables::select_places`]: a cell follows from the row.
    fn stored_cell(row: &Row) -> Result<Cell, StoreError>;

    /// The columns of the landmark's row.
    fn bind(&self, session: i64, columns: &mut Columns) -> Result<(), StoreError>;
}

/// The table of a kind of landmark and the R*Tree that finds them by place.
pub(super) struct LandmarkTables {
    /// Writes rows, also over those that are there.
    pub rows: MultiRow<'static>,
    /// Tells ids, and after them what cells follow from: of a session, by a list of ids.
    pub select_places: &'static str,
    /// Deletes rows: of a session, by a list of ids.
    pub delete_rows: &'static str,
    /// Deletes cells, by a list of keys.
    pub delete_cells: &'static str,
    /// Writes cells, also over those that are there.
    pub cells: MultiRow<'static>,
}

/// Deletes removed landmarks with their cells, and changed ones that are not in the map any more.
pub(super) async fn delete<L: Landmark>(
    connection: &mut Connection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    let touched = L::removed(&update.changes).union(L::changed(&update.changes));
    let gone = touched.filter(|id| L::find(&update.map, **id).is_none());
    let gone: Vec<u64> = gone.map(|id| L::number(*id)).collect();
    if gone.is_empty() {
        return Ok(());
    }
    query(L::TABLES.delete_rows)
        .bind(session)
        .bind(ids(gone.iter().copied()))
        .execute(&mut *connection)
        .await?;
    query(L::TABLES.delete_cells)
        .bind(ids(gone.iter().map(|id| cell_key(session, *id as i64) as u64)))
        .execute(connection)
        .await?;
    Ok(())
}

/// Writes changed landmarks' rows, and the cells of those that are new or left their cells.
pub(super) async fn write<L: Landmark>(
    connection: &mut Connection,
    session: i64,
    update: &MapUpdate,
) -> Result<(), StoreError> {
    let changed = L::changed(&update.changes).iter().filter_map(|id| L::find(&update.map, *id));
    let changed: Vec<&L> = changed.collect();
    if changed.is_empty() {
        return Ok(());
    }
    let stored_cells = read_cells(connection, session, &changed).await?;
    let mut moved: Vec<(i64, Cell)> = Vec::new();
    let bind = |columns: &mut Columns, landmark: &&L| {
        landmark.bind(session, columns)?;
        let (id, cell) = (L::number(landmark.id()) as i64, landmark.cell());
        if stored_cells.get(&id) != Some(&cell) {
            moved.push((id, cell));
        }
        Ok(())
    };
    L::TABLES.rows.write(connection, &changed, bind).await?;
    write_cells::<L>(connection, session, &moved).await
}

/// The cells of those of the landmarks that are stored already.
async fn read_cells<L: Landmark>(
    connection: &mut Connection,
    session: i64,
    landmarks: &[&L],
) -> Result<BTreeMap<i64, Cell>, StoreError> {
    let rows = query(L::TABLES.select_places)
        .bind(session)
        .bind(ids(landmarks.iter().map(|landmark| L::number(landmark.id()))))
        .fetch_all(connection)
        .await?;
    rows.iter().map(|row| Ok((row.try_get(0)?, L::stored_cell(row)?))).collect()
}

async fn write_cells<L: Landmark>(
    connection: &mut Connection,
    session: i64,
    moved: &[(i64, Cell)],
) -> Result<(), StoreError> {
    let bind = |columns: &mut Columns, (landmark, cell): &(i64, Cell)| {
        columns.add(cell_key(session, *landmark))?;
        columns.add(session)?;
        columns.add(session)?;
        (0..3).try_for_each(|axis| {
            columns.add(cell.low[axis])?;
            columns.add(cell.high[axis])
        })
    };
    L::TABLES.cells.write(connection, moved, bind).await
}
