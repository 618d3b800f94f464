//! A map as a store keeps it: rows by id, which follow the map through the changes that it hands out.

use super::*;
use geometry::Pose;

/// The rows of a map. Keyframes are kept by what of them can change.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Rows {
    keyframes: BTreeMap<KeyframeId, KeyframeRow>,
    points: BTreeMap<PointId, PointLandmark>,
    lines: BTreeMap<LineId, LineLandmark>,
    primitives: BTreeMap<PrimitiveId, GlobalPrimitive>,
    removed_keyframes: BTreeMap<KeyframeId, RemovedKeyframe>,
    correction: CameraCorrection,
}

#[derive(Debug, PartialEq)]
struct KeyframeRow {
    submap: SubmapId,
    camera_from_world: Pose,
    local_scale: f64,
    parent: Option<KeyframeId>,
    points: Vec<Option<PointId>>,
    lines: Vec<Option<LineId>>,
    vanishing: Vec<VanishingObservation>,
}

impl Rows {
    /// All rows of a map.
    pub(super) fn of(map: &Map) -> Self {
        Self {
            keyframes: map.keyframes().map(|keyframe| (keyframe.id, KeyframeRow::of(keyframe))).collect(),
            points: map.points().map(|point| (point.id, point_row(point))).collect(),
            lines: map.lines().map(|line| (line.id, line_row(line))).collect(),
            primitives: map.primitives().map(|primitive| (primitive.id, primitive.clone())).collect(),
            removed_keyframes: map.removed_keyframes().map(|gone| (gone.id, *gone)).collect(),
            correction: map.correction(),
        }
    }

    /// Writes the rows that changed, and only those.
    pub(super) fn save(&mut self, map: &Map, changes: &MapChanges) {
        for id in &changes.removed_keyframes {
            self.keyframes.remove(id);
            match map.removed_keyframe(*id) {
                Some(gone) => self.removed_keyframes.insert(*id, *gone),
                None => self.removed_keyframes.remove(id),
            };
        }
        let changed = changes.keyframes.iter().filter_map(|id| map.keyframe(*id));
        self.keyframes.extend(changed.map(|keyframe| (keyframe.id, KeyframeRow::of(keyframe))));
        self.points.retain(|id, _| !changes.removed_points.contains(id));
        let changed = changes.points.iter().filter_map(|id| map.point(*id));
        self.points.extend(changed.map(|point| (point.id, point_row(point))));
        self.lines.retain(|id, _| !changes.removed_lines.contains(id));
        let changed = changes.lines.iter().filter_map(|id| map.line(*id));
        self.lines.extend(changed.map(|line| (line.id, line_row(line))));
        self.primitives.retain(|id, _| !changes.removed_primitives.contains(id));
        let changed = changes.primitives.iter().filter_map(|id| map.primitive(*id));
        self.primitives.extend(changed.map(|primitive| (primitive.id, primitive.clone())));
        if changes.correction {
            self.correction = map.correction();
        }
    }
}

impl KeyframeRow {
    fn of(keyframe: &Keyframe) -> Self {
        Self {
            submap: keyframe.submap,
            camera_from_world: keyframe.camera_from_world,
            local_scale: keyframe.local_scale,
            parent: keyframe.parent,
            points: keyframe.points.clone(),
            lines: keyframe.lines.clone(),
            vanishing: keyframe.vanishing.clone(),
        }
    }
}

/// Without how often it was sighted, which is written when the point changes otherwise.
fn point_row(point: &PointLandmark) -> PointLandmark {
    PointLandmark { n_visible: 0, n_found: 0, ..point.clone() }
}

/// Likewise.
fn line_row(line: &LineLandmark) -> LineLandmark {
    LineLandmark { n_visible: 0, n_found: 0, ..line.clone() }
}
