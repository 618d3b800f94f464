//! Checks of points, their observations and their cells.

use super::{KeypointCounts, Problems};
use crate::StoreError;
use crate::points::cell::{Cell, cell_key};
use crate::points::{POINT_COLUMNS, parse_point};
use futures_util::TryStreamExt;
use slam::map::{KeyframeId, PointLandmark};
use sqlx::sqlite::SqliteRow;
use sqlx::{AssertSqlSafe, Row, SqliteConnection};
use std::collections::BTreeMap;

/// Which keypoints are taken, by key frame.
struct Keypoints(BTreeMap<KeyframeId, Vec<bool>>);

impl Keypoints {
    /// Takes a keypoint; says what is wrong if that is not possible.
    fn take(&mut self, keyframe: KeyframeId, feature_idx: u32) -> Result<(), &'static str> {
        let keypoints = self.0.get_mut(&keyframe).ok_or("a key frame that is not there")?;
        let taken =
            keypoints.get_mut(feature_idx as usize).ok_or("a keypoint its key frame does not have")?;
        if std::mem::replace(taken, true) { Err("a keypoint that another point is seen by") } else { Ok(()) }
    }
}

/// Checks points with their observations and cells; how many points there are.
pub(super) async fn check_points(
    connection: &mut SqliteConnection,
    session: i64,
    keypoint_counts: &KeypointCounts,
    problems: &mut Problems,
) -> Result<u64, StoreError> {
    let mut keypoints =
        Keypoints(keypoint_counts.iter().map(|(id, n_keypoints)| (*id, vec![false; *n_keypoints])).collect());
    let mut n_points = 0;
    let sql = format!(
        "SELECT {POINT_COLUMNS}, x_min, x_max, y_min, y_max, z_min, z_max
         FROM points LEFT JOIN point_cells ON key = ? | id WHERE session = ? ORDER BY id"
    );
    let mut rows =
        sqlx::query(AssertSqlSafe(sql)).bind(cell_key(session, 0)).bind(session).fetch(&mut *connection);
    while let Some(row) = rows.try_next().await? {
        n_points += 1;
        let Some(point) = problems.note(parse_point(&row))? else { continue };
        check_point(&point, &mut keypoints, problems);
        if !has_its_cell(&row, &point)? {
            problems.add(format!("point {} is not where spatial queries look for it", point.id));
        }
    }
    drop(rows);

    let n_cells: i64 =
        sqlx::query_scalar("SELECT count(*) FROM point_cells WHERE session_min >= ?1 AND session_max <= ?1")
            .bind(session)
            .fetch_one(connection)
            .await?;
    if n_cells != n_points as i64 {
        problems.add(format!("{n_cells} places are noted for {n_points} points"));
    }
    Ok(n_points)
}

fn check_point(point: &PointLandmark, keypoints: &mut Keypoints, problems: &mut Problems) {
    let id = point.id;
    let numbers = point.position.iter().chain(&point.mean_view_direction).chain([&point.distance_range.0]);
    if !numbers.into_iter().all(|value| value.is_finite()) {
        problems.add(format!("point {id} has a number that is not finite"));
    }
    if point.observations.len() < 2 {
        problems.add(format!("point {id} is seen by {} key frames", point.observations.len()));
    }
    for seen in &point.observations {
        if let Err(what) = keypoints.take(seen.keyframe, seen.feature_idx) {
            problems.add(format!("point {id} is seen by {what}: {} of {}", seen.feature_idx, seen.keyframe));
        }
    }
}

/// Whether the tree's entry, in columns 16 to 21, is the cell of the point but for rounding outwards.
fn has_its_cell(row: &SqliteRow, point: &PointLandmark) -> Result<bool, StoreError> {
    let cell = Cell::of(&point.position, point.distance_range.1);
    for axis in 0..3 {
        let low: Option<f64> = row.try_get(16 + 2 * axis)?;
        let high: Option<f64> = row.try_get(17 + 2 * axis)?;
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
