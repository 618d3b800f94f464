//! The map: keyframes, landmarks, and who sees what.
//!
//! A [`Map`] is a value. Copies are cheap and share everything that neither side has changed since, so the
//! one owner works on its copy and hands out snapshots, and no reader ever waits.

mod calibration;
mod changes;
mod depth;
mod edit;
mod edit_lines;
mod edit_places;
mod edit_primitives;
mod ids;
mod import;
mod keyframe;
mod line;
mod paged;
mod parts;
mod point;
mod primitive;
#[cfg(test)]
mod random_edits;
#[cfg(test)]
mod tests;

pub use changes::{FramePose, FrameRecord, FrameState, MapChanges, MapUpdate};
pub(crate) use depth::median_depth;
pub(crate) use edit_lines::LinePlace;
pub use ids::{CameraId, KeyframeId, LineId, PointId, PrimitiveId, SubmapId};
pub(crate) use import::Imported;
pub use keyframe::{Keyframe, MapCamera, RemovedKeyframe};
pub use line::LineLandmark;
pub use point::{Observation, PointLandmark};
pub use primitive::{GlobalPrimitive, PrimitiveObservation, VanishingObservation};

use geometry::CameraCorrection;
use paged::Paged;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Keyframes and landmarks of one session.
#[derive(Clone, Debug, Default)]
pub struct Map {
    keyframes: Paged<Keyframe>,
    points: Paged<PointLandmark>,
    lines: Paged<LineLandmark>,
    primitives: Paged<GlobalPrimitive>,
    removed_keyframes: Arc<BTreeMap<KeyframeId, RemovedKeyframe>>,
    next_keyframe_idx: usize,
    next_point_idx: usize,
    next_line_idx: usize,
    next_primitive_idx: usize,
    correction: CameraCorrection,
    /// Whether the images contradict the calibration.
    is_contradicted: bool,
    readout: Option<Readout>,
    changes: MapChanges,
}

/// What a stored map consists of, to make a [`Map`] from again. The order of the entries does not matter.
#[derive(Clone, Debug, Default)]
pub struct MapParts {
    /// Keyframes, without their covisibility, which is derived.
    pub keyframes: Vec<Keyframe>,
    /// Points.
    pub points: Vec<PointLandmark>,
    /// Lines.
    pub lines: Vec<LineLandmark>,
    /// Global primitives.
    pub primitives: Vec<GlobalPrimitive>,
    /// Removed keyframes that frames may still refer to.
    pub removed_keyframes: Vec<RemovedKeyframe>,
    /// How the camera differs from its calibration, as far as the session has found out.
    pub correction: CameraCorrection,
    /// Whether the images contradict the calibration.
    pub is_contradicted: bool,
    /// The readout of the camera's shutter, if that was found.
    pub readout: Option<Readout>,
    /// Numbers above which ids are free; ids in use above them are respected too.
    pub last_ids: LastIds,
}

/// How long a camera takes to read the rows of an image, as the images show it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Readout {
    /// From the first row to the last, nanoseconds.
    pub readout_ns: i64,
    /// Its standard deviation, nanoseconds.
    pub sigma_ns: i64,
}

impl Readout {
    /// From the first row to the last, milliseconds.
    pub fn ms(&self) -> f64 {
        self.readout_ns as f64 * 1e-6
    }

    /// Its standard deviation, milliseconds.
    pub fn sigma_ms(&self) -> f64 {
        self.sigma_ns as f64 * 1e-6
    }
}

/// The highest ids ever given out in a session, 0 before the first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LastIds {
    /// Of keyframes.
    pub keyframe: u64,
    /// Of points.
    pub point: u64,
    /// Of lines.
    pub line: u64,
    /// Of global primitives.
    pub primitive: u64,
}

/// Why a stored map cannot be used, or what is wrong with a map in memory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the map is inconsistent: {0}")]
pub struct MapError(pub String);

