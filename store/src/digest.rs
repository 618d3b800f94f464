//! A fingerprint of everything a session has stored, to compare two runs.

use crate::engine::{Connection, HeldValue, Row, query};
use crate::images::image_hash;
use crate::points::cell::MAX_POINT_ID;
use crate::session::session_number;
use crate::{Store, StoreError};
use futures_util::TryStreamExt;
use sha2::Digest as _;
use std::fmt;

/// Fingerprints of a session's tables. Equal for two sessions whose rows are the same, byte for byte, apart
/// from the sessions' names and the wall-clock time of their creation. Prints as one line per table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Digest(pub Vec<TableDigest>);

/// Fingerprint of a session's rows in one table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableDigest {
    /// Name of the table.
    pub table: &'static str,
    /// How many rows the session has in it.
    pub n_rows: u64,
    /// SHA-256 of the rows' values in the order of their keys.
    pub sha256: [u8; 32],
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for TableDigest { table, n_rows, sha256 } in &self.0 {
            write!(f, "{table} {n_rows} ")?;
            sha256.iter().try_for_each(|byte| write!(f, "{byte:02x}"))?;
            writeln!(f)?;
        }
        Ok(())
    }
}

/// The table of images.
const IMAGES: &str = "keyframe_images";

/// Every table with every column but the session's number and name and wall-clock time, ordered by key; of
/// cells, which follow from the rows and which [`Store::check`] compares with them, which there are.
/// Parameter 1 is the session's number, 2 the mask of a point's id in a key.
const TABLES: [(&str, &str); 16] = [
    (
        "sessions",
        "SELECT camera, options, state, last_sequence, last_timestamp_ns, last_keyframe_id, last_point_id, last_line_id,
         last_primitive_id, n_frames, n_keyframes, n_points, n_lines, n_primitives, n_submaps, metres_per_unit, map,
         camera_number FROM sessions WHERE number = $1",
    ),
    (
        "keyframes",
        "SELECT id, submap, sequence, timestamp_ns, qx, qy, qz, qw, tx, ty, tz, unit, parent, n_keypoints, n_points,
         n_segments, n_lines, camera FROM keyframes WHERE session = $1 ORDER BY id",
    ),
    ("added_cameras", "SELECT camera, parameters FROM added_cameras WHERE session = $1 ORDER BY camera"),
    (
        "keyframe_features",
        "SELECT keyframe, features FROM keyframe_features WHERE session = $1 ORDER BY keyframe",
    ),
    (
        IMAGES,
        "SELECT keyframe, media_type, bytes, object FROM keyframe_images WHERE session = $1 ORDER BY keyframe",
    ),
    (
        "removed_keyframes",
        "SELECT id, anchor, qx, qy, qz, qw, tx, ty, tz FROM removed_keyframes WHERE session = $1 ORDER BY id",
    ),
    (
        "points",
        "SELECT id, submap, x, y, z, descriptor, view_x, view_y, view_z, min_distance, max_distance, created_by,
         n_visible, n_found, n_observations, observations FROM points WHERE session = $1 ORDER BY id",
    ),
    (
        "point_cells",
        "SELECT key & $2 FROM point_cells
         WHERE session_min = $1 AND key BETWEEN ($1 << 40) AND (($1 << 40) | $2) ORDER BY key",
    ),
    (
        "keyframe_vanishing",
        "SELECT keyframe, vanishing FROM keyframe_vanishing WHERE session = $1 ORDER BY keyframe",
    ),
    (
        "lines",
        "SELECT id, submap, moment_x, moment_y, moment_z, direction_x, direction_y, direction_z, start_x, start_y,
         start_z, end_x, end_y, end_z, descriptor, created_by, n_visible, n_found, primitive, n_observations,
         observations FROM lines WHERE session = $1 ORDER BY id",
    ),
    (
        "line_cells",
        "SELECT key & $2 FROM line_cells
         WHERE session_min = $1 AND key BETWEEN ($1 << 40) AND (($1 << 40) | $2) ORDER BY key",
    ),
    (
        "primitives",
        "SELECT id, submap, direction_x, direction_y, direction_z, covariance, created_by, n_observations,
         observations FROM primitives WHERE session = $1 ORDER BY id",
    ),
    (
        "frames",
        "SELECT sequence, timestamp_ns, state, backfilled, submap, reference, qx, qy, qz, qw, tx, ty, tz
         FROM frames WHERE session = $1 ORDER BY sequence",
    ),
    ("session_masks", "SELECT runs FROM session_masks WHERE session = $1"),
    ("motion", "SELECT first_ns, n_readings, readings FROM motion WHERE session = $1 ORDER BY first_ns"),
    (
        "segments",
        "SELECT first_sequence, ahead_ns FROM segments WHERE session = $1 ORDER BY first_sequence",
    ),
];

impl Store {
    /// Fingerprints of everything a session has stored, as of the last commit.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn digest(&self, session: &str) -> Result<Digest, StoreError> {
        let mut transaction = self.begin_read().await?;
        let number = session_number(&mut transaction, session).await?;
        let digest = Digest::read(&mut transaction, number).await?;
        transaction.commit().await?;
        Ok(digest)
    }
}

impl Digest {
    /// Of the session of this number; the connection should be in a transaction.
    pub(crate) async fn read(connection: &mut Connection, session: i64) -> Result<Self, StoreError> {
        let mut tables = Vec::with_capacity(TABLES.len());
        for (table, sql) in TABLES {
            tables.push(digest_table(connection, table, sql, session).await?);
        }
        Ok(Self(tables))
    }
}

async fn digest_table(
    connection: &mut Connection,
    table: &'static str,
    sql: &'static str,
    session: i64,
) -> Result<TableDigest, StoreError> {
    let mut hasher = sha2::Sha256::new();
    let mut n_rows = 0;
    let mut statement = query(sql).bind(session);
    // A statement is prepared with as many values as it is given, and others of the same text give what is in
    // it.
    if sql.contains("$2") {
        statement = statement.bind(MAX_POINT_ID as i64);
    }
    let mut rows = statement.fetch(connection);
    while let Some(row) = rows.try_next().await? {
        n_rows += 1;
        if table == IMAGES {
            // Wherever the image lies.
            (0..2).try_for_each(|column| hash_value(&mut hasher, &row, column))?;
            hasher.update(image_hash(&row, 2, 3)?);
            continue;
        }
        (0..row.len()).try_for_each(|column| hash_value(&mut hasher, &row, column))?;
    }
    Ok(TableDigest { table, n_rows, sha256: hasher.finalize().into() })
}

/// Hashes a value with its type and, where it varies, its length, so that no two rows hash the same by
/// accident. The same in either database: SQLite knows no negative zero.
fn hash_value(hasher: &mut sha2::Sha256, row: &Row, column: usize) -> Result<(), StoreError> {
    let mut sized = |tag: &[u8], bytes: &[u8]| {
        hasher.update(tag);
        hasher.update((bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    match row.any(column)? {
        HeldValue::Null => hasher.update(b"n"),
        HeldValue::Real(value) => sized(b"r", &(value + 0.0).to_bits().to_le_bytes()),
        HeldValue::Text(text) => sized(b"t", text.as_bytes()),
        HeldValue::Bytes(bytes) => sized(b"b", bytes),
        HeldValue::Int(value) => sized(b"i", &value.to_le_bytes()),
    }
    Ok(())
}
