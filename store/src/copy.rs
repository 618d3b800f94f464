//! Sessions and tokens from one database into another, whichever they are in.
//!
//! Rows are copied as they are, table by table, as of one commit of the database they are read from. Until a
//! session is complete and its digest is that of the original it has no name: nobody sees it, and what an
//! interrupted copy left behind is cleared away when the database is opened. Sessions that are there already
//! are compared and left alone, so that an interrupted copy of a whole database is finished by doing it
//! again.

use crate::engine::{Columns, Connection, HeldValue, MultiRow, Row, Value, query};
use crate::points::cell::{MAX_POINT_ID, cell_key, point_of_key};
use crate::session::session_number;
use crate::{Digest, Store, StoreError};
use futures_util::TryStreamExt;

/// Rows written in one transaction, some megabytes.
const ROWS_PER_STEP: usize = 4096;
/// The same of rows with images and features, which are a hundred times larger.
const BLOBS_PER_STEP: usize = 32;

/// The table of images.
const IMAGES: &str = "keyframe_images";

/// A table with its columns in the order of either database, without the session's number.
struct Table {
    name: &'static str,
    /// `i` whole numbers, `r` numbers, `f` truth values, `t` texts, `b` blobs, before each name.
    columns: &'static str,
    n_per_step: usize,
}

const fn table(name: &'static str, columns: &'static str) -> Table {
    Table { name, columns, n_per_step: ROWS_PER_STEP }
}

const fn blobs(name: &'static str, columns: &'static str) -> Table {
    Table { name, columns, n_per_step: BLOBS_PER_STEP }
}

/// A session's own row, without its number and name.
const SESSION: &str = "t camera, t options, i created_at_ns, i state, i last_sequence, i last_timestamp_ns, \
     i last_keyframe_id, i last_point_id, i n_frames, i n_keyframes, i n_points, i n_submaps, r metres_per_unit, \
     i last_line_id, i last_primitive_id, i n_lines, i n_primitives, r focal_correction, r centre_x_correction, \
     r centre_y_correction, f enlarges_small_images, r k1_correction, r k2_correction, r mask_share, f mask_given, \
     f enlarges_for_border, f calibration_contradicted, i found_readout_ns, i found_readout_sigma_ns, t map, \
     i camera_number, i last_camera_number";

/// Tables of a session, in an order in which none refers to one behind it.
const TABLES: [Table; 13] = [
    // In one transaction: a keyframe may hang on a later one.
    Table {
        name: "keyframes",
        columns: "i id, i submap, i sequence, i timestamp_ns, r qx, r qy, r qz, r qw, r tx, r ty, r tz, i parent, \
                  i n_keypoints, i n_points, i n_segments, i n_lines, r unit, i camera",
        n_per_step: usize::MAX,
    },
    blobs("keyframe_features", "i keyframe, b features"),
    // By `copy_images`: they may come to lie elsewhere.
    blobs(IMAGES, "i keyframe, t media_type, b bytes, t object, i object_bytes"),
    table("keyframe_vanishing", "i keyframe, b vanishing"),
    table("removed_keyframes", "i id, i anchor, r qx, r qy, r qz, r qw, r tx, r ty, r tz"),
    table(
        "points",
        "i id, i submap, r x, r y, r z, b descriptor, r view_x, r view_y, r view_z, r min_distance, r max_distance, \
         i created_by, i n_visible, i n_found, i n_observations, b observations",
    ),
    table(
        "lines",
        "i id, i submap, r moment_x, r moment_y, r moment_z, r direction_x, r direction_y, r direction_z, r start_x, \
         r start_y, r start_z, r end_x, r end_y, r end_z, b descriptor, i created_by, i n_visible, i n_found, \
         i primitive, i n_observations, b observations",
    ),
    table(
        "primitives",
        "i id, i submap, r direction_x, r direction_y, r direction_z, b covariance, i created_by, i n_observations, \
         b observations",
    ),
    table(
        "frames",
        "i sequence, i timestamp_ns, i state, f backfilled, i submap, i reference, r qx, r qy, r qz, r qw, r tx, \
         r ty, r tz, t reason",
    ),
    table("segments", "i first_sequence, i ahead_ns"),
    table("session_masks", "b runs"),
    table("added_cameras", "i camera, t parameters"),
    blobs("motion", "i first_ns, i n_readings, b readings"),
];

/// The trees of places, which are found by other columns.
const CELLS: [&str; 2] = ["point_cells", "line_cells"];
const BOX: &str = "r x_min, r x_max, r y_min, r y_max, r z_min, r z_max";

const TOKENS: &str = "t name, b hash, i role, t owner, i created_at_ns, i expires_at_ns, i revoked_at_ns, \
     i max_sessions, i max_streams, r max_frames_per_s, i max_stored_bytes";

/// What came of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Copied {
    /// It is there now, row by row.
    Whole,
    /// It was there already, row by row.
    Before,
}

