//! A frame while it is being tracked.

use crate::features::{FrameFeatures, View};
use crate::map::{FramePose, Keyframe, KeyframeId, LineId, Map, MapCamera, PointId, PrimitiveId, SubmapId};
use crate::rolling_shutter::InverseDepths;
use geometry::Pose;
use geometry::nalgebra::Vector3;
use std::sync::Arc;

/// Samples of a line where positions stand for it.
const N_LINE_SAMPLES: usize = 5;

/// Landmarks that agree with a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Inliers {
    pub n_points: usize,
    pub n_lines: usize,
}

impl Inliers {
    /// A line bears a pose about as well as a point. [method: Pose-only optimization]
    pub fn total(self) -> usize {
        self.n_points + self.n_lines
    }
}

/// A frame with what is known of it so far.
#[derive(Clone, Debug)]
pub(crate) struct TrackedFrame {
    pub sequence: u64,
    pub timestamp_ns: i64,
    pub features: Arc<FrameFeatures>,
    /// The landmark each keypoint was matched to.
    pub points: Vec<Option<PointId>>,
    /// The landmark each segment was matched to.
    pub lines: Vec<Option<LineId>>,
    /// The primitive each segment runs along.
    pub primitives: Vec<Option<PrimitiveId>>,
    pub camera_from_world: Pose,
    /// The keyframe that shares the most points with this one.
    pub reference: KeyframeId,
    pub submap: SubmapId,
}

impl TrackedFrame {
    /// Landmarks the frame sees.
    pub fn n_landmarks(&self) -> usize {
        self.points.iter().flatten().count() + self.lines.iter().flatten().count()
    }

    /// A frame in which nothing has been recognized yet.
    pub fn blank(view: &View, camera_from_world: Pose, reference: KeyframeId, submap: SubmapId) -> Self {
        let (n_points, n_segments) = (view.features.len(), view.features.lines.len());
        Self {
            sequence: view.sequence,
            timestamp_ns: view.timestamp_ns,
            features: view.features.clone(),
            points: vec![None; n_points],
            lines: vec![None; n_segments],
            primitives: vec![None; n_segments],
            camera_from_world,
            reference,
            submap,
        }
    }

    /// The frame that a keyframe was made of, where the map has it now.
    pub fn of_keyframe(keyframe: &Keyframe) -> Self {
        Self {
            sequence: keyframe.sequence,
            timestamp_ns: keyframe.timestamp_ns,
            features: keyframe.features.clone(),
            points: keyframe.points.clone(),
            lines: keyframe.lines.clone(),
            primitives: vec![None; keyframe.lines.len()],
            camera_from_world: keyframe.camera_from_world,
            reference: keyframe.id,
            submap: keyframe.submap,
        }
    }

    /// The frame's place in the trajectory, relative to its reference keyframe as it stands in `map`.
    pub fn pose_in(&self, map: &Map) -> Option<FramePose> {
        map.place_beside(self.reference, &self.camera_from_world)
    }

    /// Where what the frame sees is, in its camera's frame: points, and samples along lines.
    pub fn landmark_positions(&self, map: &Map) -> Vec<Vector3<f64>> {
        let points = self.points.iter().flatten().filter_map(|id| map.point(*id)).map(|point| point.position);
        let lines = self.lines.iter().flatten().filter_map(|id| map.line(*id));
        let samples = lines.flat_map(|line| {
            let [start, end] = line.endpoints;
            let share = |i: usize| (i as f64 + 0.5) / N_LINE_SAMPLES as f64;
            (0..N_LINE_SAMPLES).map(move |i| start + (end - start) * share(i))
        });
        points.chain(samples).map(|position| self.camera_from_world.transform(&position)).collect()
    }

    /// Inverse depths of the landmarks that the frame sees, by place. `None` if it sees none.
    pub fn inverse_depths(&self, map: &Map) -> Option<InverseDepths> {
        let seen = self.landmark_positions(map).into_iter().filter(|position| position.z > 0.0);
        let places = seen.map(|position| (self.features.pinhole.project(&position), 1.0 / position.z));
        InverseDepths::new(self.features.bounds, places)
    }

    /// Inverse depth of the point that a keypoint was matched to, if it was and that is in front of the
    /// camera.
    pub fn inverse_depth_of(&self, feature_idx: usize, map: &Map) -> Option<f64> {
        let point = map.point(self.points[feature_idx]?)?;
        let depth = self.camera_from_world.transform(&point.position).z;
        (depth > 0.0).then(|| 1.0 / depth)
    }

    /// Makes the frame, which `camera` took, a keyframe with the given identity.
    pub fn to_keyframe(&self, id: KeyframeId, camera: MapCamera, parent: Option<KeyframeId>) -> Keyframe {
        Keyframe {
            id,
            submap: self.submap,
            camera,
            sequence: self.sequence,
            timestamp_ns: self.timestamp_ns,
            camera_from_world: self.camera_from_world,
            local_scale: 1.0,
            features: self.features.clone(),
            points: self.points.clone(),
            lines: self.lines.clone(),
            vanishing: Vec::new(),
            parent,
            covisible: Vec::new(),
        }
    }
}
