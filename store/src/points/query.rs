//! Which points are where: pages and streams, found through the R*Tree.

use super::cell::{MAX_POINT_ID, cell_key, point_of_key};
use super::{Form, PLACED, PlacedPoint, WHOLE};
use crate::cameras::map_number;
use crate::engine::{Connection, Query, Row, query};
use crate::{Page, Store, StoreError};
use futures_util::stream::{self, BoxStream, StreamExt, TryStreamExt};
use nalgebra::Vector3;
use slam::map::{PointId, PointLandmark, SubmapId};
use std::collections::BTreeSet;

/// A box with sides along the axes, its faces included; map units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least coordinates.
    pub min: Vector3<f64>,
    /// Greatest coordinates.
    pub max: Vector3<f64>,
}

/// Which points are wanted; every condition given must hold. Bounds that are not finite numbers hold for
/// none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PointQuery {
    /// Points in this box.
    pub bounds: Option<Bounds>,
    /// Points at most this far from this place, map units.
    pub near: Option<(Vector3<f64>, f64)>,
    /// Points seen by at least so many keyframes.
    pub min_observations: u32,
    /// Points in this submap's frame of reference.
    pub submap: Option<SubmapId>,
}

/// Points read at a time by a stream: a statement takes about a millisecond.
const POINTS_PER_STEP: usize = 512;

/// Lengths beyond this are taken for it: PostgreSQL refuses to square what has no square.
const MAX_COORDINATE: f64 = 1e150;

const AXES: [&str; 3] = ["x", "y", "z"];

impl PointQuery {
    /// The smallest box all wanted points are in; `None` if they can be anywhere.
    fn region(&self) -> Option<Bounds> {
        region(self.bounds, self.near)
    }

    /// Adds the conditions on a point's row.
    fn push_conditions(&self, sql: &mut Query) {
        if self.min_observations > 0 {
            sql.push(" AND n_observations >= ").push_bind(self.min_observations);
        }
        if let Some(submap) = self.submap {
            sql.push(" AND submap = ").push_bind(submap.0);
        }
        if let Some(Bounds { min, max }) = self.bounds {
            for (axis, (low, high)) in AXES.into_iter().zip(min.iter().zip(&max)) {
                sql.push(" AND ").push(axis).push(" BETWEEN ").push_bind(*low).push(" AND ").push_bind(*high);
            }
        }
        if let Some((center, radius)) = self.near {
            let mut separator = " AND (";
            let radius = radius.min(MAX_COORDINATE);
            for (axis, place) in AXES.into_iter().zip(center.iter()) {
                let place = &place.clamp(-MAX_COORDINATE, MAX_COORDINATE);
                sql.push(separator).push("(").push(axis).push(" - ").push_bind(*place);
                sql.push(") * (").push(axis).push(" - ").push_bind(*place).push(")");
                separator = " + ";
            }
            sql.push(") <= ").push_bind(radius * radius).push(" AND ").push_bind(radius).push(" >= 0");
        }
    }
}

/// The smallest box that holds what is in a box and near a place; `None` for neither.
pub(crate) fn region(bounds: Option<Bounds>, near: Option<(Vector3<f64>, f64)>) -> Option<Bounds> {
    let ball = near.map(|(center, radius)| Bounds {
        min: center - Vector3::repeat(radius),
        max: center + Vector3::repeat(radius),
    });
    match (bounds, ball) {
        (Some(a), Some(b)) => Some(Bounds { min: a.min.sup(&b.min), max: a.max.inf(&b.max) }),
        (a, b) => a.or(b),
    }
}

/// The box of a cell in PostgreSQL, as its index has it.
const CELL: &str = "cube(ARRAY[session_min, x_min, y_min, z_min], ARRAY[session_max, x_max, y_max, z_max])";