impl Map {
    /// The keyframe with this id, if it is in the map.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&Keyframe> {
        self.keyframes.get(id.index())
    }

    /// The point with this id, if it is in the map.
    pub fn point(&self, id: PointId) -> Option<&PointLandmark> {
        self.points.get(id.index())
    }

    /// The line with this id, if it is in the map.
    pub fn line(&self, id: LineId) -> Option<&LineLandmark> {
        self.lines.get(id.index())
    }

    /// The global primitive with this id, if it is in the map.
    pub fn primitive(&self, id: PrimitiveId) -> Option<&GlobalPrimitive> {
        self.primitives.get(id.index())
    }

    /// Every line, oldest first.
    pub fn lines(&self) -> impl Iterator<Item = &LineLandmark> {
        self.lines.iter()
    }

    /// Every global primitive, oldest first.
    pub fn primitives(&self) -> impl Iterator<Item = &GlobalPrimitive> {
        self.primitives.iter()
    }

    /// How many lines there are.
    pub fn n_lines(&self) -> usize {
        self.lines.len()
    }

    /// How many global primitives there are.
    pub fn n_primitives(&self) -> usize {
        self.primitives.len()
    }

    /// Every keyframe, oldest first.
    pub fn keyframes(&self) -> impl Iterator<Item = &Keyframe> {
        self.keyframes.iter()
    }

    /// Every point, oldest first.
    pub fn points(&self) -> impl Iterator<Item = &PointLandmark> {
        self.points.iter()
    }

    /// How many keyframes there are.
    pub fn n_keyframes(&self) -> usize {
        self.keyframes.len()
    }

    /// How many points there are.
    pub fn n_points(&self) -> usize {
        self.points.len()
    }

    /// What a removed keyframe hangs on now.
    pub fn removed_keyframe(&self, id: KeyframeId) -> Option<&RemovedKeyframe> {
        self.removed_keyframes.get(&id)
    }

    /// Every removed keyframe, in the order of their ids.
    pub fn removed_keyframes(&self) -> impl Iterator<Item = &RemovedKeyframe> {
        self.removed_keyframes.values()
    }

    /// The highest ids ever given out.
    pub fn last_ids(&self) -> LastIds {
        LastIds {
            keyframe: self.next_keyframe_idx as u64,
            point: self.next_point_idx as u64,
            line: self.next_line_idx as u64,
            primitive: self.next_primitive_idx as u64,
        }
    }

    /// How the map's own camera differs from its calibration.
    pub fn correction(&self) -> CameraCorrection {
        self.correction
    }

    /// How one of the map's cameras differs from its calibration.
    pub fn correction_of(&self, camera: MapCamera) -> CameraCorrection {
        if camera.is_refined { self.correction } else { CameraCorrection::default() }
    }

    /// Keyframes made since `id`, up to and with `newest`, by the camera that took `id`; counting ends beyond
    /// `limit`. A removed one is the camera's whose keyframe it hangs on. Of numbers that are not in the map
    /// any more, or not yet, nobody knows whose they are: they count where no other camera is about.
    pub(crate) fn age(&self, id: KeyframeId, newest: KeyframeId, limit: u64) -> u64 {
        let camera_of = |id: KeyframeId| self.anchor_of(id).map(|keyframe| keyframe.camera.id);
        let camera = camera_of(id).or_else(|| camera_of(newest));
        let (mut n_own, mut n_unknown, mut is_shared) = (0, 0, false);
        for idx in (id.index() + 1..newest.index() + 1).rev() {
            match camera_of(KeyframeId::from_index(idx)) {
                None => n_unknown += 1,
                other if other == camera => n_own += 1,
                Some(_) => is_shared = true,
            }
            if n_own + if is_shared { 0 } else { n_unknown } > limit {
                break;
            }
        }
        n_own + if is_shared { 0 } else { n_unknown }
    }

    /// Whether the images were found to contradict the calibration by more than it may be corrected.
    pub fn is_contradicted(&self) -> bool {
        self.is_contradicted
    }

    /// The readout of the camera's shutter, where it was not told and the motion has shown it: it was taken
    /// out of what the keyframes measured.
    pub fn readout(&self) -> Option<Readout> {
        self.readout
    }

    /// The submaps that have keyframes, in order.
    pub fn submaps(&self) -> BTreeSet<SubmapId> {
        self.keyframes().map(|keyframe| keyframe.submap).collect()
    }
}
