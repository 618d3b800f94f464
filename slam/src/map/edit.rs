//! Changing a map. Every change keeps both sides of an observation in step and notes the rows it touches.

use super::calibration;
use super::{
    Keyframe, KeyframeId, LineId, Map, MapChanges, Observation, PointId, PointLandmark, PrimitiveId,
    RemovedKeyframe, SubmapId,
};
use geometry::Pose;
use geometry::nalgebra::Vector3;
use std::collections::BTreeMap;
use std::sync::Arc;
use vision::Descriptor;

impl Map {
    /// Hands out what changed since the last call and begins anew.
    pub(crate) fn take_changes(&mut self) -> MapChanges {
        std::mem::take(&mut self.changes)
    }

    /// Puts a keyframe into the map. Observations in its `points` are entered at the landmarks; those of
    /// landmarks that are gone, or already seen by another keypoint of the frame, are dropped.
    pub(crate) fn add_keyframe(&mut self, mut keyframe: Keyframe) {
        let id = keyframe.id;
        calibration::adapt(&mut keyframe, &self.correction);
        self.next_keyframe_idx = self.next_keyframe_idx.max(id.index() + 1);
        for (feature_idx, slot) in keyframe.points.iter_mut().enumerate() {
            let Some(point_id) = *slot else { continue };
            let observation = Observation { keyframe: id, feature_idx: feature_idx as u32 };
            if !self.enter_observation(point_id, observation) {
                *slot = None;
            }
        }
        for (feature_idx, slot) in keyframe.lines.iter_mut().enumerate() {
            let Some(line_id) = *slot else { continue };
            let observation = Observation { keyframe: id, feature_idx: feature_idx as u32 };
            if !self.enter_line_observation(line_id, observation) {
                *slot = None;
            }
        }
        self.changes.keyframes.insert(id);
        self.keyframes.insert(id.index(), keyframe);
    }

    /// Takes a keyframe out, with its observations. Frames and keyframes that hang on it hang on `anchor`,
    /// another one of its submap, from now on. Points left with fewer than two observations go too.
    pub(crate) fn remove_keyframe(&mut self, id: KeyframeId, anchor: KeyframeId) {
        let Some(anchor_from_world) =
            self.keyframe(anchor).filter(|anchor| anchor.id != id).map(|anchor| anchor.camera_from_world)
        else {
            return;
        };
        let Some(removed) = self.keyframes.remove(id.index()) else { return };
        for (_, point_id) in removed.observed_points() {
            self.leave_observation(point_id, id);
        }
        for (_, line_id) in removed.observed_lines() {
            self.leave_line_observation(line_id, id);
        }
        for primitive_id in removed.vanishing.iter().filter_map(|seen| seen.primitive) {
            self.leave_primitive_observation(primitive_id, id);
        }
        let mut camera_from_anchor = removed.camera_from_world * anchor_from_world.inverse();
        camera_from_anchor.translation /= self.keyframe(anchor).map_or(1.0, |keyframe| keyframe.local_scale);
        Arc::make_mut(&mut self.removed_keyframes)
            .insert(id, RemovedKeyframe { id, anchor, camera_from_anchor });
        let children: Vec<KeyframeId> = self
            .keyframes()
            .filter(|keyframe| keyframe.parent == Some(id))
            .map(|keyframe| keyframe.id)
            .collect();
        for child in children {
            // What the anchor itself hangs on cannot hang on the anchor.
            let parent = if self.hangs_on(anchor, child) { removed.parent } else { Some(anchor) };
            self.edit_keyframe(child, |keyframe| keyframe.parent = parent);
        }
        for (neighbor, _) in removed.covisible.iter() {
            if let Some(keyframe) = self.keyframes.get_mut(neighbor.index()) {
                keyframe.covisible.retain(|(other, _)| *other != id);
            }
        }
        self.changes.keyframes.remove(&id);
        self.changes.removed_keyframes.insert(id);
    }

