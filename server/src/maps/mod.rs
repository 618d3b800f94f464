//! What can be asked of a session's map, once for both interfaces: what they decode into and encode from.
//!
//! Every answer comes from the database, as of a session's last commit, whether the session is in memory or
//! not. Lengths of questions and answers are what the session's scale says: map units, or metres once
//! somebody has said how long a unit is. A page is for a person or a viewer; [`Batches`] are the whole answer
//! in pieces, read as fast as the caller takes them, with nothing held in between but, for a question about a
//! place, the numbers of the candidates.

mod export;
mod graph;
mod keyframes;
mod lines;
pub mod masks;
mod observed;
mod pictures;
mod place;
mod points;
mod primitives;
mod scene;
mod shades;
mod trajectory;

pub use export::{ColmapPart, MapFile, MapFormat};
pub use graph::{Edge, Graph, GraphKind, GraphQuery, Node};
pub use keyframes::Keyframe;
pub use lines::{Line, LineQuery};
pub use observed::{Observed, VanishingPoint};
pub use pictures::Picture;
pub use place::{BoundingBox, Place};
pub use points::{Point, PointQuery};
pub use primitives::{Primitive, PrimitiveDetail};
pub use scene::{ScenePart, SceneParts};
pub use store::{StoredImage, SubmapChoice, TrajectoryKind, TrajectoryPose};
pub use trajectory::TrajectoryQuery;

use crate::error::ApiError;
use crate::model::{Scale, Units};
use crate::session::SessionId;
use futures_util::stream::{self, BoxStream, StreamExt};
use pictures::Pictures;
use shades::Shades;
use std::path::PathBuf;
use std::sync::Arc;
use store::{Page, Store, StoreError};
use vision::decode::DecodeLimits;

/// Rows of a batch at most: some ten thousand bytes of an answer.
const ROWS_PER_BATCH: usize = 512;

/// A whole answer, piece by piece. Dropping it ends the reading.
pub type Batches<T> = BoxStream<'static, Result<Vec<T>, ApiError>>;

/// Something with lengths.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaled<T> {
    /// What a length of 1 means.
    pub scale: Scale,
    /// What has the lengths.
    pub value: T,
}

/// Answers questions about maps.
#[derive(Clone)]
pub struct MapQueries {
    store: Store,
    /// Where files that are being exported have their place on the disk.
    export_dir: PathBuf,
    /// What images may be to be shown.
    decode_limits: DecodeLimits,
    shades: Arc<Shades>,
    pictures: Arc<Pictures>,
}

impl MapQueries {
    /// Answers from a database; files are prepared in `export_dir`, and stored images decoded within limits.
    pub fn new(store: Store, export_dir: PathBuf, decode_limits: DecodeLimits) -> Self {
        let (shades, pictures) = (Arc::new(Shades::new(decode_limits)), Arc::default());
        Self { store, export_dir, decode_limits, shades, pictures }
    }

    /// What lengths of a session mean.
    async fn units(&self, id: &SessionId) -> Result<Units, ApiError> {
        Ok(Units::new(self.store.metres_per_unit(id.as_str()).await?))
    }
}

impl<T> Scaled<T> {
    fn new(units: Units, value: T) -> Self {
        Self { scale: units.scale(), value }
    }
}

/// Stored rows, each as callers see it.
fn batches<R: Send + 'static, T: Send + 'static>(
    rows: BoxStream<'static, Result<R, StoreError>>,
    view: impl Fn(R) -> T + Send + 'static,
) -> Batches<T> {
    let rows = rows.map(move |row| row.map(&view).map_err(ApiError::from));
    rows.chunks(ROWS_PER_BATCH).map(|rows| rows.into_iter().collect()).boxed()
}

/// The rows of every page, each as callers see it; `read` reads the page after a row.
fn batches_of_pages<R, K, T, Reading>(
    read: impl Fn(Option<K>) -> Reading + Send + 'static,
    view: impl Fn(R) -> T + Copy + Send + 'static,
) -> Batches<T>
where
    R: Send + 'static,
    K: Send + 'static,
    T: Send + 'static,
    Reading: Future<Output = Result<Page<R, K>, StoreError>> + Send + 'static,
{
    // The outer `None` is the end, the inner one the beginning.
    let pages = stream::try_unfold((read, Some(None)), move |(read, after)| async move {
        let Some(after) = after else { return Ok::<_, ApiError>(None) };
        let page = read(after).await?;
        let rows: Vec<T> = page.items.into_iter().map(view).collect();
        Ok(Some((rows, (read, page.next.map(Some)))))
    });
    pages.boxed()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[tokio::test]
    async fn rows_are_read_when_they_are_taken() {
        let n_read = Arc::new(AtomicUsize::new(0));
        let counter = n_read.clone();
        let rows = stream::iter(0..100_000).map(move |row| {
            counter.fetch_add(1, Ordering::SeqCst);
            Ok::<usize, StoreError>(row)
        });
        let mut taken = batches(rows.boxed(), |row| row);
        assert_eq!(n_read.load(Ordering::SeqCst), 0);
        for n_batches in 1..4 {
            let batch = taken.next().await.unwrap().unwrap();
            assert_eq!(batch.last(), Some(&(n_batches * ROWS_PER_BATCH - 1)));
            assert_eq!(n_read.load(Ordering::SeqCst), n_batches * ROWS_PER_BATCH);
        }
    }

    #[tokio::test]
    async fn a_failure_takes_its_batch_with_it() {
        let rows = stream::iter([Ok(1), Err(StoreError::Corrupt("row 2".into()))]);
        let taken: Vec<Result<Vec<i32>, ApiError>> = batches(rows.boxed(), |row| row).collect().await;
        assert!(matches!(&taken[..], [Err(error)] if error.message.contains("row 2")), "{taken:?}");
    }

    #[tokio::test]
    async fn pages_are_read_to_the_last() {
        let read = |after: Option<u32>| async move {
            let first = after.map_or(0, |after| after + 1);
            let next = (first < 4).then_some(first + 1);
            Ok(Page { items: vec![first, first + 1], next })
        };
        let taken: Vec<_> = batches_of_pages(read, |row| row * 10).collect().await;
        let rows: Vec<u32> = taken.into_iter().flat_map(|batch| batch.unwrap()).collect();
        assert_eq!(rows, [0, 10, 20, 30, 40, 50]);
    }
}
