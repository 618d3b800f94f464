//! Joining two stored maps where they show the same place. [method: Loop detection and correction]
//!
//! The other map's submaps are taken in beside the map's own, as if the camera had been lost and had begun
//! them there; then places are recognized and submaps merged as they are while a camera runs, but for one
//! thing: nothing is known of the way between the two, so that a place must be shown beyond doubt, or twice.

use super::optimize::adjust_submaps;
use crate::config::SlamConfig;
use crate::cores;
use crate::loops::{LoopCloser, Recognition};
use crate::map::{
    CameraId, FramePose, FrameRecord, FrameState, Imported, KeyframeId, Map, MapError, MapParts, MapUpdate,
    SubmapId,
};
use crate::report::MapEvent;
use crate::work::{Stretch, Work};
use geometry::{Pose, Similarity};
use std::collections::BTreeSet;
use std::sync::Arc;

/// How far two recognitions may disagree and still speak for each other: turn in radians, logarithm of the
/// scale, and shift as a share of the scene's depth. Drift between them explains as much.
const AGREEMENT: (f64, f64, f64) = (0.1, 0.1, 0.2);
/// Shares of the work after which places have been looked for, and loops closed; adjusting takes the rest.
const SHARES: (f64, f64) = (0.3, 0.6);
/// Time between the last frame of a map and the first of one that was recorded before it.
const GAP_NS: i64 = 1_000_000_000;

/// A frame of the other map, and where its camera was.
#[derive(Clone, Debug)]
pub struct PlacedFrame {
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// How tracking ended.
    pub state: FrameState,
    /// The pose was found after the frame was answered.
    pub backfilled: bool,
    /// Why the pose is not good; empty if it is.
    pub reason: String,
    /// A keyframe in the map that it moves with, and its `camera_from_world`.
    pub place: Option<(KeyframeId, Pose)>,
}

/// One place by which two maps were joined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joined {
    /// The keyframe of the other map, by its number there.
    pub from_keyframe: KeyframeId,
    /// The keyframe that shows the same place.
    pub into_keyframe: KeyframeId,
    /// Points of the place that were found.
    pub n_matches: usize,
    /// Map units per unit of the other map.
    pub scale: f64,
}

/// What joining two maps came to.
#[derive(Clone, Debug)]
pub struct Merged {
    /// What is to be stored; everything of the other map is in it.
    pub update: MapUpdate,
    /// The other map's keyframes, by their numbers there and here.
    pub keyframes: Vec<(KeyframeId, KeyframeId)>,
    /// The places.
    pub joins: Vec<Joined>,
    /// Corrections inside of the map that followed.
    pub n_loops: usize,
    /// What was added to the numbers of the other map's frames.
    pub sequence_shift: i128,
    /// What was added to their times, nanoseconds.
    pub timestamp_shift_ns: i64,
    /// Cost of the joined submaps' sightings before the adjustment, and after.
    pub costs: (f64, f64),
}

/// The last frame of the map that takes in, and the frames of the one taken in.
pub struct Recordings {
    /// Number and time.
    pub last_frame: Option<(u64, i64)>,
    /// In the order of their numbers.
    pub from: Vec<PlacedFrame>,
}

/// Takes `from` into `into` where they show the same place. `Ok(None)` if none was found or the work was
/// cancelled.
///
/// # Errors
/// If a map is inconsistent, or numbers of frames would grow out of range.
pub fn merge(
    config: &SlamConfig,
    (into, from): (MapParts, MapParts),
    recordings: Recordings,
    work: &Work,
) -> Result<Option<Merged>, MapError> {
    cores::with_turn(|| merge_in_turn(config, (into, from), recordings, work))
}