    /// Makes a point seen by the given keypoints; `None` if fewer than two of them are free.
    pub(crate) fn add_point(
        &mut self,
        position: Vector3<f64>,
        created_by: KeyframeId,
        observations: &[Observation],
    ) -> Option<PointId> {
        if !position.iter().all(|value| value.is_finite()) {
            return None;
        }
        let mut free: Vec<Observation> =
            observations.iter().copied().filter(|seen| self.keypoint_is_free(*seen)).collect();
        free.sort_unstable();
        free.dedup_by_key(|seen| seen.keyframe);
        if free.len() < 2 {
            return None;
        }
        let submap = self.keyframe(created_by)?.submap;
        let id = PointId::from_index(self.next_point_idx);
        self.next_point_idx += 1;
        for seen in &free {
            self.edit_keyframe(seen.keyframe, |keyframe| {
                keyframe.points[seen.feature_idx as usize] = Some(id)
            });
        }
        let point = PointLandmark {
            id,
            submap,
            position,
            descriptor: Descriptor([0; 4]),
            mean_view_direction: Vector3::z(),
            distance_range: (0.0, f64::INFINITY),
            created_by,
            observations: free,
            n_visible: 1,
            n_found: 1,
        };
        self.points.insert(id.index(), point);
        self.changes.points.insert(id);
        self.refresh_point(id);
        Some(id)
    }

    /// Enters that a keypoint sees a point. Nothing happens if either is taken or gone.
    pub(crate) fn add_observation(&mut self, point_id: PointId, seen: Observation) -> bool {
        if !self.keypoint_is_free(seen) || !self.enter_observation(point_id, seen) {
            return false;
        }
        self.edit_keyframe(seen.keyframe, |keyframe| {
            keyframe.points[seen.feature_idx as usize] = Some(point_id)
        });
        true
    }

    /// Undoes a sighting; a point left with fewer than two is removed.
    pub(crate) fn remove_observation(&mut self, point_id: PointId, keyframe_id: KeyframeId) {
        let Some(feature_idx) = self.point(point_id).and_then(|point| point.observation_in(keyframe_id))
        else {
            return;
        };
        self.edit_keyframe(keyframe_id, |keyframe| keyframe.points[feature_idx as usize] = None);
        self.leave_observation(point_id, keyframe_id);
    }

    /// Takes a point out of the map and of every keyframe that sees it.
    pub(crate) fn remove_point(&mut self, id: PointId) {
        let Some(point) = self.points.remove(id.index()) else { return };
        for seen in &point.observations {
            self.edit_keyframe(seen.keyframe, |keyframe| keyframe.points[seen.feature_idx as usize] = None);
        }
        self.changes.points.remove(&id);
        self.changes.removed_points.insert(id);
    }

    /// Joins two points that are the same: `kept` takes over what `gone` was seen by.
    pub(crate) fn fuse_points(&mut self, surviving: PointId, absorbed: PointId) {
        if surviving == absorbed || self.point(surviving).is_none() {
            return;
        }
        let Some(other) = self.point(absorbed).cloned() else { return };
        self.remove_point(absorbed);
        for seen in &other.observations {
            self.add_observation(surviving, *seen);
        }
        self.edit_point(surviving, |point| {
            point.n_visible = point.n_visible.saturating_add(other.n_visible);
            point.n_found = point.n_found.saturating_add(other.n_found);
        });
    }

    /// Moves a keyframe. A pose that is not finite is refused.
    pub(crate) fn set_pose(&mut self, id: KeyframeId, camera_from_world: Pose) {
        if camera_from_world.is_finite() {
            self.edit_keyframe(id, |keyframe| keyframe.camera_from_world = camera_from_world);
        }
    }

    /// Hangs a keyframe on another in the spanning tree. Nothing happens if that is gone, or hangs on the
    /// keyframe.
    pub(crate) fn set_parent(&mut self, id: KeyframeId, parent: KeyframeId) {
        if self.keyframe(parent).is_some() && !self.hangs_on(parent, id) {
            self.edit_keyframe(id, |keyframe| keyframe.parent = Some(parent));
        }
    }

    /// Takes out every keyframe and point of a submap that came to nothing.
    pub(crate) fn remove_submap(&mut self, submap: SubmapId) {
        let points: Vec<PointId> =
            self.points().filter(|point| point.submap == submap).map(|point| point.id).collect();
        points.into_iter().for_each(|id| self.remove_point(id));
        let lines: Vec<LineId> =
            self.lines().filter(|line| line.submap == submap).map(|line| line.id).collect();
        lines.into_iter().for_each(|id| self.remove_line(id));
        let primitives: Vec<PrimitiveId> = self
            .primitives()
            .filter(|primitive| primitive.submap == submap)
            .map(|primitive| primitive.id)
            .collect();
        primitives.into_iter().for_each(|id| self.remove_primitive(id));
        let keyframes: Vec<KeyframeId> = self
            .keyframes()
            .filter(|keyframe| keyframe.submap == submap)
            .map(|keyframe| keyframe.id)
            .collect();
        for id in keyframes {
            self.keyframes.remove(id.index());
            self.changes.keyframes.remove(&id);
            self.changes.removed_keyframes.insert(id);
        }
        let orphans: Vec<KeyframeId> = self.removed_keyframes.keys().copied().collect();
        let orphans: Vec<KeyframeId> =
            orphans.into_iter().filter(|id| self.camera_from_world(*id).is_none()).collect();
        if !orphans.is_empty() {
            let removed = Arc::make_mut(&mut self.removed_keyframes);
            removed.retain(|id, _| !orphans.contains(id));
            self.changes.removed_keyframes.extend(orphans);
        }
    }

