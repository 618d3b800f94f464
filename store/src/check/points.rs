//! Checks of points, their observations and their cells.

use super::taken::Taken;
use super::{Findings, Measured};
use crate::StoreError;
use crate::engine::{Connection, Row, query};
use crate::points::cell::{Cell, MAX_POINT_ID, cell_key};
use crate::points::{POINT_COLUMNS, parse_point};
use futures_util::TryStreamExt;
use slam::map::PointLandmark;

/// Checks points with their observations and cells; how many points there are.
pub(super) async fn check_points(
    connection: &mut Connection,
    session: i64,
    measured: &Measured,
    problems: &mut Findings,
) -> Result<u64, StoreError> {
    let mut keypoints = Taken::new(["point", "keypoint"], measured, |[n_keypoints, ..]| n_keypoints);
    let mut n_points = 0;
    let sql = format!(
        "SELECT {POINT_COLUMNS}, x_min, x_max, y_min, y_max, z_min, z_max
         FROM points LEFT JOIN point_cells ON key = $1 | id WHERE session = $2 ORDER BY id"
    );
    let mut rows = query(sql).bind(cell_key(session, 0)).bind(session).fetch(&mut *connection);
    while let Some(row) = rows.try_next().await? {
        n_points += 1;
        let Some(point) = problems.note(parse_point(&row))? else { continue };
        check_point(&point, &mut keypoints, problems);
        if !has_cell(&row, 16, &Cell::of(&point.position, point.distance_range.1))? {
            problems.add(format!("point {} is not where spatial queries look for it", point.id));
        }
    }
    drop(rows);

    let n_cells = query(
        "SELECT count(*) FROM point_cells
         WHERE session_min = $1 AND key BETWEEN ($1 << 40) AND (($1 << 40) | $2)",
    );
    let n_cells: i64 = n_cells.bind(session).bind(MAX_POINT_ID as i64).only(connection).await?;
    if n_cells != n_points as i64 {
        problems.add(format!("{n_cells} places are noted for {n_points} points"));
    }
    Ok(n_points)
}

fn check_point(point: &PointLandmark, keypoints: &mut Taken, problems: &mut Findings) {
    let id = point.id;
    let numbers = point.position.iter().chain(&point.mean_view_direction).chain([&point.distance_range.0]);
    if !numbers.into_iter().all(|value| value.is_finite()) {
        problems.add(format!("point {id} has a number that is not finite"));
    }
    if point.observations.len() < 2 {
        problems.add(format!("point {id} is seen by {} keyframes", point.observations.len()));
    }
    for seen in &point.observations {
        keypoints.take(&id, seen.keyframe, seen.feature_idx, problems);
    }
}

/// Whether the tree's entry, in the six columns from `first` on, is the cell but for rounding outwards.
pub(super) fn has_cell(row: &Row, first: usize, cell: &Cell) -> Result<bool, StoreError> {
    for axis in 0..3 {
        let low: Option<f64> = row.try_get(first + 2 * axis)?;
        let high: Option<f64> = row.try_get(first + 1 + 2 * axis)?;
        let (Some(low), Some(high)) = (low, high) else { return Ok(false) };
        let is_near = |stored: f64, exact: f64| (stored - exact).abs() <= 1e-6 * exact.abs() + 1e-30;
        if low > cell.low[axis]
            || high < cell.high[axis]
            || !is_near(low, cell.low[axis])
            || !is_near(high, cell.high[axis])
        {
            return Ok(false);
        }
    }
    Ok(true)
}