fn merge_in_turn(
    config: &SlamConfig,
    (into, from): (MapParts, MapParts),
    recordings: Recordings,
    work: &Work,
) -> Result<Option<Merged>, MapError> {
    let stretch = work.whole();
    let mut map = Map::from_parts(into)?;
    let from = Map::from_parts(from)?;
    let own = map.submaps();
    let shifts = Shifts::of(&recordings)?;
    let frames = shifts.apply(&recordings.from, &from)?;
    let imported = map.import(from, |keyframe| shifts.keyframe(keyframe))?;
    let frames = frames.into_iter().filter_map(|frame| imported.frame(frame)).collect();

    let mut joiner = Joiner { map, own, loops: LoopCloser::new(config), config, imported };
    let Some(joins) = joiner.find(&stretch.part(0.0, SHARES.0)) else { return Ok(None) };
    if joins.is_empty() {
        return Ok(None);
    }
    let Some(n_loops) = joiner.close_loops(&stretch.part(SHARES.0, SHARES.1)) else { return Ok(None) };
    let Joiner { mut map, own, imported, .. } = joiner;
    let mut costs = (0.0, 0.0);
    let touched: BTreeSet<SubmapId> = joins
        .iter()
        .filter_map(|join| map.keyframe(join.into_keyframe))
        .map(|keyframe| keyframe.submap)
        .filter(|submap| own.contains(submap))
        .collect();
    for (idx, submap) in touched.iter().enumerate() {
        let share = |idx: usize| SHARES.1 + (1.0 - SHARES.1) * idx as f64 / touched.len() as f64;
        let part = stretch.part(share(idx), share(idx + 1));
        let Some(found) = adjust_submaps(&mut map, Some(*submap), config, &part) else { return Ok(None) };
        costs = (costs.0 + found.before, costs.1 + found.after);
    }
    map.check()?;
    let changes = map.take_changes();
    Ok(Some(Merged {
        update: MapUpdate { map: Arc::new(map), changes, frames },
        keyframes: imported.keyframes(),
        joins,
        n_loops,
        sequence_shift: shifts.sequence,
        timestamp_shift_ns: shifts.timestamp_ns,
        costs,
    }))
}

/// What is added to numbers and times, so that they go on rising.
struct Shifts {
    sequence: i128,
    timestamp_ns: i64,
}

impl Shifts {
    fn of(recordings: &Recordings) -> Result<Self, MapError> {
        let Some((first, (last_sequence, last_ns))) = recordings.from.first().zip(recordings.last_frame)
        else {
            return Ok(Self { sequence: 0, timestamp_ns: 0 });
        };
        let sequence = i128::from(last_sequence) + 1 - i128::from(first.sequence);
        let timestamp_ns = if first.timestamp_ns > last_ns {
            Some(0)
        } else {
            last_ns.checked_add(GAP_NS).and_then(|begin| begin.checked_sub(first.timestamp_ns))
        };
        Ok(Self { sequence, timestamp_ns: timestamp_ns.ok_or_else(out_of_range)? })
    }

    fn shifted(&self, sequence: u64, timestamp_ns: i64) -> Result<(u64, i64), MapError> {
        // Numbers are kept in 63 bits.
        let sequence = i64::try_from(i128::from(sequence) + self.sequence).ok();
        let sequence = sequence.and_then(|sequence| u64::try_from(sequence).ok());
        sequence.zip(timestamp_ns.checked_add(self.timestamp_ns)).ok_or_else(out_of_range)
    }

    fn keyframe(&self, keyframe: &mut crate::map::Keyframe) -> Result<(), MapError> {
        (keyframe.sequence, keyframe.timestamp_ns) =
            self.shifted(keyframe.sequence, keyframe.timestamp_ns)?;
        Ok(())
    }

    /// The frames' records, still by the other map's keyframes.
    fn apply(&self, frames: &[PlacedFrame], from: &Map) -> Result<Vec<FrameRecord>, MapError> {
        let record = |frame: &PlacedFrame| {
            let (sequence, timestamp_ns) = self.shifted(frame.sequence, frame.timestamp_ns)?;
            let pose: Option<FramePose> =
                frame.place.as_ref().and_then(|(reference, pose)| from.place_beside(*reference, pose));
            let (state, backfilled, reason) = (frame.state, frame.backfilled, frame.reason.clone());
            Ok(FrameRecord {
                camera: CameraId::default(),
                sequence,
                timestamp_ns,
                state,
                pose,
                backfilled,
                reason,
            })
        };
        frames.iter().map(record).collect()
    }
}

