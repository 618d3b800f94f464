//! Edits of points.

use super::*;

#[derive(Clone, Debug)]
pub(super) enum PointEdit {
    Add { position: Vector3<f64>, created_by: Index, seen: Vec<(Index, u32)> },
    Observe(Index, Index, u32),
    Unobserve(Index, Index),
    Remove(Index),
    Fuse(Index, Index),
    Move(Index, Vector3<f64>),
    Refresh(Index),
    Count(Index, u32),
}

pub(super) fn edits() -> impl Strategy<Value = PointEdit> {
    // A few keypoints more than there are.
    let keypoint = || 0..N_KEYPOINTS as u32 + 2;
    prop_oneof![
        6 => (vector(), index(), vec((index(), keypoint()), 1..8))
            .prop_map(|(position, created_by, seen)| PointEdit::Add { position, created_by, seen }),
        3 => (index(), index(), keypoint())
            .prop_map(|(point, keyframe, feature_idx)| PointEdit::Observe(point, keyframe, feature_idx)),
        1 => (index(), index()).prop_map(|(point, keyframe)| PointEdit::Unobserve(point, keyframe)),
        1 => index().prop_map(PointEdit::Remove),
        2 => (index(), index()).prop_map(|(surviving, absorbed)| PointEdit::Fuse(surviving, absorbed)),
        1 => (index(), vector()).prop_map(|(point, position)| PointEdit::Move(point, position)),
        1 => index().prop_map(PointEdit::Refresh),
        1 => (index(), 0..3_u32).prop_map(|(point, n)| PointEdit::Count(point, n)),
    ]
}

impl PointEdit {
    pub(super) fn apply(&self, map: &mut Map) {
        match self {
            Self::Add { position, created_by, seen } => {
                let created_by = keyframe_id(map, *created_by);
                let submap = map.keyframe(created_by).map_or(SubmapId(0), |keyframe| keyframe.submap);
                map.add_point(*position, created_by, &visibility(map, submap, seen));
            }
            Self::Observe(point, keyframe, feature_idx) => {
                let point = point_id(map, *point);
                let submap = map.point(point).map_or(SubmapId(0), |point| point.submap);
                for seen in visibility(map, submap, &[(*keyframe, *feature_idx)]) {
                    map.add_observation(point, seen);
                }
            }
            Self::Unobserve(point, keyframe) => {
                map.remove_observation(point_id(map, *point), keyframe_id(map, *keyframe));
            }
            Self::Remove(point) => map.remove_point(point_id(map, *point)),
            Self::Fuse(surviving, absorbed) => {
                let (surviving, absorbed) = (point_id(map, *surviving), point_id(map, *absorbed));
                if map
                    .point(surviving)
                    .zip(map.point(absorbed))
                    .is_none_or(|(surviving, absorbed)| surviving.submap == absorbed.submap)
                {
                    map.fuse_points(surviving, absorbed);
                }
            }
            Self::Move(point, position) => {
                map.set_position(point_id(map, *point), *position);
                map.refresh_point_geometry(point_id(map, *point));
            }
            Self::Refresh(point) => map.refresh_point(point_id(map, *point)),
            Self::Count(point, n) => map.count_visibility(point_id(map, *point), *n, 1),
        }
    }
}
