//! Which lines are where: pages and streams, found through the R*Tree and then looked at exactly.

use super::geometry::{meets_ball, meets_box};
use super::{LINE_COLUMNS, parse_line};
use crate::cameras::map_number;
use crate::engine::{Connection, query};
use crate::points::cell::{MAX_POINT_ID, point_of_key};
use crate::points::{push_cell_keys, region};
use crate::{Bounds, Page, Store, StoreError};
use futures_util::stream::{self, BoxStream, StreamExt, TryStreamExt};
use nalgebra::Vector3;
use slam::map::{LineId, LineLandmark, PrimitiveId, SubmapId};
use std::collections::BTreeSet;

/// Which lines are wanted; every condition given must hold for the part of the line that was seen. Bounds
/// that are not finite numbers hold for none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineQuery {
    /// Lines some part of which is in this box.
    pub bounds: Option<Bounds>,
    /// Lines some part of which is at most this far from this place, map units.
    pub near: Option<(Vector3<f64>, f64)>,
    /// Lines seen by at least so many keyframes.
    pub min_observations: u32,
    /// Lines in this submap's frame of reference.
    pub submap: Option<SubmapId>,
    /// Lines with this primitive's direction.
    pub primitive: Option<PrimitiveId>,
}

/// Lines read at a time: a statement takes about a millisecond.
const LINES_PER_STEP: usize = 512;

impl LineQuery {
    /// The conditions that the row and the tree do not answer.
    fn holds_for(&self, line: &LineLandmark) -> bool {
        self.bounds.is_none_or(|bounds| meets_box(&line.endpoints, &bounds))
            && self.near.is_none_or(|(center, radius)| meets_ball(&line.endpoints, &center, radius))
    }
}

impl Store {
    /// Up to `page_size` of the wanted lines with ids above the given one.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn lines_page(
        &self,
        session: &str,
        query: &LineQuery,
        after: Option<LineId>,
        page_size: u32,
    ) -> Result<Page<LineLandmark, LineId>, StoreError> {
        let mut reader = self.reader().await?;
        let number = map_number(&mut reader, session).await?;
        let after = after.map_or(0, |id| id.get().min(MAX_POINT_ID) as i64);
        let mut cursor = LineCursor::new(&mut reader, number, *query, after).await?;
        let mut lines = Vec::new();
        while lines.len() <= page_size as usize
            && let Some(step) = cursor.step(&mut reader).await?
        {
            lines.extend(step);
        }
        Ok(Page::of(lines, page_size, |last| last.id))
    }

    /// Every wanted line in the order of their ids.
    ///
    /// Reads as the stream goes on and holds nothing in between but, for a query with a place, the ids of the
    /// candidates. Each line is from the last commit when it is read.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], before the stream begins.
    pub async fn lines(
        &self,
        session: &str,
        query: LineQuery,
    ) -> Result<BoxStream<'static, Result<LineLandmark, StoreError>>, StoreError> {
        let mut reader = self.reader().await?;
        let number = map_number(&mut reader, session).await?;
        let cursor = LineCursor::new(&mut reader, number, query, 0).await?;
        Ok(cursor.stream(self.clone()))
    }

    /// Those of the given lines that there are, in the order of their ids. Reads as the stream goes on.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], before the stream begins.
    pub async fn lines_of(
        &self,
        session: &str,
        ids: &BTreeSet<LineId>,
    ) -> Result<BoxStream<'static, Result<LineLandmark, StoreError>>, StoreError> {
        let session = map_number(&mut self.reader().await?, session).await?;
        let ids: Vec<i64> = ids.iter().map(|id| id.get().min(MAX_POINT_ID) as i64).collect();
        let (query, candidates) = (LineQuery::default(), Some(ids.into_iter()));
        Ok(LineCursor { session, query, after: 0, candidates }.stream(self.clone()))
    }
}

/// How far the lines of a session have been read.
pub(crate) struct LineCursor {
    session: i64,
    query: LineQuery,
    /// Last id read, where there are no candidates.
    after: i64,
    /// Ids not yet looked at; `None` if every line is a candidate.
    candidates: Option<std::vec::IntoIter<i64>>,
}

impl LineCursor {
    /// Before the first line with an id above `after`.
    pub async fn new(
        connection: &mut Connection,
        session: i64,
        query: LineQuery,
        after: i64,
    ) -> Result<Self, StoreError> {
        let candidates = match region(query.bounds, query.near) {
            Some(region) => Some(select_candidates(connection, session, after, &region).await?.into_iter()),
            None => None,
        };
        Ok(Self { session, query, after, candidates })
    }

    /// The rest of the lines; no reader is held between steps.
    fn stream(self, store: Store) -> BoxStream<'static, Result<LineLandmark, StoreError>> {
        let steps = stream::try_unfold((store, self), |(store, mut cursor)| async move {
            let step = cursor.step(&mut store.reader().await?).await?;
            let items = step.map(|lines| stream::iter(lines).map(Ok::<_, StoreError>));
            Ok::<_, StoreError>(items.map(|items| (items, (store, cursor))))
        });
        steps.try_flatten().boxed()
    }

    /// The next lines, possibly none of those looked at; `None` at the end.
    pub async fn step(
        &mut self,
        connection: &mut Connection,
    ) -> Result<Option<Vec<LineLandmark>>, StoreError> {
        let mut sql = query("SELECT ");
        sql.push(LINE_COLUMNS).push(" FROM lines WHERE session = ").push_bind(self.session);
        if let Some(candidates) = &mut self.candidates {
            let ids: Vec<i64> = candidates.by_ref().take(LINES_PER_STEP).collect();
            if ids.is_empty() {
                return Ok(None);
            }
            sql.push(" AND id IN IDS(").push_bind(ids).push(")");
        } else {
            sql.push(" AND id > ").push_bind(self.after);
        }
        if self.query.min_observations > 0 {
            sql.push(" AND n_observations >= ").push_bind(self.query.min_observations);
        }
        if let Some(submap) = self.query.submap {
            sql.push(" AND submap = ").push_bind(submap.0);
        }
        if let Some(primitive) = self.query.primitive {
            sql.push(" AND primitive = ").push_bind(primitive.get() as i64);
        }
        sql.push(" ORDER BY id LIMIT ").push_bind(LINES_PER_STEP as i64);
        let rows = sql.fetch_all(connection).await?;
        let mut lines = rows.iter().map(parse_line).collect::<Result<Vec<_>, _>>()?;
        if self.candidates.is_none() {
            let Some(last) = lines.last() else { return Ok(None) };
            self.after = last.id.get() as i64;
        }
        lines.retain(|line| self.query.holds_for(line));
        Ok(Some(lines))
    }
}

/// Ids above one, in order, of the lines whose boxes meet a box.
async fn select_candidates(
    connection: &mut Connection,
    session: i64,
    after: i64,
    region: &Bounds,
) -> Result<Vec<i64>, StoreError> {
    let mut sql = query("");
    push_cell_keys(&mut sql, connection, "line_cells", session, after, region);
    let keys: Vec<i64> = sql.scalars(connection).await?;
    let mut ids: Vec<i64> = keys.into_iter().map(point_of_key).collect();
    ids.sort_unstable();
    Ok(ids)
}