fn out_of_range() -> MapError {
    MapError("numbers or times of its frames would grow out of range".to_owned())
}

/// Two maps in one, while places are looked for that both show.
struct Joiner<'a> {
    map: Map,
    /// The submaps that were there before.
    own: BTreeSet<SubmapId>,
    loops: LoopCloser,
    config: &'a SlamConfig,
    imported: Imported,
}

impl Joiner<'_> {
    /// Looks at every keyframe taken in, and joins its submap where it shows a place of the others. `None` if
    /// the work was cancelled.
    fn find(&mut self, stretch: &Stretch<'_>) -> Option<Vec<Joined>> {
        let ids: Vec<(KeyframeId, KeyframeId)> = self.imported.keyframes();
        let (mut joins, mut doubtful) = (Vec::new(), Vec::<Recognition>::new());
        for (idx, (before, id)) in ids.iter().enumerate() {
            if stretch.reach(idx as f64 / ids.len() as f64) {
                return None;
            }
            if self.is_own(*id) {
                continue;
            }
            let own = &self.own;
            let is_own = |map: &Map, id| map.keyframe(id).is_some_and(|found| own.contains(&found.submap));
            let Some(recognition) = self.loops.recognize_among(&self.map, *id, is_own) else { continue };
            let is_certain = recognition.n_matches >= self.config.continuity.n_beyond_doubt
                || doubtful.iter().any(|other| self.agree(other, &recognition));
            if !is_certain {
                doubtful.push(recognition);
                continue;
            }
            let (matched, scale) = (recognition.matched, recognition.place_from_current.scale);
            let n_matches = recognition.n_matches;
            if self.loops.join(&mut self.map, &recognition).is_some() {
                let (from_keyframe, into_keyframe) = (*before, matched);
                joins.push(Joined { from_keyframe, into_keyframe, n_matches, scale });
                doubtful.clear();
            }
        }
        Some(joins)
    }

    /// Whether two keyframes, that are not neighbors, say the same of how the maps lie to each other.
    fn agree(&self, a: &Recognition, b: &Recognition) -> bool {
        let (Some(one), Some(other)) = (self.map.keyframe(a.current), self.map.keyframe(b.current)) else {
            return false;
        };
        let submap = |id| self.map.keyframe(id).map(|keyframe| keyframe.submap);
        if one.submap != other.submap || submap(a.matched) != submap(b.matched) || a.current == b.current {
            return false;
        }
        let difference: Similarity = a.place_from_current.inverse() * b.place_from_current;
        let center = other.camera_from_world.center();
        let depth = crate::map::median_depth(&self.map, other).unwrap_or(0.0);
        let (max_turn, max_log_scale, max_shift) = AGREEMENT;
        difference.rotation.angle() <= max_turn
            && difference.scale.ln().abs() <= max_log_scale
            && (difference.transform(&center) - center).norm() <= max_shift * depth
    }

    /// Closes the loops that have become loops by joining. How many; `None` if the work was cancelled.
    fn close_loops(&mut self, stretch: &Stretch<'_>) -> Option<usize> {
        let ids = self.imported.keyframes();
        let mut n_loops = 0;
        for (idx, (_, id)) in ids.iter().enumerate() {
            if stretch.reach(idx as f64 / ids.len() as f64) {
                return None;
            }
            if self.is_own(*id) {
                let closed = self.loops.close(&mut self.map, *id);
                n_loops += usize::from(
                    closed.is_some_and(|closed| matches!(closed.event, MapEvent::LoopClosed { .. })),
                );
            }
        }
        Some(n_loops)
    }

    fn is_own(&self, id: KeyframeId) -> bool {
        self.map.keyframe(id).is_some_and(|keyframe| self.own.contains(&keyframe.submap))
    }
}