impl Store {
    /// Copies a session of another database into this one, under the same name.
    ///
    /// # Errors
    /// [`StoreError::SessionExists`] if another session has the name here, [`StoreError::Corrupt`]
    /// if what was written is not what was read, and whatever either database reports.
    pub async fn copy_session(&self, from: &Self, id: &str) -> Result<Copied, StoreError> {
        let mut source = from.begin_read().await?;
        let original = session_number(&mut source, id).await?;
        let expected = Digest::read(&mut source, original).await?;
        if let Some(found) = self.digest_if_there(id).await? {
            return if found == expected {
                Ok(Copied::Before)
            } else {
                Err(StoreError::SessionExists { id: id.to_owned() })
            };
        }
        let number = self.copy_row(&mut source, original).await?;
        for table in &TABLES {
            if table.name == IMAGES {
                self.copy_images(&mut source, original, number).await?;
            } else {
                self.copy_table(&mut source, table, original, number).await?;
            }
        }
        for tree in CELLS {
            self.copy_cells(&mut source, tree, original, number).await?;
        }
        source.commit().await?;
        let mut reader = self.begin_read().await?;
        let written = Digest::read(&mut reader, number).await?;
        reader.commit().await?;
        if written != expected {
            return Err(StoreError::Corrupt(format!("the copy of session {id:?} is not the original")));
        }
        let mut transaction = self.begin_write().await?;
        let name =
            query("UPDATE sessions SET id = $1 WHERE number = $2 AND id IS NULL").bind(id).bind(number);
        if name.execute(&mut transaction).await? != 1 {
            return Err(StoreError::Corrupt(format!(
                "the copy of session {id:?} was cleared away meanwhile"
            )));
        }
        transaction.commit().await?;
        Ok(Copied::Whole)
    }

    /// Copies tokens of another database that this one has none of the same name for; how many there are.
    ///
    /// # Errors
    /// Whatever either database reports.
    pub async fn copy_tokens(&self, from: &Self) -> Result<u64, StoreError> {
        let mut source = from.reader().await?;
        let rows =
            query(format!("SELECT {} FROM tokens ORDER BY id", names(TOKENS))).fetch_all(&mut source).await?;
        let columns = names(TOKENS);
        let into = MultiRow {
            table: "tokens",
            columns: &columns,
            conflict: "ON CONFLICT (name) DO NOTHING",
            is_virtual: false,
        };
        let mut transaction = self.begin_write().await?;
        into.write(&mut transaction, &rows, |columns, row| add_all(columns, row, TOKENS, 0)).await?;
        transaction.commit().await?;
        Ok(rows.len() as u64)
    }

    /// Sessions that servers work with at present; always none in a file, which a server locks.
    ///
    /// # Errors
    /// If the database cannot be asked.
    pub async fn n_leased(&self) -> Result<u64, StoreError> {
        if self.path().is_some() {
            return Ok(0);
        }
        let leased = query("SELECT count(*) FROM leases WHERE expires_at > clock_timestamp()");
        let n: i64 = leased.only(&mut self.reader().await?).await?;
        Ok(n.unsigned_abs())
    }

