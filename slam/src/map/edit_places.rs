//! Sim(3) corrections of parts of a map, and what is anchored to what was moved.
//!
//! A correction may change the scale of a part of the map. Frames of the trajectory are kept relative to
//! keyframes by others, and stay right because their offsets are in the keyframe's own [local
//! scale](Keyframe::local_scale), which follows.

use super::{FramePose, Keyframe, KeyframeId, LineId, LinePlace, Map, PointId, PrimitiveId, SubmapId};
use geometry::nalgebra::{Matrix3, SymmetricEigen, Vector3};
use geometry::{Direction, Pose, Similarity};

impl Map {
    /// The submap and the pose, `camera_from_world`, of a frame that hangs on a keyframe that is or was in
    /// the map.
    pub fn locate(&self, place: &FramePose) -> Option<(SubmapId, Pose)> {
        let (anchor, camera_from_anchor) = self.resolve(place.reference, place.camera_from_reference)?;
        Some((anchor.submap, camera_from_anchor * anchor.camera_from_world))
    }

    /// Pose of a keyframe that is or was in the map, following removed ones to what they hang on.
    pub fn camera_from_world(&self, id: KeyframeId) -> Option<Pose> {
        let (anchor, camera_from_anchor) = self.resolve(id, Pose::identity())?;
        Some(camera_from_anchor * anchor.camera_from_world)
    }

    /// The keyframe that is in the map and on which a keyframe that is or was in the map hangs: itself if
    /// it is.
    pub(crate) fn anchor_of(&self, id: KeyframeId) -> Option<&Keyframe> {
        self.resolve(id, Pose::identity()).map(|(anchor, _)| anchor)
    }

    /// Where a camera is relative to a keyframe, in the keyframe's own local scale.
    pub(crate) fn place_beside(&self, reference: KeyframeId, camera_from_world: &Pose) -> Option<FramePose> {
        let anchor = self.anchor_of(reference)?;
        let camera_from_reference = *camera_from_world * self.camera_from_world(reference)?.inverse();
        Some(FramePose {
            submap: anchor.submap,
            reference,
            camera_from_reference: at_local_scale(&camera_from_reference, 1.0 / anchor.local_scale),
        })
    }

    /// The live keyframe a place hangs on, and the place relative to it, map units.
    fn resolve(&self, id: KeyframeId, camera_from_id: Pose) -> Option<(&Keyframe, Pose)> {
        let mut camera_from_current = camera_from_id;
        let mut current = id;
        // An anchor is always older knowledge than what hangs on it, so the walk ends; the bound is for
        // safety.
        for _ in 0..=self.removed_keyframes.len() {
            if let Some(keyframe) = self.keyframe(current) {
                return Some((keyframe, at_local_scale(&camera_from_current, keyframe.local_scale)));
            }
            let removed = self.removed_keyframes.get(&current)?;
            camera_from_current = camera_from_current * removed.camera_from_anchor;
            current = removed.anchor;
        }
        None
    }

    /// Moves a keyframe as the world around it is moved by `after_from_before`. What is not finite is
    /// refused.
    pub(crate) fn move_keyframe(&mut self, id: KeyframeId, after_from_before: &Similarity) {
        let Some(keyframe) = self.keyframe(id) else { return };
        let moved = Similarity::from_pose(&keyframe.camera_from_world) * after_from_before.inverse();
        let (mut pose, local_scale) = (moved.pose_part(), keyframe.local_scale * after_from_before.scale);
        pose.rotation.renormalize();
        if pose.is_finite() && local_scale.is_finite() && local_scale > 0.0 {
            self.edit_keyframe(id, |keyframe| {
                (keyframe.camera_from_world, keyframe.local_scale) = (pose, local_scale)
            });
        }
    }

    /// Moves a point as the world around it is moved by `after_from_before`. What is not finite is refused.
    pub(crate) fn move_point(&mut self, id: PointId, after_from_before: &Similarity) {
        let Some(position) = self.point(id).map(|point| after_from_before.transform(&point.position)) else {
            return;
        };
        if position.iter().all(|value| value.is_finite()) && after_from_before.is_finite() {
            self.edit_point(id, |point| {
                point.position = position;
                point.mean_view_direction = after_from_before.rotation * point.mean_view_direction;
                point.distance_range.0 *= after_from_before.scale;
                point.distance_range.1 *= after_from_before.scale;
            });
        }
    }

    /// Moves a line as the world around it is moved by `after_from_before`. What is not finite is refused.
    pub(crate) fn move_line(&mut self, id: LineId, after_from_before: &Similarity) {
        let Some(line) = self.line(id) else { return };
        let place = LinePlace {
            line: line.line.scaled(after_from_before),
            endpoints: line.endpoints.map(|end| after_from_before.transform(&end)),
        };
        self.set_line_place(id, &place);
    }

