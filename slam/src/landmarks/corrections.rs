//! Moving keyframes with the landmarks that belong to them, as a loop closure or a global bundle adjustment
//! says.

use crate::map::{KeyframeId, LineId, Map, PointId, PrimitiveId};
use geometry::Similarity;
use std::collections::BTreeMap;

/// How each keyframe's part of the world is moved, `after_from_before`.
pub(crate) type Corrections = BTreeMap<KeyframeId, Similarity>;

/// Which keyframe a landmark moves with, where that is not the one that made it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Anchoring {
    pub points: BTreeMap<PointId, KeyframeId>,
    pub lines: BTreeMap<LineId, KeyframeId>,
}

/// Moves keyframes with what belongs to them, each by the correction of its own part of the world.
pub(crate) fn apply_corrections(map: &mut Map, corrections: &Corrections, anchoring: &Anchoring) {
    let anchor_of = |created_by: KeyframeId, observers: &[KeyframeId]| {
        std::iter::once(&created_by).chain(observers).copied().find(|id| corrections.contains_key(id))
    };
    let points: Vec<(PointId, KeyframeId)> = map
        .points()
        .filter_map(|point| {
            let observers: Vec<KeyframeId> = point.observations.iter().map(|seen| seen.keyframe).collect();
            let anchor = anchoring.points.get(&point.id).copied();
            Some((point.id, anchor.or_else(|| anchor_of(point.created_by, &observers))?))
        })
        .collect();
    let lines: Vec<(LineId, KeyframeId)> = map
        .lines()
        .filter_map(|line| {
            let observers: Vec<KeyframeId> = line.observations.iter().map(|seen| seen.keyframe).collect();
            let anchor = anchoring.lines.get(&line.id).copied();
            Some((line.id, anchor.or_else(|| anchor_of(line.created_by, &observers))?))
        })
        .collect();
    for (id, correction) in corrections {
        map.move_keyframe(*id, correction);
    }
    for (id, anchor) in points {
        if let Some(correction) = corrections.get(&anchor) {
            map.move_point(id, correction);
        }
    }
    for (id, anchor) in lines {
        if let Some(correction) = corrections.get(&anchor) {
            map.move_line(id, correction);
        }
    }
    let primitives: Vec<(PrimitiveId, Similarity)> = map
        .primitives()
        .filter_map(|primitive| {
            let observers: Vec<KeyframeId> =
                primitive.observations.iter().map(|seen| seen.keyframe).collect();
            Some((primitive.id, *corrections.get(&anchor_of(primitive.created_by, &observers)?)?))
        })
        .collect();
    for (id, correction) in primitives {
        map.realign_primitive(id, &correction);
    }
}
