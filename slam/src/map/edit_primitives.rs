//! Changing the global primitives of a map.

use super::{
    GlobalPrimitive, KeyframeId, LineId, Map, PrimitiveId, PrimitiveObservation, SubmapId,
    VanishingObservation,
};
use geometry::Direction;
use geometry::nalgebra::Matrix3;

impl Map {
    /// Enters which vanishing points a keyframe shows; they belong to no primitive yet.
    pub(crate) fn set_vanishing(&mut self, id: KeyframeId, vanishing: Vec<VanishingObservation>) {
        let before: Vec<PrimitiveId> = self
            .keyframe(id)
            .into_iter()
            .flat_map(|keyframe| keyframe.vanishing.iter().filter_map(|seen| seen.primitive))
            .collect();
        for primitive in before {
            self.remove_primitive_observation(primitive, id);
        }
        self.edit_keyframe(id, |keyframe| keyframe.vanishing = vanishing);
    }

    /// Makes a primitive that no keyframe sees yet; `None` if its covariance is not finite.
    pub(crate) fn add_primitive(
        &mut self,
        submap: SubmapId,
        direction: Direction,
        covariance: Matrix3<f64>,
        created_by: KeyframeId,
    ) -> Option<PrimitiveId> {
        let id = PrimitiveId::from_index(self.next_primitive_idx);
        let primitive =
            GlobalPrimitive { id, submap, direction, covariance, created_by, observations: Vec::new() };
        if !primitive.is_finite() {
            return None;
        }
        self.next_primitive_idx += 1;
        self.primitives.insert(id.index(), primitive);
        self.changes.primitives.insert(id);
        Some(id)
    }

    /// Enters that a vanishing point of a keyframe shows a primitive. Nothing happens if either is taken or
    /// gone.
    pub(crate) fn add_primitive_observation(&mut self, id: PrimitiveId, seen: PrimitiveObservation) -> bool {
        let vanishing = self
            .keyframe(seen.keyframe)
            .and_then(|keyframe| keyframe.vanishing.get(seen.vanishing_idx as usize));
        if vanishing.is_none_or(|vanishing| vanishing.primitive.is_some()) {
            return false;
        }
        let mut entered = false;
        self.edit_primitive(id, |primitive| {
            let position =
                primitive.observations.binary_search_by_key(&seen.keyframe, |other| other.keyframe);
            if let Err(position) = position {
                primitive.observations.insert(position, seen);
                entered = true;
            }
        });
        if entered {
            self.edit_keyframe(seen.keyframe, |keyframe| {
                keyframe.vanishing[seen.vanishing_idx as usize].primitive = Some(id);
            });
        }
        entered
    }

    /// Undoes a sighting of a primitive. The primitive stays, even without sightings.
    pub(crate) fn remove_primitive_observation(&mut self, id: PrimitiveId, keyframe_id: KeyframeId) {
        let seen_as = self.primitive(id).and_then(|primitive| primitive.observation_in(keyframe_id));
        let Some(vanishing_idx) = seen_as else { return };
        self.edit_keyframe(keyframe_id, |keyframe| {
            keyframe.vanishing[vanishing_idx as usize].primitive = None;
        });
        self.leave_primitive_observation(id, keyframe_id);
    }

    /// Takes a primitive out of the map, of every keyframe that sees it and every line that has its
    /// direction.
    pub(crate) fn remove_primitive(&mut self, id: PrimitiveId) {
        let Some(primitive) = self.primitives.remove(id.index()) else { return };
        for seen in &primitive.observations {
            self.edit_keyframe(seen.keyframe, |keyframe| {
                keyframe.vanishing[seen.vanishing_idx as usize].primitive = None;
            });
        }
        for line in self.lines_of_primitive(id) {
            self.set_line_primitive(line, None);
        }
        self.changes.primitives.remove(&id);
        self.changes.removed_primitives.insert(id);
    }

    /// Joins two primitives that are the same: `kept` takes over what `gone` was seen by. A keyframe that
    /// shows both keeps the first.
    pub(crate) fn fuse_primitives(&mut self, surviving: PrimitiveId, absorbed: PrimitiveId) {
        if surviving == absorbed || self.primitive(surviving).is_none() {
            return;
        }
        let Some(other) = self.primitive(absorbed).cloned() else { return };
        let lines = self.lines_of_primitive(absorbed);
        self.remove_primitive(absorbed);
        for seen in &other.observations {
            self.add_primitive_observation(surviving, *seen);
        }
        for line in lines {
            self.set_line_primitive(line, Some(surviving));
        }
    }

    /// Turns a primitive. What is not finite is refused.
    pub(crate) fn set_primitive_direction(
        &mut self,
        id: PrimitiveId,
        direction: Direction,
        covariance: Matrix3<f64>,
    ) {
        if covariance.iter().all(|value| value.is_finite()) {
            self.edit_primitive(id, |primitive| {
                (primitive.direction, primitive.covariance) = (direction, covariance);
            });
        }
    }

    /// The lines that have a primitive's direction.
    pub fn lines_of_primitive(&self, id: PrimitiveId) -> Vec<LineId> {
        self.lines().filter(|line| line.primitive == Some(id)).map(|line| line.id).collect()
    }

    /// Whether a primitive of the submap ties views that share no landmarks. Only then does it say something
    /// of the whole that the windows of local bundle adjustment, one after the other, were not told.
    pub(crate) fn primitives_tie_beyond_sight(&self, submap: SubmapId) -> bool {
        self.primitives().filter(|primitive| primitive.submap == submap).any(|primitive| {
            // In the order in which the keyframes were made: the ends are the least likely to share
            // anything.
            let ends = primitive.observations.first().zip(primitive.observations.last());
            let Some((first, last)) = ends.filter(|(first, last)| first.keyframe != last.keyframe) else {
                return false;
            };
            self.keyframe(last.keyframe)
                .is_some_and(|last| last.covisible().iter().all(|(id, _)| *id != first.keyframe))
        })
    }

    pub(super) fn leave_primitive_observation(&mut self, id: PrimitiveId, keyframe_id: KeyframeId) {
        self.edit_primitive(id, |primitive| {
            primitive.observations.retain(|seen| seen.keyframe != keyframe_id)
        });
    }

    pub(super) fn edit_primitive(&mut self, id: PrimitiveId, edit: impl FnOnce(&mut GlobalPrimitive)) {
        if let Some(primitive) = self.primitives.get_mut(id.index()) {
            edit(primitive);
            self.changes.primitives.insert(id);
        }
    }
}