/// Adds a question to a tree of cells: the keys of a session's entries after one whose cells meet a box.
pub(crate) fn push_cell_keys(
    sql: &mut Query,
    connection: &Connection,
    tree: &'static str,
    session: i64,
    after: i64,
    region: &Bounds,
) {
    sql.push("SELECT key FROM ").push(tree).push(" WHERE ");
    match connection {
        Connection::Sqlite(_) => {
            sql.push("session_min >= ").push_bind(session).push(" AND session_max <= ").push_bind(session);
            for (axis, (low, high)) in AXES.into_iter().zip(region.min.iter().zip(&region.max)) {
                sql.push(" AND ").push(axis).push("_max >= ").push_bind(*low);
                sql.push(" AND ").push(axis).push("_min <= ").push_bind(*high);
            }
        }
        Connection::Postgres(..) => {
            let corner = |of: &Vector3<f64>| vec![session as f64, of.x, of.y, of.z];
            // What is asked for with a box and a place that do not meet may be long enough to meet both. A
            // cube takes its corners in any order, which finds those and more; all are looked at exactly.
            if region.min.iter().chain(&region.max).all(|value| !value.is_nan()) {
                sql.push(CELL).push(" && cube(").push_bind(corner(&region.min)).push(", ");
                sql.push_bind(corner(&region.max)).push(")");
            } else {
                sql.push("FALSE");
            }
        }
    }
    sql.push(" AND key > ").push_bind(cell_key(session, after));
}

impl Store {
    /// Up to `page_size` of the wanted points with ids above the given one.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn points_page(
        &self,
        session: &str,
        query: &PointQuery,
        after: Option<PointId>,
        page_size: u32,
    ) -> Result<Page<PointLandmark, PointId>, StoreError> {
        self.page_of(&WHOLE, session, query, after, page_size).await
    }

    /// As [`Self::points_page`], where they are alone.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn placed_points_page(
        &self,
        session: &str,
        query: &PointQuery,
        after: Option<PointId>,
        page_size: u32,
    ) -> Result<Page<PlacedPoint, PointId>, StoreError> {
        self.page_of(&PLACED, session, query, after, page_size).await
    }

    async fn page_of<T>(
        &self,
        form: &'static Form<T>,
        session: &str,
        query: &PointQuery,
        after: Option<PointId>,
        page_size: u32,
    ) -> Result<Page<T, PointId>, StoreError> {
        let mut reader = self.reader().await?;
        let number = map_number(&mut reader, session).await?;
        let after = after.map_or(0, |id| id.get().min(MAX_POINT_ID) as i64);
        let points = select_points(&mut reader, form, number, query, after, page_size as usize + 1).await?;
        Ok(Page::of(points, page_size, form.id))
    }

    /// Those of the given points that there are, in the order of their ids. Reads as the stream goes on.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], before the stream begins.
    pub async fn points_of(
        &self,
        session: &str,
        ids: &BTreeSet<PointId>,
    ) -> Result<BoxStream<'static, Result<PointLandmark, StoreError>>, StoreError> {
        let number = map_number(&mut self.reader().await?, session).await?;
        let ids: Vec<i64> = ids.iter().map(|id| id.get().min(MAX_POINT_ID) as i64).collect();
        Ok(Cursor::of(self.clone(), &WHOLE, number, PointQuery::default(), Some(ids.into_iter())).stream())
    }

    /// Every wanted point in the order of their ids.
    ///
    /// Reads as the stream goes on and holds nothing in between but, for a query with a place, the ids of the
    /// candidates. Each point is from the last commit when it is read.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], before the stream begins.
    pub async fn points(
        &self,
        session: &str,
        query: PointQuery,
    ) -> Result<BoxStream<'static, Result<PointLandmark, StoreError>>, StoreError> {
        self.stream_of(&WHOLE, session, query).await
    }

    /// As [`Self::points`], where they are alone.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], before the stream begins.
    pub async fn placed_points(
        &self,
        session: &str,
        query: PointQuery,
    ) -> Result<BoxStream<'static, Result<PlacedPoint, StoreError>>, StoreError> {
        self.stream_of(&PLACED, session, query).await
    }

    async fn stream_of<T: Send + 'static>(
        &self,
        form: &'static Form<T>,
        session: &str,
        query: PointQuery,
    ) -> Result<BoxStream<'static, Result<T, StoreError>>, StoreError> {
        let mut reader = self.reader().await?;
        let number = map_number(&mut reader, session).await?;
        let candidates = match query.region() {
            Some(region) => Some(select_candidates(&mut reader, number, &region).await?.into_iter()),
            None => None,
        };
        drop(reader);
        Ok(Cursor::of(self.clone(), form, number, query, candidates).stream())
    }
}

