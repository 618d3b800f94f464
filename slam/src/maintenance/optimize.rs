//! Bundle adjustment of a whole map. [method: Global bundle adjustment]

use crate::bundle::global::{Costs, adjust_watched};
use crate::config::SlamConfig;
use crate::cores;
use crate::map::{Map, MapError, MapParts, MapUpdate, SubmapId};
use crate::work::{Stretch, Work};
use std::sync::Arc;

/// What adjusting a map came to.
#[derive(Clone, Debug)]
pub struct Optimized {
    /// What is to be stored.
    pub update: MapUpdate,
    /// Cost of all sightings of points and lines before: half the sum of their squared errors in standard
    /// deviations, each counted up to that of one that just agrees (χ² of 95 %).
    pub cost_before: f64,
    /// The same sightings' cost afterwards.
    pub cost_after: f64,
}

/// Adjusts every submap of a stored map. `None` if the work was cancelled.
///
/// # Errors
/// If the map is inconsistent.
pub fn optimize(config: &SlamConfig, map: MapParts, work: &Work) -> Result<Option<Optimized>, MapError> {
    cores::with_turn(|| optimize_in_turn(config, map, work))
}

fn optimize_in_turn(config: &SlamConfig, map: MapParts, work: &Work) -> Result<Option<Optimized>, MapError> {
    let mut map = Map::from_parts(map)?;
    let Some(costs) = adjust_submaps(&mut map, None, config, &work.whole()) else { return Ok(None) };
    map.check()?;
    let changes = map.take_changes();
    let update = MapUpdate { map: Arc::new(map), changes, frames: Vec::new() };
    Ok(Some(Optimized { update, cost_before: costs.before, cost_after: costs.after }))
}

/// Adjusts every submap, or one. A submap whose sightings agree with the result less than before stays as
/// it is. `None` if the work was cancelled.
pub(super) fn adjust_submaps(
    map: &mut Map,
    only: Option<SubmapId>,
    config: &SlamConfig,
    stretch: &Stretch<'_>,
) -> Option<Costs> {
    let wanted = |submap: &SubmapId| only.is_none_or(|only| only == *submap);
    // The time is spent on the keyframes.
    let sizes: Vec<(SubmapId, f64)> = map
        .submaps()
        .into_iter()
        .filter(wanted)
        .map(|submap| (submap, map.keyframes_of(submap).count() as f64))
        .collect();
    let n_keyframes: f64 = sizes.iter().map(|(_, n)| n).sum();
    let (mut n_done, mut costs) = (0.0, Costs::default());
    for (submap, n) in sizes {
        let part = stretch.part(n_done / n_keyframes, (n_done + n) / n_keyframes);
        let adjusted = adjust_watched(map, submap, config, &part);
        if stretch.is_cancelled() {
            return None;
        }
        n_done += n;
        let Some((result, found)) = adjusted else { continue };
        costs.before += found.before;
        costs.after += found.after.min(found.before);
        if found.after < found.before {
            result.merge_into(map);
        }
    }
    Some(costs)
}
