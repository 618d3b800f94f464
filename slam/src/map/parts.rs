//! Taking a stored map up again, and checking that a map is consistent.

use super::{GlobalPrimitive, Keyframe, LineLandmark, Map, MapError, MapParts, Observation};
use std::sync::Arc;

impl Map {
    /// Makes a map of its parts; covisibility is derived again.
    ///
    /// # Errors
    /// If the parts contradict one another; see [`Map::check`].
    pub fn from_parts(parts: MapParts) -> Result<Self, MapError> {
        let mut map = Map {
            next_keyframe_idx: parts.last_ids.keyframe as usize,
            next_point_idx: parts.last_ids.point as usize,
            next_line_idx: parts.last_ids.line as usize,
            next_primitive_idx: parts.last_ids.primitive as usize,
            ..Map::default()
        };
        map.removed_keyframes =
            Arc::new(parts.removed_keyframes.into_iter().map(|gone| (gone.id, gone)).collect());
        map.correction = parts.correction;
        map.is_contradicted = parts.is_contradicted;
        map.readout = parts.readout;
        for mut keyframe in parts.keyframes {
            super::calibration::adapt(&mut keyframe, &parts.correction);
            map.next_keyframe_idx = map.next_keyframe_idx.max(keyframe.id.index() + 1);
            map.keyframes.insert(keyframe.id.index(), keyframe);
        }
        for mut point in parts.points {
            map.next_point_idx = map.next_point_idx.max(point.id.index() + 1);
            point.observations.sort_unstable();
            map.points.insert(point.id.index(), point);
        }
        for mut line in parts.lines {
            map.next_line_idx = map.next_line_idx.max(line.id.index() + 1);
            line.observations.sort_unstable();
            map.lines.insert(line.id.index(), line);
        }
        for mut primitive in parts.primitives {
            map.next_primitive_idx = map.next_primitive_idx.max(primitive.id.index() + 1);
            primitive.observations.sort_unstable();
            map.primitives.insert(primitive.id.index(), primitive);
        }
        map.check()?;
        let ids: Vec<_> = map.keyframes().map(|keyframe| keyframe.id).collect();
        for id in ids {
            map.refresh_covisibility(id, crate::config::MappingConfig::default().min_covisible_points);
        }
        Ok(map)
    }

    /// What the map consists of, to be stored or to make another of.
    pub fn to_parts(&self) -> MapParts {
        MapParts {
            keyframes: self.keyframes().cloned().collect(),
            points: self.points().cloned().collect(),
            lines: self.lines().cloned().collect(),
            primitives: self.primitives().cloned().collect(),
            removed_keyframes: self.removed_keyframes().copied().collect(),
            correction: self.correction,
            is_contradicted: self.is_contradicted,
            readout: self.readout,
            last_ids: self.last_ids(),
        }
    }