    /// Moves a point. A position that is not finite is refused.
    pub(crate) fn set_position(&mut self, id: PointId, position: Vector3<f64>) {
        if position.iter().all(|value| value.is_finite()) {
            self.edit_point(id, |point| point.position = position);
        }
    }

    /// Adds to how often points should have been visible and were found. Not worth a row of its own in the
    /// store: it is written when the point changes otherwise.
    pub(crate) fn count_visibility(&mut self, id: PointId, n_visible: u32, n_found: u32) {
        if let Some(point) = self.points.get_mut(id.index()) {
            point.n_visible = point.n_visible.saturating_add(n_visible);
            point.n_found = point.n_found.saturating_add(n_found);
        }
    }

    /// Recomputes what is derived from a point's observations: descriptor, viewing direction, distances.
    pub(crate) fn refresh_point(&mut self, id: PointId) {
        let Some(point) = self.point(id) else { return };
        let Some(summary) = PointSummary::of(self, point) else { return };
        self.edit_point(id, |point| {
            point.descriptor = summary.descriptor;
            point.mean_view_direction = summary.mean_view_direction;
            point.distance_range = summary.distance_range;
        });
    }

    /// Recomputes viewing direction and distances after a point or its cameras moved; the descriptor stays.
    pub(crate) fn refresh_point_geometry(&mut self, id: PointId) {
        let Some(point) = self.point(id) else { return };
        let Some((mean_view_direction, distance_range)) = view_geometry(self, point) else { return };
        self.edit_point(id, |point| {
            point.mean_view_direction = mean_view_direction;
            point.distance_range = distance_range;
        });
    }

    /// Recomputes which keyframes share points and lines with this one, on both sides.
    ///
    /// The strongest edge is kept even when it is below `min_shared`, so that no keyframe is alone.
    pub(crate) fn refresh_covisibility(&mut self, id: KeyframeId, min_shared: u32) {
        let Some(keyframe) = self.keyframe(id) else { return };
        let mut shared: BTreeMap<KeyframeId, u32> = BTreeMap::new();
        for (_, point_id) in keyframe.observed_points() {
            let Some(point) = self.point(point_id) else { continue };
            for seen in point.observations.iter().filter(|seen| seen.keyframe != id) {
                *shared.entry(seen.keyframe).or_default() += 1;
            }
        }
        for (_, line_id) in keyframe.observed_lines() {
            let Some(line) = self.line(line_id) else { continue };
            for seen in line.observations.iter().filter(|seen| seen.keyframe != id) {
                *shared.entry(seen.keyframe).or_default() += 1;
            }
        }
        let strongest =
            shared.iter().max_by_key(|(other, n)| (**n, std::cmp::Reverse(**other))).map(|(other, _)| *other);
        let before: Vec<KeyframeId> = keyframe.covisible.iter().map(|(other, _)| *other).collect();
        let mut covisible: Vec<(KeyframeId, u32)> =
            shared.into_iter().filter(|(other, n)| *n >= min_shared || Some(*other) == strongest).collect();
        sort_by_weight(&mut covisible);
        for other in
            before.into_iter().filter(|other| covisible.iter().all(|(surviving, _)| surviving != other))
        {
            if let Some(neighbor) = self.keyframes.get_mut(other.index()) {
                neighbor.covisible.retain(|(back, _)| *back != id);
            }
        }
        for (other, n) in &covisible {
            if let Some(neighbor) = self.keyframes.get_mut(other.index()) {
                neighbor.covisible.retain(|(back, _)| *back != id);
                neighbor.covisible.push((id, *n));
                sort_by_weight(&mut neighbor.covisible);
            }
        }
        if let Some(keyframe) = self.keyframes.get_mut(id.index()) {
            keyframe.covisible = covisible;
        }
    }

