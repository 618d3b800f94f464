//! Edits of keyframes.

use super::*;
use crate::features::{FrameFeatures, LineFeature, PyramidGeometry};
use geometry::nalgebra::vector;
use geometry::{Camera, CameraModel, CameraParameters, Pose};
use std::sync::OnceLock;
use vision::{Descriptor, Keypoint};

#[derive(Clone, Debug)]
pub(super) enum KeyframeEdit {
    /// Sees landmarks that may have gone, some of them more than once.
    Add {
        submap: u32,
        parent: Index,
        pose: Vector6<f64>,
        points: Vec<Option<Index>>,
        lines: Vec<Option<Index>>,
    },
    Remove {
        keyframe: Index,
        anchor: Index,
    },
    SetPose(Index, Vector6<f64>),
    SetParent(Index, Index),
    RefreshCovisibility(Index, u32),
}

pub(super) fn edits() -> impl Strategy<Value = KeyframeEdit> {
    let slots = |n: usize| vec(proptest::option::of(index()), n);
    prop_oneof![
        6 => (0..N_SUBMAPS, index(), twist(), slots(N_KEYPOINTS), slots(N_SEGMENTS)).prop_map(
            |(submap, parent, pose, points, lines)| KeyframeEdit::Add { submap, parent, pose, points, lines }
        ),
        2 => (index(), index()).prop_map(|(keyframe, anchor)| KeyframeEdit::Remove { keyframe, anchor }),
        1 => (index(), twist()).prop_map(|(keyframe, pose)| KeyframeEdit::SetPose(keyframe, pose)),
        1 => (index(), index()).prop_map(|(keyframe, parent)| KeyframeEdit::SetParent(keyframe, parent)),
        2 => (index(), 0..4_u32)
            .prop_map(|(keyframe, min_shared)| KeyframeEdit::RefreshCovisibility(keyframe, min_shared)),
    ]
}

impl KeyframeEdit {
    pub(super) fn apply(&self, map: &mut Map) {
        match self {
            Self::Add { submap, parent, pose, points, lines } => {
                let mut keyframe = new_keyframe(map, SubmapId(*submap), *parent, pose);
                keyframe.points = points
                    .iter()
                    .map(|slot| slot.map(|index| point_id(map, index)))
                    .map(|id| {
                        id.filter(|id| map.point(*id).is_none_or(|point| point.submap == keyframe.submap))
                    })
                    .collect();
                keyframe.lines = lines
                    .iter()
                    .map(|slot| slot.map(|index| line_id(map, index)))
                    .map(|id| id.filter(|id| map.line(*id).is_none_or(|line| line.submap == keyframe.submap)))
                    .collect();
                map.add_keyframe(keyframe);
            }
            Self::Remove { keyframe, anchor } => {
                let (keyframe, anchor) = (keyframe_id(map, *keyframe), keyframe_id(map, *anchor));
                if are_together(map, keyframe, anchor) {
                    map.remove_keyframe(keyframe, anchor);
                }
            }
            Self::SetPose(keyframe, pose) => map.set_pose(keyframe_id(map, *keyframe), Pose::exp(pose)),
            Self::SetParent(keyframe, parent) => {
                let (keyframe, parent) = (keyframe_id(map, *keyframe), keyframe_id(map, *parent));
                if are_together(map, keyframe, parent) {
                    map.set_parent(keyframe, parent);
                }
            }
            Self::RefreshCovisibility(keyframe, min_shared) => {
                map.refresh_covisibility(keyframe_id(map, *keyframe), *min_shared);
            }
        }
    }
}

/// Whether two keyframes, as far as they are there, are of one submap.
fn are_together(map: &Map, a: KeyframeId, b: KeyframeId) -> bool {
    map.keyframe(a).zip(map.keyframe(b)).is_none_or(|(a, b)| a.submap == b.submap)
}

fn new_keyframe(map: &Map, submap: SubmapId, parent: Index, pose: &Vector6<f64>) -> Keyframe {
    let id = KeyframeId::from_index(map.last_ids().keyframe as usize);
    let parents: Vec<KeyframeId> = map.keyframes_of(submap).map(|keyframe| keyframe.id).collect();
    let parent = (!parents.is_empty()).then(|| *parent.get(&parents));
    // Tracking gives no pose that is not finite.
    let pose = Some(Pose::exp(pose)).filter(Pose::is_finite).unwrap_or_else(Pose::identity);
    Keyframe::from_parts(id, submap, id.get(), id.get() as i64 * 1000, pose, features(), parent)
}

/// What every keyframe measures: to the edits it does not matter what.
fn features() -> Arc<FrameFeatures> {
    static FEATURES: OnceLock<Arc<FrameFeatures>> = OnceLock::new();
    let make = || {
        let camera = Camera::new(CameraParameters {
            model: CameraModel::Pinhole,
            width: 640,
            height: 480,
            fx: 500.0,
            fy: 500.0,
            cx: 320.0,
            cy: 240.0,
            distortion: Vec::new(),
        });
        let keypoint = |idx: usize| Keypoint {
            x: 60.0 * idx as f32,
            y: 100.0,
            octave: (idx % 3) as u8,
            angle: 0.0,
            response: 30.0,
        };
        let descriptor = |idx: usize| Descriptor([idx as u64, !(idx as u64), 7, 0]);
        let line = |idx: usize| LineFeature {
            start: vector![100.0 * idx as f64, 50.0],
            end: vector![100.0 * idx as f64, 200.0],
            sigma_px: 1.0,
            descriptor: descriptor(idx),
            track: idx as u64,
        };
        let pyramid = PyramidGeometry { n_levels: 8, scale_factor: 1.2 };
        let keypoints = (0..N_KEYPOINTS).map(keypoint).collect();
        let descriptors = (0..N_KEYPOINTS).map(descriptor).collect();
        let features = FrameFeatures::from_parts(keypoints, descriptors, &camera.unwrap(), pyramid).unwrap();
        Arc::new(features.with_lines((0..N_SEGMENTS).map(line).collect()))
    };
    FEATURES.get_or_init(make).clone()
}