/// How far a stream of points has been read.
struct Cursor<T: 'static> {
    store: Store,
    form: &'static Form<T>,
    session: i64,
    query: PointQuery,
    /// Last id read, where there are no candidates.
    after: i64,
    /// Ids not yet looked at; `None` if every point is a candidate.
    candidates: Option<std::vec::IntoIter<i64>>,
}

impl<T: Send + 'static> Cursor<T> {
    /// Before the first point.
    fn of(
        store: Store,
        form: &'static Form<T>,
        session: i64,
        query: PointQuery,
        candidates: Option<std::vec::IntoIter<i64>>,
    ) -> Self {
        Self { store, form, session, query, after: 0, candidates }
    }

    fn stream(self) -> BoxStream<'static, Result<T, StoreError>> {
        let steps = stream::try_unfold(self, |mut cursor| async move {
            let step = cursor.step().await?;
            Ok::<_, StoreError>(step.map(|points| (stream::iter(points).map(Ok::<_, StoreError>), cursor)))
        });
        steps.try_flatten().boxed()
    }

    /// The next points, possibly none of those looked at; `None` at the end.
    async fn step(&mut self) -> Result<Option<Vec<T>>, StoreError> {
        let mut reader = self.store.reader().await?;
        match &mut self.candidates {
            Some(candidates) => {
                let ids: Vec<i64> = candidates.by_ref().take(POINTS_PER_STEP).collect();
                if ids.is_empty() {
                    return Ok(None);
                }
                select_points_of(&mut reader, self.form, self.session, &self.query, &ids).await.map(Some)
            }
            None => {
                let query = self.query;
                let points =
                    select_points(&mut reader, self.form, self.session, &query, self.after, POINTS_PER_STEP)
                        .await?;
                let Some(last) = points.last() else { return Ok(None) };
                self.after = (self.form.id)(last).get() as i64;
                Ok(Some(points))
            }
        }
    }
}

fn select_from_points(columns: &str, session: i64) -> Query {
    let mut sql = query("SELECT ");
    sql.push(columns).push(" FROM points WHERE session = ").push_bind(session);
    sql
}

pub(crate) async fn select_points<T>(
    connection: &mut Connection,
    form: &Form<T>,
    session: i64,
    wanted: &PointQuery,
    after: i64,
    limit: usize,
) -> Result<Vec<T>, StoreError> {
    let mut sql = select_from_points(form.columns, session);
    sql.push(" AND id > ").push_bind(after);
    if let Some(region) = wanted.region() {
        sql.push(" AND id IN (SELECT key & ").push_bind(MAX_POINT_ID as i64).push(" FROM (");
        push_cell_keys(&mut sql, connection, "point_cells", session, after, &region);
        sql.push(") candidates)");
    }
    wanted.push_conditions(&mut sql);
    sql.push(" ORDER BY id LIMIT ").push_bind(limit as i64);
    parse_points(form, &sql.fetch_all(connection).await?)
}

async fn select_points_of<T>(
    connection: &mut Connection,
    form: &Form<T>,
    session: i64,
    wanted: &PointQuery,
    ids: &[i64],
) -> Result<Vec<T>, StoreError> {
    let mut sql = select_from_points(form.columns, session);
    sql.push(" AND id IN IDS(").push_bind(ids.to_vec()).push(")");
    wanted.push_conditions(&mut sql);
    sql.push(" ORDER BY id");
    parse_points(form, &sql.fetch_all(connection).await?)
}

/// Ids, in order, of the points whose cells meet a box.
async fn select_candidates(
    connection: &mut Connection,
    session: i64,
    region: &Bounds,
) -> Result<Vec<i64>, StoreError> {
    let mut sql = query("");
    push_cell_keys(&mut sql, connection, "point_cells", session, 0, region);
    let keys: Vec<i64> = sql.scalars(connection).await?;
    let mut ids: Vec<i64> = keys.into_iter().map(point_of_key).collect();
    ids.sort_unstable();
    Ok(ids)
}

fn parse_points<T>(form: &Form<T>, rows: &[Row]) -> Result<Vec<T>, StoreError> {
    rows.iter().map(form.parse).collect()
}