    /// Turns a primitive to where the keyframes that see it say, after these were moved. One that none sees
    /// is turned by `otherwise`.
    pub(crate) fn realign_primitive(&mut self, id: PrimitiveId, otherwise: &Similarity) {
        let Some(primitive) = self.primitive(id) else { return };
        let seen = primitive.observations.iter().filter_map(|seen| {
            let keyframe = self.keyframe(seen.keyframe)?;
            let vanishing = keyframe.vanishing.get(seen.vanishing_idx as usize)?;
            Some(keyframe.camera_from_world.rotation.inverse() * vanishing.direction)
        });
        // The axis nearest to all the axes seen: signs do not matter.
        let scatter: Matrix3<f64> = seen.map(|direction| direction * direction.transpose()).sum();
        let axis = if scatter.trace() > 0.0 {
            let eigen = SymmetricEigen::new(scatter);
            eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()
        } else {
            otherwise.rotation * primitive.direction.as_vector()
        };
        let Some(direction) = Direction::new(axis) else { return };
        let covariance =
            turn_covariance(primitive.direction.as_vector(), direction.as_vector(), &primitive.covariance);
        self.set_primitive_direction(id, direction, covariance);
    }

    /// Makes `from` a part of `into`. Their frames of reference must be the same by now.
    pub(crate) fn rename_submap(&mut self, from: SubmapId, into: SubmapId) {
        let keyframes: Vec<KeyframeId> = self.keyframes_of(from).map(|keyframe| keyframe.id).collect();
        for id in keyframes {
            self.edit_keyframe(id, |keyframe| keyframe.submap = into);
        }
        let points: Vec<PointId> =
            self.points().filter(|point| point.submap == from).map(|point| point.id).collect();
        for id in points {
            self.edit_point(id, |point| point.submap = into);
        }
        let lines: Vec<LineId> =
            self.lines().filter(|line| line.submap == from).map(|line| line.id).collect();
        for id in lines {
            self.edit_line(id, |line| line.submap = into);
        }
        let primitives: Vec<PrimitiveId> = self
            .primitives()
            .filter(|primitive| primitive.submap == from)
            .map(|primitive| primitive.id)
            .collect();
        for id in primitives {
            self.edit_primitive(id, |primitive| primitive.submap = into);
        }
    }

    /// Turns the spanning tree of a submap so that `root` is its root, and hangs that on `parent`, a
    /// keyframe of another tree.
    pub(crate) fn hang_tree(&mut self, root: KeyframeId, parent: KeyframeId) {
        let (mut current, mut new_parent) = (root, parent);
        // Each step goes one up in the old tree; the bound is for safety.
        for _ in 0..=self.n_keyframes() {
            let old_parent = self.keyframe(current).and_then(|keyframe| keyframe.parent);
            self.edit_keyframe(current, |keyframe| keyframe.parent = Some(new_parent));
            let Some(next) = old_parent else { return };
            (current, new_parent) = (next, current);
        }
    }

    /// Whether a keyframe is another, or hangs on it in the spanning tree, however far below.
    pub(super) fn hangs_on(&self, id: KeyframeId, above: KeyframeId) -> bool {
        let mut current = Some(id);
        // Each step goes one up in the tree; the bound is for safety.
        for _ in 0..=self.n_keyframes() {
            match current {
                Some(id) if id == above => return true,
                Some(id) => current = self.keyframe(id).and_then(|keyframe| keyframe.parent),
                None => return false,
            }
        }
        false
    }

    /// Every keyframe of a submap, oldest first.
    pub fn keyframes_of(&self, submap: SubmapId) -> impl Iterator<Item = &Keyframe> {
        self.keyframes().filter(move |keyframe| keyframe.submap == submap)
    }
}

/// A pose whose lengths are read as `local_scale` map units each.
fn at_local_scale(pose: &Pose, local_scale: f64) -> Pose {
    Pose::new(pose.rotation, pose.translation * local_scale)
}

/// The covariance of a direction that was turned the shortest way.
fn turn_covariance(before: &Vector3<f64>, after: &Vector3<f64>, covariance: &Matrix3<f64>) -> Matrix3<f64> {
    let after = if before.dot(after) < 0.0 { -after } else { *after };
    let turn = geometry::nalgebra::UnitQuaternion::rotation_between(before, &after).unwrap_or_default();
    let turn = turn.to_rotation_matrix().into_inner();
    turn * covariance * turn.transpose()
}
