//! Taking a stored map up again, and checking that a map is consistent.

use super::{Keyframe, Map, MapError, MapParts, Observation};
use std::sync::Arc;

impl Map {
    /// Makes a map of its parts; covisibility is derived again.
    ///
    /// # Errors
    /// If the parts contradict one another; see [`Map::check`].
    pub fn from_parts(parts: MapParts) -> Result<Self, MapError> {
        let mut map = Map {
            next_keyframe_idx: parts.last_keyframe_id as usize,
            next_point_idx: parts.last_point_id as usize,
            ..Map::default()
        };
        map.removed_keyframes =
            Arc::new(parts.removed_keyframes.into_iter().map(|gone| (gone.id, gone)).collect());
        for keyframe in parts.keyframes {
            map.next_keyframe_idx = map.next_keyframe_idx.max(keyframe.id.index() + 1);
            map.keyframes.insert(keyframe.id.index(), keyframe);
        }
        for mut point in parts.points {
            map.next_point_idx = map.next_point_idx.max(point.id.index() + 1);
            point.observations.sort_unstable();
            map.points.insert(point.id.index(), point);
        }
        map.check()?;
        let ids: Vec<_> = map.keyframes().map(|keyframe| keyframe.id).collect();
        for id in ids {
            map.refresh_covisibility(id, crate::config::MappingConfig::default().min_covisible_points);
        }
        Ok(map)
    }

    /// Whether everything refers to things that exist, both sides of each observation agree, and all is finite.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self) -> Result<(), MapError> {
        self.keyframes().try_for_each(|keyframe| self.check_keyframe(keyframe))?;
        for point in self.points() {
            if !point.position.iter().all(|value| value.is_finite()) {
                return Err(MapError(format!("point {} has a position that is not finite", point.id)));
            }
            if point.observations.len() < 2 {
                return Err(MapError(format!(
                    "point {} is seen by {} key frames",
                    point.id,
                    point.observations.len()
                )));
            }
            for Observation { keyframe, feature_idx } in &point.observations {
                let back = self.keyframe(*keyframe).and_then(|seen| seen.points.get(*feature_idx as usize));
                if back.copied().flatten() != Some(point.id) {
                    return Err(MapError(format!(
                        "point {} claims keypoint {feature_idx} of key frame {keyframe}, which does not know it",
                        point.id
                    )));
                }
            }
        }
        for gone in self.removed_keyframes.values() {
            if self.camera_from_world(gone.id).is_none() {
                return Err(MapError(format!("removed key frame {} hangs on nothing", gone.id)));
            }
        }
        Ok(())
    }

    fn check_keyframe(&self, keyframe: &Keyframe) -> Result<(), MapError> {
        let id = keyframe.id;
        if !keyframe.camera_from_world.is_finite() {
            return Err(MapError(format!("key frame {id} has a pose that is not finite")));
        }
        if keyframe.points.len() != keyframe.features.keypoints.len() {
            return Err(MapError(format!(
                "key frame {id} has {} keypoints but {} observations",
                keyframe.features.keypoints.len(),
                keyframe.points.len()
            )));
        }
        if keyframe.parent.is_some_and(|parent| self.keyframe(parent).is_none()) {
            return Err(MapError(format!("key frame {id} hangs on a key frame that does not exist")));
        }
        for (feature_idx, point_id) in keyframe.observed_points() {
            let back = self.point(point_id).and_then(|point| point.observation_in(id));
            if back != Some(feature_idx as u32) {
                return Err(MapError(format!(
                    "keypoint {feature_idx} of key frame {id} claims point {point_id}, which does not know it"
                )));
            }
        }
        Ok(())
    }
}
