//! Changing the lines of a map.

use super::edit::most_central;
use super::{KeyframeId, LineId, LineLandmark, Map, Observation, PrimitiveId};
use geometry::Line3;
use geometry::nalgebra::Vector3;
use vision::Descriptor;

/// Where a line is: the infinite line and the part of it that was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LinePlace {
    pub line: Line3,
    pub endpoints: [Vector3<f64>; 2],
}

impl LinePlace {
    pub fn middle(&self) -> Vector3<f64> {
        (self.endpoints[0] + self.endpoints[1]) / 2.0
    }

    pub fn is_finite(&self) -> bool {
        self.line.is_finite() && self.endpoints.iter().all(|end| end.iter().all(|value| value.is_finite()))
    }
}

impl Map {
    /// Makes a line seen by the given segments; `None` if fewer than two of them are free or the place is not
    /// finite.
    pub(crate) fn add_line(
        &mut self,
        place: &LinePlace,
        created_by: KeyframeId,
        observations: &[Observation],
    ) -> Option<LineId> {
        if !place.is_finite() {
            return None;
        }
        let mut free: Vec<Observation> =
            observations.iter().copied().filter(|seen| self.segment_is_free(*seen)).collect();
        free.sort_unstable();
        free.dedup_by_key(|seen| seen.keyframe);
        if free.len() < 2 {
            return None;
        }
        let submap = self.keyframe(created_by)?.submap;
        let id = LineId::from_index(self.next_line_idx);
        self.next_line_idx += 1;
        for seen in &free {
            self.edit_keyframe(seen.keyframe, |keyframe| {
                keyframe.lines[seen.feature_idx as usize] = Some(id)
            });
        }
        let line = LineLandmark {
            id,
            submap,
            line: place.line,
            endpoints: place.endpoints,
            descriptor: Descriptor([0; 4]),
            created_by,
            observations: free,
            n_visible: 1,
            n_found: 1,
            primitive: None,
        };
        self.lines.insert(id.index(), line);
        self.changes.lines.insert(id);
        self.refresh_line(id);
        Some(id)
    }

    /// Enters that a segment sees a line. Nothing happens if either is taken or gone.
    pub(crate) fn add_line_observation(&mut self, line_id: LineId, seen: Observation) -> bool {
        if !self.segment_is_free(seen) || !self.enter_line_observation(line_id, seen) {
            return false;
        }
        self.edit_keyframe(seen.keyframe, |keyframe| {
            keyframe.lines[seen.feature_idx as usize] = Some(line_id);
        });
        true
    }

    /// Undoes a sighting; a line left with fewer than two is removed.
    pub(crate) fn remove_line_observation(&mut self, line_id: LineId, keyframe_id: KeyframeId) {
        let seen_as = self.line(line_id).and_then(|line| line.observation_in(keyframe_id));
        let Some(feature_idx) = seen_as else { return };
        self.edit_keyframe(keyframe_id, |keyframe| keyframe.lines[feature_idx as usize] = None);
        self.leave_line_observation(line_id, keyframe_id);
    }

    /// Takes a line out of the map and of every keyframe that sees it.
    pub(crate) fn remove_line(&mut self, id: LineId) {
        let Some(line) = self.lines.remove(id.index()) else { return };
        for seen in &line.observations {
            self.edit_keyframe(seen.keyframe, |keyframe| keyframe.lines[seen.feature_idx as usize] = None);
        }
        self.changes.lines.remove(&id);
        self.changes.removed_lines.insert(id);
    }

    /// Joins two lines that are the same: `kept` takes over what `gone` was seen by.
    pub(crate) fn fuse_lines(&mut self, surviving: LineId, absorbed: LineId) {
        if surviving == absorbed || self.line(surviving).is_none() {
            return;
        }
        let Some(other) = self.line(absorbed).cloned() else { return };
        self.remove_line(absorbed);
        for seen in &other.observations {
            self.add_line_observation(surviving, *seen);
        }
        self.edit_line(surviving, |line| {
            line.n_visible = line.n_visible.saturating_add(other.n_visible);
            line.n_found = line.n_found.saturating_add(other.n_found);
            line.primitive = line.primitive.or(other.primitive);
        });
    }

    /// Moves a line. A place that is not finite is refused.
    pub(crate) fn set_line_place(&mut self, id: LineId, place: &LinePlace) {
        if place.is_finite() {
            self.edit_line(id, |line| (line.line, line.endpoints) = (place.line, place.endpoints));
        }
    }

    /// Says which primitive's direction a line has. Nothing happens if there is no such primitive.
    pub(crate) fn set_line_primitive(&mut self, id: LineId, primitive: Option<PrimitiveId>) {
        let is_there = primitive.is_none_or(|primitive| self.primitive(primitive).is_some());
        if is_there && self.line(id).is_some_and(|line| line.primitive != primitive) {
            self.edit_line(id, |line| line.primitive = primitive);
        }
    }

    /// Adds to how often lines should have been visible and were found. Written when the line changes
    /// otherwise.
    pub(crate) fn count_line_visibility(&mut self, id: LineId, n_visible: u32, n_found: u32) {
        if let Some(line) = self.lines.get_mut(id.index()) {
            line.n_visible = line.n_visible.saturating_add(n_visible);
            line.n_found = line.n_found.saturating_add(n_found);
        }
    }

    /// Recomputes what a line looks like from its observations.
    pub(crate) fn refresh_line(&mut self, id: LineId) {
        let Some(line) = self.line(id) else { return };
        let descriptors: Vec<Descriptor> = line
            .observations
            .iter()
            .filter_map(|seen| {
                let keyframe = self.keyframe(seen.keyframe)?;
                Some(keyframe.features.lines[seen.feature_idx as usize].descriptor)
            })
            .collect();
        if let Some(descriptor) = most_central(&descriptors) {
            self.edit_line(id, |line| line.descriptor = descriptor);
        }
    }

    fn segment_is_free(&self, seen: Observation) -> bool {
        let segment =
            self.keyframe(seen.keyframe).and_then(|keyframe| keyframe.lines.get(seen.feature_idx as usize));
        segment.is_some_and(Option::is_none)
    }

    pub(super) fn enter_line_observation(&mut self, line_id: LineId, seen: Observation) -> bool {
        let mut entered = false;
        self.edit_line(line_id, |line| {
            let position = line.observations.binary_search_by_key(&seen.keyframe, |other| other.keyframe);
            if let Err(position) = position {
                line.observations.insert(position, seen);
                entered = true;
            }
        });
        entered
    }

    pub(super) fn leave_line_observation(&mut self, line_id: LineId, keyframe_id: KeyframeId) {
        let mut n_left = usize::MAX;
        self.edit_line(line_id, |line| {
            line.observations.retain(|seen| seen.keyframe != keyframe_id);
            n_left = line.observations.len();
        });
        if n_left < 2 {
            self.remove_line(line_id);
        }
    }

    pub(super) fn edit_line(&mut self, id: LineId, edit: impl FnOnce(&mut LineLandmark)) {
        if let Some(line) = self.lines.get_mut(id.index()) {
            edit(line);
            self.changes.lines.insert(id);
        }
    }
}