    async fn digest_if_there(&self, id: &str) -> Result<Option<Digest>, StoreError> {
        match self.digest(id).await {
            Ok(digest) => Ok(Some(digest)),
            Err(StoreError::SessionNotFound { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Writes a session's row without its name; its number here.
    async fn copy_row(&self, source: &mut Connection, original: i64) -> Result<i64, StoreError> {
        let select = format!("SELECT {} FROM sessions WHERE number = $1", names(SESSION));
        let row = query(select).bind(original).fetch_one(source).await?;
        let mut insert = query(format!("INSERT INTO sessions ({}) VALUES (", names(SESSION)));
        for (idx, kind) in kinds(SESSION).enumerate() {
            insert.push(if idx > 0 { ", " } else { "" });
            insert.push_bind(value(&row, idx, kind)?);
        }
        insert.push(") RETURNING number");
        let mut transaction = self.begin_write().await?;
        let number = insert.only(&mut transaction).await?;
        transaction.commit().await?;
        Ok(number)
    }

    async fn copy_table(
        &self,
        source: &mut Connection,
        table: &Table,
        original: i64,
        number: i64,
    ) -> Result<(), StoreError> {
        let Table { name, columns: of_table, n_per_step } = *table;
        let select = format!("SELECT {} FROM {name} WHERE session = $1", names(of_table));
        let columns = format!("session, {}", names(of_table));
        let into = MultiRow { table: name, columns: &columns, conflict: "", is_virtual: false };
        self.copy_rows(query(select).bind(original).fetch(source), n_per_step, &into, |columns, row| {
            columns.add(number)?;
            add_all(columns, row, of_table, 0)
        })
        .await
    }

    async fn copy_cells(
        &self,
        source: &mut Connection,
        tree: &'static str,
        original: i64,
        number: i64,
    ) -> Result<(), StoreError> {
        let select = query(format!(
            "SELECT key, {} FROM {tree} WHERE session_min = $1 AND key BETWEEN ($1 << 40) AND (($1 << 40) | $2)",
            names(BOX)
        ));
        let rows = select.bind(original).bind(MAX_POINT_ID as i64).fetch(source);
        let columns = format!("key, session_min, session_max, {}", names(BOX));
        let into = MultiRow { table: tree, columns: &columns, conflict: "", is_virtual: true };
        self.copy_rows(rows, ROWS_PER_STEP, &into, |columns, row| {
            columns.add(cell_key(number, point_of_key(row.try_get(0)?)))?;
            columns.add(number)?;
            columns.add(number)?;
            add_all(columns, row, BOX, 1)
        })
        .await
    }

    /// Writes rows as they come, so many in a transaction.
    async fn copy_rows(
        &self,
        rows: futures_util::stream::BoxStream<'_, Result<Row, StoreError>>,
        n_per_step: usize,
        into: &MultiRow<'_>,
        add: impl Fn(&mut Columns, &Row) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let mut rows = rows;
        let mut step: Vec<Row> = Vec::new();
        loop {
            let row = rows.try_next().await?;
            let is_last = row.is_none();
            step.extend(row);
            if step.len() < n_per_step && !is_last {
                continue;
            }
            if !step.is_empty() {
                let mut transaction = self.begin_write().await?;
                into.write(&mut transaction, &step, &add).await?;
                transaction.commit().await?;
                step.clear();
            }
            if is_last {
                return Ok(());
            }
        }
    }
}

/// The names of columns, with a comma between.
fn names(columns: &str) -> String {
    let names: Vec<&str> = columns.split(',').filter_map(|column| column.split_whitespace().nth(1)).collect();
    names.join(", ")
}

fn kinds(columns: &'static str) -> impl Iterator<Item = char> {
    columns.split(',').filter_map(|column| column.trim_start().chars().next())
}

/// Adds a row's columns from `first` on.
fn add_all(columns: &mut Columns, row: &Row, of_table: &'static str, first: usize) -> Result<(), StoreError> {
    kinds(of_table).enumerate().try_for_each(|(idx, kind)| columns.add(value(row, first + idx, kind)?))
}

/// What a column of a kind holds.
fn value(row: &Row, column: usize, kind: char) -> Result<Value, StoreError> {
    Ok(match (kind, row.any(column)?) {
        ('i', HeldValue::Int(number)) => Value::Int(Some(number)),
        ('i', HeldValue::Null) => Value::Int(None),
        ('r', HeldValue::Real(number)) => Value::Real(Some(number)),
        ('r', HeldValue::Null) => Value::Real(None),
        ('f', HeldValue::Int(truth)) => Value::Bool(truth != 0),
        ('t', HeldValue::Text(text)) => Value::Text(Some(text.to_owned())),
        ('t', HeldValue::Null) => Value::Text(None),
        ('b', HeldValue::Bytes(bytes)) => Value::Bytes(Some(bytes.to_vec())),
        ('b', HeldValue::Null) => Value::Bytes(None),
        _ => return Err(StoreError::Corrupt(format!("column {column} of a row is of another type"))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn names(columns: &str) -> BTreeSet<String> {
        columns.split(',').filter_map(|column| column.split_whitespace().nth(1)).map(str::to_owned).collect()
    }

    /// A column that is added and not copied would be lost without a word.
    #[tokio::test]
    async fn every_column_there_is_is_copied() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("maps.db");
        Store::open(&file, crate::StoreOptions::default()).await.unwrap().close().await.unwrap();
        let database = sqlx::SqlitePool::connect(file.to_str().unwrap()).await.unwrap();
        let columns: Vec<(String, String)> = sqlx::query_as(
            "SELECT t.name, c.name FROM sqlite_schema t, pragma_table_info(t.name) c WHERE t.type = 'table'",
        )
        .fetch_all(&database)
        .await
        .unwrap();
        let columns_of = |table: &str| -> BTreeSet<String> {
            columns.iter().filter(|(name, _)| name == table).map(|(_, column)| column.clone()).collect()
        };
        let of_sessions: BTreeSet<&str> = columns
            .iter()
            .filter(|(name, column)| column == "session" && !name.contains("cells"))
            .map(|(name, _)| name.as_str())
            .collect();
        assert_eq!(of_sessions, TABLES.iter().map(|table| table.name).collect());
        for table in &TABLES {
            let mut there = columns_of(table.name);
            assert!(there.remove("session"), "{}", table.name);
            assert_eq!(names(table.columns), there, "{}", table.name);
        }
        let mut there = columns_of("sessions");
        assert!(there.remove("number") && there.remove("id"));
        assert_eq!(names(SESSION), there);
    }
}
