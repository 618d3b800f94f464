//! Motion continuity: how far a camera can have moved. Two places that look alike are told apart by it.

use crate::config::ContinuityConfig;
use crate::map::{CameraId, Keyframe, KeyframeId, Map, SubmapId, median_depth};
use geometry::Similarity;
use geometry::nalgebra::Vector3;

/// Keyframes at the end of a submap from which the camera's speed is taken.
const N_SPEED_KEYFRAMES: usize = 10;

/// How far a camera may have come since it was last seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reach {
    /// The submap it was last seen in.
    pub submap: SubmapId,
    /// Where it was, map units.
    center: Vector3<f64>,
    /// How far it may be from there, map units.
    radius: f64,
}

impl Reach {
    /// From the keyframes that a camera made before `timestamp_ns`; `None` where it was long ago or the speed
    /// is unknown. Clocks of cameras have nothing to do with each other.
    pub fn after_keyframes(
        map: &Map,
        submap: SubmapId,
        (camera, timestamp_ns): (CameraId, i64),
        config: &ContinuityConfig,
    ) -> Option<Self> {
        let is_before =
            |keyframe: &&Keyframe| keyframe.camera.id == camera && keyframe.timestamp_ns < timestamp_ns;
        let mut before: Vec<&Keyframe> = map.keyframes_of(submap).filter(is_before).collect();
        before.sort_by_key(|keyframe| keyframe.timestamp_ns);
        let newest = &before[before.len().saturating_sub(N_SPEED_KEYFRAMES)..];
        let (first, last) = (newest.first()?, newest.last()?);
        let way: f64 = newest
            .windows(2)
            .map(|pair| (pair[0].camera_from_world.center() - pair[1].camera_from_world.center()).norm())
            .sum();
        let speed_per_ns = way / (last.timestamp_ns - first.timestamp_ns).max(1) as f64;
        Self::from(
            map,
            last.id,
            &last.camera_from_world.center(),
            speed_per_ns,
            timestamp_ns - last.timestamp_ns,
            config,
        )
    }

    /// From where the camera was `elapsed_ns` ago, beside a keyframe; `None` where that is long ago.
    pub fn from(
        map: &Map,
        beside: KeyframeId,
        center: &Vector3<f64>,
        speed_per_ns: f64,
        elapsed_ns: i64,
        config: &ContinuityConfig,
    ) -> Option<Self> {
        if elapsed_ns.abs() > config.max_elapsed_ns {
            return None;
        }
        let keyframe = map.anchor_of(beside)?;
        let radius = config.depth_share * median_depth(map, keyframe)?
            + config.speed_factor * speed_per_ns * elapsed_ns.abs() as f64;
        radius.is_finite().then_some(Self { submap: keyframe.submap, center: *center, radius })
    }

    /// Whether a camera there, map units, can be the one that was last seen.
    pub fn includes(&self, center: &Vector3<f64>) -> bool {
        (center - self.center).norm() <= self.radius
    }
}

/// Whether the camera can have gone from the older submap to where `older_from_newer` says that the newer one
/// began. Of submaps that no camera was in both of, nothing is known.
pub(crate) fn can_follow(
    map: &Map,
    older: SubmapId,
    newer: SubmapId,
    older_from_newer: &Similarity,
    config: &ContinuityConfig,
) -> bool {
    let Some(camera) = map.keyframes_of(newer).next().map(|keyframe| keyframe.camera.id) else {
        return true;
    };
    let own = map.keyframes_of(newer).filter(|keyframe| keyframe.camera.id == camera);
    let Some(first) = own.min_by_key(|keyframe| keyframe.timestamp_ns) else { return true };
    let center = older_from_newer.transform(&first.camera_from_world.center());
    let reach = Reach::after_keyframes(map, older, (camera, first.timestamp_ns), config);
    reach.is_none_or(|reach| reach.includes(&center))
}
