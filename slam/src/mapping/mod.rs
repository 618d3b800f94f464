//! Extending and tending the map, key frame by key frame.

mod culling;
mod fusion;
pub(crate) mod lines;
pub(crate) mod primitives;
pub(crate) mod stage;
mod triangulation;

pub(crate) use triangulation::median_depth;

use crate::bundle;
use crate::config::{ConfigError, SlamConfig};
use crate::map::{FrameRecord, Keyframe, KeyframeId, Map, MapUpdate, Observation, PointId, SubmapId};
use crate::tracking::Sightings;
use geometry::nalgebra::Vector3;
use lines::LineMapper;
use primitives::PrimitiveMapper;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A frame that tracking found worth keeping.
#[derive(Debug)]
pub(crate) struct NewKeyframe {
    pub keyframe: Keyframe,
    /// How often points were seen since the key frame before.
    pub sightings: Sightings,
    /// Frames of the trajectory since the key frame before.
    pub frames: Vec<FrameRecord>,
}

/// Two views and what both see, to begin a map with.
#[derive(Debug)]
pub(crate) struct InitialMap {
    pub first: Keyframe,
    pub second: Keyframe,
    /// Keypoint of the first view, keypoint of the second, position.
    pub points: Vec<(usize, usize, Vector3<f64>)>,
    pub frames: Vec<FrameRecord>,
}

/// Owns the map and extends it.
pub(crate) struct Mapper {
    config: SlamConfig,
    map: Map,
    /// Points on probation, with the key frame that made them.
    recent_points: Vec<PointId>,
    lines: LineMapper,
    /// Absent where primitives are switched off.
    primitives: Option<PrimitiveMapper>,
}

impl Mapper {
    /// # Errors
    /// If the configuration cannot be used.
    pub fn new(config: SlamConfig, map: Map) -> Result<Self, ConfigError> {
        let with_primitives = config.features.lines && config.features.global_primitives;
        let primitives = with_primitives.then(|| PrimitiveMapper::new(&config)).transpose()?;
        Ok(Self { config, map, recent_points: Vec::new(), lines: LineMapper::default(), primitives })
    }

    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Begins a map, or a further submap of it, from two views.
    pub fn begin(&mut self, initial: InitialMap) -> MapUpdate {
        let (first, second) = (initial.first.id, initial.second.id);
        self.map.add_keyframe(initial.first);
        self.map.add_keyframe(initial.second);
        for (first_idx, second_idx, position) in initial.points {
            let observations = [
                Observation { keyframe: first, feature_idx: first_idx as u32 },
                Observation { keyframe: second, feature_idx: second_idx as u32 },
            ];
            self.recent_points.extend(self.map.add_point(position, second, &observations));
        }
        self.map.refresh_covisibility(second, self.config.mapping.min_covisible_points);
        self.update(initial.frames)
    }

    /// Removes every key frame and point of a submap that came to nothing.
    pub fn discard(&mut self, submap: SubmapId) -> MapUpdate {
        self.map.remove_submap(submap);
        self.recent_points.retain(|id| self.map.point(*id).is_some());
        self.lines.forget_missing(&self.map);
        self.update(Vec::new())
    }

    /// Takes in a key frame: cull, triangulate, fuse, optimise, cull again. `publish` is shown the map as soon as it
    /// has its new points, since tracking waits for them; `abort` cuts optimisation short.
    pub fn add_keyframe(
        &mut self,
        new: NewKeyframe,
        publish: &mut dyn FnMut(&Map),
        abort: &AtomicBool,
    ) -> MapUpdate {
        let id = new.keyframe.id;
        for (point, n_visible, n_found) in new.sightings.iter() {
            self.map.count_sightings(point, n_visible, n_found);
        }
        for (line, n_visible, n_found) in new.sightings.lines() {
            self.map.count_line_sightings(line, n_visible, n_found);
        }
        self.insert(new.keyframe);
        culling::cull_recent_points(&mut self.map, &mut self.recent_points, id, &self.config.mapping);
        let made = triangulation::triangulate_with_neighbours(&mut self.map, id, &self.config.mapping);
        self.recent_points.extend(made);
        fusion::fuse_with_neighbours(&mut self.map, id, &self.config);
        self.lines.extend(&mut self.map, id, &self.config);
        if let Some(primitives) = &mut self.primitives {
            primitives.extend(&mut self.map, id, &self.config);
        }
        publish(&self.map);
        bundle::local::optimise(&mut self.map, id, &self.config, abort);
        culling::cull_keyframes(&mut self.map, id, &self.config);
        publish(&self.map);
        self.update(new.frames)
    }

    /// Adds frames to the trajectory without touching the map.
    pub fn record(&mut self, frames: Vec<FrameRecord>) -> MapUpdate {
        self.update(frames)
    }

    fn insert(&mut self, keyframe: Keyframe) {
        let id = keyframe.id;
        self.map.add_keyframe(keyframe);
        let seen: Vec<PointId> = self
            .map
            .keyframe(id)
            .into_iter()
            .flat_map(Keyframe::observed_points)
            .map(|(_, point)| point)
            .collect();
        for point in seen {
            self.map.refresh_point(point);
        }
        self.map.refresh_covisibility(id, self.config.mapping.min_covisible_points);
        let strongest =
            self.map.keyframe(id).and_then(|keyframe| keyframe.covisible().first().map(|(id, _)| *id));
        if let Some(parent) = strongest {
            self.map.set_parent(id, parent);
        }
    }

    fn update(&mut self, frames: Vec<FrameRecord>) -> MapUpdate {
        let changes = self.map.take_changes();
        debug_assert_eq!(self.map.check(), Ok(()));
        MapUpdate { map: Arc::new(self.map.clone()), changes, frames }
    }
}

/// Key frames around one, strongest ties first.
fn neighbours(map: &Map, id: KeyframeId, n: usize) -> Vec<KeyframeId> {
    map.keyframe(id).map_or(Vec::new(), |keyframe| {
        keyframe.covisible().iter().take(n).map(|(neighbour, _)| *neighbour).collect()
    })
}
