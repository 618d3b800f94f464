//! What is done to stored maps as a whole: adjusting one, and joining two. Nobody may have the sessions in
//! memory meanwhile; results are saved in one transaction.

use super::events::Events;
use super::load::{self, LoadContext, StoredSession};
use crate::error::{ApiError, ErrorCode};
use futures_util::TryStreamExt;
use slam::map::MapError;
use slam::{Cores, Merged, PlacedFrame, Recordings, Work};
use std::sync::Arc;
use store::{FrameEntry, SessionStatus};

/// What adjusting a map came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adjusted {
    /// Cost of all sightings of points and lines before.
    pub cost_before: f64,
    /// And afterwards.
    pub cost_after: f64,
    /// Keyframes of the map.
    pub n_keyframes: usize,
    /// Points of the map.
    pub n_points: usize,
    /// Lines of the map.
    pub n_lines: usize,
}

/// What joining two maps came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Joined {
    /// The places by which they were joined; none if nothing was found, and nothing changed.
    pub places: Vec<slam::Joined>,
    /// Keyframes that were taken in.
    pub n_keyframes: usize,
    /// Frames that were taken in.
    pub n_frames: usize,
    /// What was added to the numbers of those frames.
    pub sequence_shift: i64,
    /// What was added to their times, nanoseconds.
    pub timestamp_shift_ns: i64,
    /// Loops closed inside of the joined map.
    pub n_loops: usize,
    /// Cost before the adjustment that followed, and after.
    pub costs: (f64, f64),
}

impl Adjusted {
    /// In a plain sentence.
    pub fn sentence(&self) -> String {
        let Self { cost_before, cost_after, n_keyframes, n_points, n_lines } = self;
        format!(
            "{n_keyframes} keyframes, {n_points} points and {n_lines} lines were adjusted: cost {cost_before:.1} before, \
             {cost_after:.1} now"
        )
    }
}

impl Joined {
    /// In a plain sentence.
    pub fn sentence(&self) -> String {
        if self.places.is_empty() {
            return "no place was found that both maps show; nothing was changed".to_owned();
        }
        let Self { places, n_keyframes, n_frames, n_loops, .. } = self;
        format!(
            "joined by {} places: {n_keyframes} keyframes and {n_frames} frames were taken in, {n_loops} loops closed",
            places.len()
        )
    }
}

/// Adjusts a map. `None` if the work was cancelled.
///
/// # Errors
/// If the session cannot be read, its map is damaged, or the result cannot be saved.
pub async fn adjust(
    context: &LoadContext<'_>,
    events: Events,
    (work, cores): (Arc<Work>, &Cores),
) -> Result<Option<Adjusted>, ApiError> {
    let stored = load::read(context).await?;
    let status = SessionStatus { state: stored.record.state };
    let watched = work.clone();
    let (config, map) = (stored.config, stored.state.map);
    let optimized = on_a_thread(cores, move || slam::optimize(&config, map, &watched)).await?;
    let Some(optimized) = optimized.filter(|_| !work.is_cancelled()) else { return Ok(None) };
    let update = &optimized.update;
    if !update.changes.is_empty() {
        context.store.save_update(context.id.as_str(), update, status, &[]).await?;
        events.map(update);
        events.saved(update);
    }
    Ok(Some(Adjusted {
        cost_before: optimized.cost_before,
        cost_after: optimized.cost_after,
        n_keyframes: update.map.n_keyframes(),
        n_points: update.map.n_points(),
        n_lines: update.map.n_lines(),
    }))
}

