//! Checks of lines, their observations and their cells.

use super::points::has_cell;
use super::taken::Taken;
use super::{Findings, Measured};
use crate::StoreError;
use crate::engine::{Connection, query};
use crate::lines::{LINE_COLUMNS, N_LINE_COLUMNS, parse_line};
use crate::points::cell::{Cell, MAX_POINT_ID, cell_key};
use futures_util::TryStreamExt;
use slam::map::{LineLandmark, PrimitiveId};
use std::collections::BTreeSet;

/// How far an end may lie from its line, as a share of how far from the origin it is: far more than rounding
/// makes.
const MAX_END_ERROR: f64 = 1e-3;

/// Checks lines with their observations and cells; how many lines there are.
pub(super) async fn check_lines(
    connection: &mut Connection,
    session: i64,
    measured: &Measured,
    primitives: &BTreeSet<PrimitiveId>,
    problems: &mut Findings,
) -> Result<u64, StoreError> {
    let mut segments = Taken::new(["line", "segment"], measured, |[_, n_segments, _]| n_segments);
    let mut n_lines = 0;
    let sql = format!(
        "SELECT {LINE_COLUMNS}, x_min, x_max, y_min, y_max, z_min, z_max
         FROM lines LEFT JOIN line_cells ON key = $1 | id WHERE session = $2 ORDER BY id"
    );
    let mut rows = query(sql).bind(cell_key(session, 0)).bind(session).fetch(&mut *connection);
    while let Some(row) = rows.try_next().await? {
        n_lines += 1;
        let Some(line) = problems.note(parse_line(&row))? else { continue };
        check_line(&line, &mut segments, primitives, problems);
        if !has_cell(&row, N_LINE_COLUMNS, &Cell::of_ends(&line.endpoints))? {
            problems.add(format!("line {} is not where spatial queries look for it", line.id));
        }
    }
    drop(rows);

    let n_cells = query(
        "SELECT count(*) FROM line_cells
         WHERE session_min = $1 AND key BETWEEN ($1 << 40) AND (($1 << 40) | $2)",
    );
    let n_cells: i64 = n_cells.bind(session).bind(MAX_POINT_ID as i64).only(connection).await?;
    if n_cells != n_lines as i64 {
        problems.add(format!("{n_cells} places are noted for {n_lines} lines"));
    }
    Ok(n_lines)
}

fn check_line(
    line: &LineLandmark,
    segments: &mut Taken,
    primitives: &BTreeSet<PrimitiveId>,
    problems: &mut Findings,
) {
    let id = line.id;
    if !line.is_finite() {
        problems.add(format!("line {id} has a number that is not finite"));
    }
    let is_off = |end| line.line.distance(end) > MAX_END_ERROR * (1.0 + end.norm());
    if line.endpoints.iter().any(is_off) {
        problems.add(format!("an end of line {id} is not on it"));
    }
    if line.observations.len() < 2 {
        problems.add(format!("line {id} is seen by {} keyframes", line.observations.len()));
    }
    for seen in &line.observations {
        segments.take(&id, seen.keyframe, seen.feature_idx, problems);
    }
    if let Some(primitive) = line.primitive.filter(|primitive| !primitives.contains(primitive)) {
        problems.add(format!("line {id} belongs to primitive {primitive}, which is not there"));
    }
}
