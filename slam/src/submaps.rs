//! Which submap the camera is followed in, and when another is begun in its place or beside it.

use crate::config::SubmapConfig;
use crate::map::{CameraId, Keyframe, Map, SubmapId};
use std::sync::atomic::{AtomicU32, Ordering};

/// What becomes of a submap in which the camera was lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Abandoned {
    /// It was lost before it was of any use.
    Discard,
    /// It stays, and a new one is begun beside it.
    Keep,
}

/// Numbers of a map's submaps, for all of its cameras: none is given to two.
#[derive(Debug)]
pub(crate) struct SubmapNumbers(AtomicU32);

impl SubmapNumbers {
    /// Goes on behind those of a map.
    pub fn after(map: &Map) -> Self {
        Self(AtomicU32::new(newest(map).0))
    }

    fn next(&self) -> SubmapId {
        SubmapId(self.0.fetch_add(1, Ordering::Relaxed) + 1)
    }
}

fn newest(map: &Map) -> SubmapId {
    map.submaps().last().copied().unwrap_or_default()
}

/// The submap policy of a camera.
#[derive(Debug)]
pub(crate) struct SubmapPolicy {
    config: SubmapConfig,
    /// The submap the camera is followed in, or is to begin.
    current: SubmapId,
    /// Time of the first frame of those without a pose until now.
    lost_since_ns: Option<i64>,
    /// Frames followed in a young submap since the others were last searched.
    n_since_search: u64,
}

impl SubmapPolicy {
    /// Goes on in the newest submap of a map.
    pub fn resume(config: SubmapConfig, map: &Map) -> Self {
        Self { config, current: newest(map), lost_since_ns: None, n_since_search: 0 }
    }

    /// Begins a submap of its own, unless the camera is found in another before.
    pub fn beside(config: SubmapConfig, numbers: &SubmapNumbers) -> Self {
        Self { config, current: numbers.next(), lost_since_ns: None, n_since_search: 0 }
    }

    pub fn current(&self) -> SubmapId {
        self.current
    }

    /// The camera is followed in this submap.
    pub fn follow(&mut self, submap: SubmapId) {
        self.current = submap;
    }

    /// A frame was placed.
    pub fn found(&mut self) {
        self.lost_since_ns = None;
    }

    /// A map has begun.
    pub fn begun(&mut self) {
        self.n_since_search = 0;
    }

    /// A frame could not be placed: whether its submap is to be given up, and how. A map that was lost before
    /// it was of any use goes at once, another is kept and in time followed by a new one.
    pub fn lost(&mut self, timestamp_ns: i64, was_followed: bool, map: &Map) -> Option<Abandoned> {
        let since = *self.lost_since_ns.get_or_insert(timestamp_ns);
        let is_young = self.is_young(map);
        let give_up = was_followed && is_young || timestamp_ns - since >= self.config.max_lost_ns;
        give_up.then_some(if is_young { Abandoned::Discard } else { Abandoned::Keep })
    }

    /// The next frames begin a submap of their own.
    pub fn begin_next(&mut self, numbers: &SubmapNumbers) {
        self.current = numbers.next();
    }

    /// Whether the current submap is too small to be of use.
    pub fn is_young(&self, map: &Map) -> bool {
        let min_keyframes = self.config.min_keyframes;
        map.keyframes_of(self.current).take(min_keyframes).count() < min_keyframes
    }

    /// Whether this frame of a young submap should be looked for in the others, where this camera has been:
    /// counts the frames that could be. A submap of its own is not given up for one that only other cameras
    /// have made, which may be as young: those are joined once both show the same place.
    pub fn is_search_due(&mut self, map: &Map, camera: CameraId) -> bool {
        let is_own_before =
            |keyframe: &Keyframe| keyframe.submap != self.current && keyframe.camera.id == camera;
        let has_others = map.keyframes().any(is_own_before);
        if !has_others || !self.is_young(map) {
            return false;
        }
        self.n_since_search += 1;
        self.n_since_search.is_multiple_of(self.config.search_interval)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_young_submap_that_was_followed_is_discarded_at_once() {
        let mut policy = SubmapPolicy::resume(SubmapConfig::default(), &Map::default());
        assert_eq!(policy.lost(0, true, &Map::default()), Some(Abandoned::Discard));
    }

    #[test]
    fn a_lost_camera_is_looked_for_before_a_submap_is_begun() {
        let config = SubmapConfig::default();
        let max_lost_ns = config.max_lost_ns;
        let mut policy = SubmapPolicy::resume(config, &Map::default());
        assert_eq!(policy.lost(5, false, &Map::default()), None);
        assert_eq!(policy.lost(5 + max_lost_ns - 1, false, &Map::default()), None);
        policy.found();
        assert_eq!(policy.lost(5 + max_lost_ns, false, &Map::default()), None);
        assert_eq!(policy.lost(5 + 2 * max_lost_ns, false, &Map::default()), Some(Abandoned::Discard));
    }

    #[test]
    fn numbers_of_submaps_are_not_given_twice() {
        let numbers = SubmapNumbers::after(&Map::default());
        let mut policy = SubmapPolicy::resume(SubmapConfig::default(), &Map::default());
        policy.begin_next(&numbers);
        let second = policy.current();
        policy.follow(SubmapId::default());
        let beside = SubmapPolicy::beside(SubmapConfig::default(), &numbers);
        policy.begin_next(&numbers);
        assert!(second < beside.current() && beside.current() < policy.current());
    }
}