    /// Whether everything refers to things that exist, both sides of each observation agree, and all is
    /// finite.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self) -> Result<(), MapError> {
        if !self.correction.leaves_a_camera() {
            return Err(MapError(format!(
                "the correction of the camera, {:?}, leaves none",
                self.correction
            )));
        }
        self.keyframes().try_for_each(|keyframe| self.check_keyframe(keyframe))?;
        self.lines().try_for_each(|line| self.check_line(line))?;
        self.primitives().try_for_each(|primitive| self.check_primitive(primitive))?;
        for point in self.points() {
            if !point.position.iter().all(|value| value.is_finite()) {
                return Err(MapError(format!("point {} has a position that is not finite", point.id)));
            }
            if point.observations.len() < 2 {
                return Err(MapError(format!(
                    "point {} is seen by {} keyframes",
                    point.id,
                    point.observations.len()
                )));
            }
            for Observation { keyframe, feature_idx } in &point.observations {
                let back = self.keyframe(*keyframe).and_then(|seen| seen.points.get(*feature_idx as usize));
                if back.copied().flatten() != Some(point.id) {
                    return Err(MapError(format!(
                        "point {} claims keypoint {feature_idx} of keyframe {keyframe}, which does not know it",
                        point.id
                    )));
                }
            }
        }
        for gone in self.removed_keyframes.values() {
            if self.camera_from_world(gone.id).is_none() {
                return Err(MapError(format!("removed keyframe {} hangs on nothing", gone.id)));
            }
        }
        Ok(())
    }

    fn check_keyframe(&self, keyframe: &Keyframe) -> Result<(), MapError> {
        let id = keyframe.id;
        if !keyframe.camera_from_world.is_finite()
            || !keyframe.local_scale.is_finite()
            || keyframe.local_scale <= 0.0
        {
            return Err(MapError(format!("keyframe {id} has a pose or a unit that is not finite")));
        }
        if keyframe.points.len() != keyframe.features.keypoints.len() {
            return Err(MapError(format!(
                "keyframe {id} has {} keypoints but {} observations",
                keyframe.features.keypoints.len(),
                keyframe.points.len()
            )));
        }
        if keyframe.parent.is_some_and(|parent| self.keyframe(parent).is_none()) {
            return Err(MapError(format!("keyframe {id} hangs on a keyframe that does not exist")));
        }
        for (feature_idx, point_id) in keyframe.observed_points() {
            let back = self.point(point_id).and_then(|point| point.observation_in(id));
            if back != Some(feature_idx as u32) {
                return Err(MapError(format!(
                    "keypoint {feature_idx} of keyframe {id} claims point {point_id}, which does not know it"
                )));
            }
        }
        if keyframe.lines.len() != keyframe.features.lines.len() {
            return Err(MapError(format!(
                "keyframe {id} has {} segments but {} observations of lines",
                keyframe.features.lines.len(),
                keyframe.lines.len()
            )));
        }
        for (feature_idx, line_id) in keyframe.observed_lines() {
            let back = self.line(line_id).and_then(|line| line.observation_in(id));
            if back != Some(feature_idx as u32) {
                return Err(MapError(format!(
                    "segment {feature_idx} of keyframe {id} claims line {line_id}, which does not know it"
                )));
            }
        }
        self.check_vanishing(keyframe)
    }

    fn check_vanishing(&self, keyframe: &Keyframe) -> Result<(), MapError> {
        let id = keyframe.id;
        for (idx, vanishing) in keyframe.vanishing.iter().enumerate() {
            if !vanishing.direction.iter().chain(vanishing.covariance.iter()).all(|value| value.is_finite()) {
                return Err(MapError(format!("vanishing point {idx} of keyframe {id} is not finite")));
            }
            if vanishing.segments.iter().any(|segment| *segment as usize >= keyframe.lines.len()) {
                return Err(MapError(format!("vanishing point {idx} of keyframe {id} names no segment")));
            }
            let Some(primitive_id) = vanishing.primitive else { continue };
            let back = self.primitive(primitive_id).and_then(|primitive| primitive.observation_in(id));
            if back != Some(idx as u32) {
                return Err(MapError(format!(
                    "vanishing point {idx} of keyframe {id} claims primitive {primitive_id}, which does not know it"
                )));
            }
        }
        Ok(())
    }

    fn check_line(&self, line: &LineLandmark) -> Result<(), MapError> {
        let id = line.id;
        if !line.is_finite() {
            return Err(MapError(format!("line {id} is not finite")));
        }
        if line.observations.len() < 2 {
            return Err(MapError(format!("line {id} is seen by {} keyframes", line.observations.len())));
        }
        for Observation { keyframe, feature_idx } in &line.observations {
            let back = self.keyframe(*keyframe).and_then(|seen| seen.lines.get(*feature_idx as usize));
            if back.copied().flatten() != Some(id) {
                return Err(MapError(format!(
                    "line {id} claims segment {feature_idx} of keyframe {keyframe}, which does not know it"
                )));
            }
        }
        if line.primitive.is_some_and(|primitive| self.primitive(primitive).is_none()) {
            return Err(MapError(format!("line {id} belongs to a primitive that does not exist")));
        }
        Ok(())
    }

    fn check_primitive(&self, primitive: &GlobalPrimitive) -> Result<(), MapError> {
        let id = primitive.id;
        if !primitive.is_finite() {
            return Err(MapError(format!("primitive {id} is not finite")));
        }
        for seen in &primitive.observations {
            let keyframe = self.keyframe(seen.keyframe);
            let back = keyframe.and_then(|keyframe| keyframe.vanishing.get(seen.vanishing_idx as usize));
            if back.and_then(|vanishing| vanishing.primitive) != Some(id) {
                return Err(MapError(format!(
                    "primitive {id} claims vanishing point {} of keyframe {}, which does not know it",
                    seen.vanishing_idx, seen.keyframe
                )));
            }
        }
        Ok(())
    }
}