/// Takes one session's map and trajectory into another's where both show the same place. `None` if the work
/// was cancelled.
///
/// # Errors
/// If the sessions' cameras differ, one cannot be read or is damaged, or the result cannot be saved.
pub async fn join(
    into: &LoadContext<'_>,
    from: &LoadContext<'_>,
    events: Events,
    (work, cores): (Arc<Work>, &Cores),
) -> Result<Option<Joined>, ApiError> {
    let (stored, other) = (load::read(into).await?, load::read(from).await?);
    check_cameras(&stored, &other)?;
    check_clocks(&stored, &other)?;
    let status = SessionStatus { state: stored.record.state };
    let frames: Vec<FrameEntry> = from.store.frames(from.id.as_str()).await?.try_collect().await?;
    let last_frame = stored.last_frame();
    let watched = work.clone();
    let merged = on_a_thread(cores, move || {
        let frames = placed(frames, &other.state.map);
        let recordings = Recordings { last_frame, from: frames };
        slam::merge(&stored.config, (stored.state.map, other.state.map), recordings, &watched)
    });
    let merged = merged.await?;
    if work.is_cancelled() {
        return Ok(None);
    }
    let Some(merged) = merged else { return Ok(Some(Joined::default())) };
    into.store
        .save_merged(into.id.as_str(), &merged.update, status, (from.id.as_str(), &merged.keyframes))
        .await?;
    events.map(&merged.update);
    events.saved(&merged.update);
    Ok(Some(told(&merged)))
}

fn told(merged: &Merged) -> Joined {
    Joined {
        places: merged.joins.clone(),
        n_keyframes: merged.keyframes.len(),
        n_frames: merged.update.frames.len(),
        sequence_shift: i64::try_from(merged.sequence_shift).unwrap_or(i64::MAX),
        timestamp_shift_ns: merged.timestamp_shift_ns,
        n_loops: merged.n_loops,
        costs: merged.costs,
    }
}

/// Frames by the keyframes in the map that they move with.
fn placed(frames: Vec<FrameEntry>, map: &slam::map::MapParts) -> Vec<PlacedFrame> {
    let submaps: std::collections::BTreeMap<_, _> =
        map.keyframes.iter().map(|keyframe| (keyframe.id, keyframe.submap)).collect();
    let place = |frame: FrameEntry| PlacedFrame {
        sequence: frame.sequence,
        timestamp_ns: frame.timestamp_ns,
        state: frame.state,
        backfilled: frame.backfilled,
        reason: frame.reason,
        place: frame.place.and_then(|place| {
            let anchor = *place.way.last()?;
            submaps.contains_key(&anchor).then(|| (anchor, place.world_from_camera.inverse()))
        }),
    };
    frames.into_iter().map(place).collect()
}

/// Features are in pixels of their camera, so that two maps can only become one of the same camera.
fn check_cameras(into: &StoredSession, from: &StoredSession) -> Result<(), ApiError> {
    let (one, other) = (into.config.working_camera(&into.camera), from.config.working_camera(&from.camera));
    let is_same = into.camera.parameters() == from.camera.parameters()
        && (one.width(), one.height()) == (other.width(), other.height())
        && into.config.pyramid() == from.config.pyramid();
    if is_same {
        return Ok(());
    }
    let sentence = "the sessions are of different cameras or extractor settings; only maps of the same camera can be joined";
    Err(ApiError::new(ErrorCode::CannotMerge, sentence))
}

/// Frames are shifted in time as a whole, which a clock that was set back does not allow.
fn check_clocks(into: &StoredSession, from: &StoredSession) -> Result<(), ApiError> {
    if into.ahead_ns == 0 && from.ahead_ns == 0 {
        return Ok(());
    }
    let sentence = "one of the sessions has segments of clocks that differ; such maps cannot be joined";
    Err(ApiError::new(ErrorCode::CannotMerge, sentence))
}

async fn on_a_thread<T: Send + 'static>(
    cores: &Cores,
    work: impl FnOnce() -> Result<T, MapError> + Send + 'static,
) -> Result<T, ApiError> {
    let cores = cores.clone();
    let work = move || {
        let _joined = cores.join();
        work()
    };
    let done = tokio::task::spawn_blocking(work).await.map_err(ApiError::internal)?;
    done.map_err(|error| {
        tracing::error!(error = %error, "a stored map cannot be worked on: {error}");
        ApiError::new(ErrorCode::DataLoss, format!("the stored map cannot be worked on: {error}"))
    })
}