    fn keypoint_is_free(&self, seen: Observation) -> bool {
        let keypoint =
            self.keyframe(seen.keyframe).and_then(|keyframe| keyframe.points.get(seen.feature_idx as usize));
        keypoint.is_some_and(Option::is_none)
    }

    fn enter_observation(&mut self, point_id: PointId, seen: Observation) -> bool {
        let mut entered = false;
        self.edit_point(point_id, |point| {
            if let Err(position) =
                point.observations.binary_search_by_key(&seen.keyframe, |other| other.keyframe)
            {
                point.observations.insert(position, seen);
                entered = true;
            }
        });
        entered
    }

    fn leave_observation(&mut self, point_id: PointId, keyframe_id: KeyframeId) {
        let mut n_left = usize::MAX;
        self.edit_point(point_id, |point| {
            point.observations.retain(|seen| seen.keyframe != keyframe_id);
            n_left = point.observations.len();
        });
        if n_left < 2 {
            self.remove_point(point_id);
        }
    }

    pub(super) fn edit_keyframe(&mut self, id: KeyframeId, edit: impl FnOnce(&mut Keyframe)) {
        if let Some(keyframe) = self.keyframes.get_mut(id.index()) {
            edit(keyframe);
            self.changes.keyframes.insert(id);
        }
    }

    pub(super) fn edit_point(&mut self, id: PointId, edit: impl FnOnce(&mut PointLandmark)) {
        if let Some(point) = self.points.get_mut(id.index()) {
            edit(point);
            self.changes.points.insert(id);
        }
    }
}

fn sort_by_weight(covisible: &mut [(KeyframeId, u32)]) {
    covisible.sort_by_key(|(id, n)| (std::cmp::Reverse(*n), *id));
}

/// What a point's observations say of it.
struct PointSummary {
    descriptor: Descriptor,
    mean_view_direction: Vector3<f64>,
    distance_range: (f64, f64),
}

impl PointSummary {
    fn of(map: &Map, point: &PointLandmark) -> Option<Self> {
        let (mean_view_direction, distance_range) = view_geometry(map, point)?;
        let descriptors: Vec<Descriptor> = point
            .observations
            .iter()
            .filter_map(|seen| {
                Some(map.keyframe(seen.keyframe)?.features.descriptors[seen.feature_idx as usize])
            })
            .collect();
        Some(Self { descriptor: most_central(&descriptors)?, mean_view_direction, distance_range })
    }
}

/// Mean viewing direction, and the distances at which the pyramid still holds the scale the point was seen
/// at.
fn view_geometry(map: &Map, point: &PointLandmark) -> Option<(Vector3<f64>, (f64, f64))> {
    let mut direction_sum = Vector3::zeros();
    for seen in &point.observations {
        let center = map.keyframe(seen.keyframe)?.camera_from_world.center();
        direction_sum += (point.position - center).try_normalize(f64::MIN_POSITIVE)?;
    }
    let reference = point.observations.iter().find(|seen| seen.keyframe == point.created_by);
    let reference = reference.or(point.observations.first())?;
    let keyframe = map.keyframe(reference.keyframe)?;
    let distance = (point.position - keyframe.camera_from_world.center()).norm();
    let pyramid = keyframe.features.pyramid;
    let octave = keyframe.features.keypoints[reference.feature_idx as usize].octave;
    let farthest = distance * pyramid.scale(octave);
    let nearest = farthest / pyramid.scale(pyramid.n_levels - 1);
    Some((direction_sum.try_normalize(f64::MIN_POSITIVE)?, (nearest, farthest)))
}

/// The descriptor with the least median distance to the others.
pub(super) fn most_central(descriptors: &[Descriptor]) -> Option<Descriptor> {
    /// More views than this say nothing new about the appearance, and the work grows with their square.
    const MAX_COMPARED: usize = 12;
    let step = descriptors.len().div_ceil(MAX_COMPARED).max(1);
    let sample: Vec<&Descriptor> = descriptors.iter().step_by(step).collect();
    let median_distance = |candidate: &Descriptor| {
        let mut distances: Vec<u32> = sample.iter().map(|other| candidate.distance(other)).collect();
        distances.sort_unstable();
        distances[(distances.len() - 1) / 2]
    };
    sample.iter().min_by_key(|candidate| median_distance(candidate)).map(|descriptor| **descriptor)
}
