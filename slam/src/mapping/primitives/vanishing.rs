//! The vanishing points of a key frame.

use crate::config::{ConfigError, PrimitiveConfig};
use crate::map::{KeyframeId, Map, VanishingObservation};
use geometry::nalgebra::Vector3;
use vision::vanishing::{SegmentPlane, VanishingEstimator};

/// Clusters the segments of key frames.
pub(super) struct VanishingFinder {
    estimator: VanishingEstimator,
    /// Reused.
    planes: Vec<SegmentPlane>,
    /// Which segment each plane is of.
    segment_indices: Vec<u32>,
}

impl VanishingFinder {
    pub fn new(config: &PrimitiveConfig, seed: u64) -> Result<Self, ConfigError> {
        let estimator = VanishingEstimator::new(config.vanishing, seed)
            .map_err(|error| ConfigError { field: "primitives.vanishing", reason: error.to_string() })?;
        Ok(Self { estimator, planes: Vec::new(), segment_indices: Vec::new() })
    }

    /// Finds the vanishing points of a key frame and enters them; known primitives help to find theirs.
    pub fn find(&mut self, map: &mut Map, id: KeyframeId) {
        let Some(keyframe) = map.keyframe(id) else { return };
        let features = &keyframe.features;
        let focal_px = features.pinhole.mean_focal_px();
        self.planes.clear();
        self.segment_indices.clear();
        for (idx, segment) in features.lines.iter().enumerate() {
            let [start, end] = [segment.start, segment.end].map(|pixel| features.pinhole.normalised(&pixel));
            if let Some(plane) = SegmentPlane::from_normalised(&start, &end, segment.sigma_px / focal_px) {
                self.planes.push(plane);
                self.segment_indices.push(idx as u32);
            }
        }
        let known: Vec<Vector3<f64>> = map
            .primitives()
            .filter(|primitive| primitive.submap == keyframe.submap)
            .map(|primitive| keyframe.camera_from_world.rotation * primitive.direction.as_vector())
            .collect();
        let found = self.estimator.cluster(&self.planes, &known);
        let observations = found.points.into_iter().map(|point| VanishingObservation {
            direction: point.direction,
            covariance: point.covariance,
            segments: point.segments.iter().map(|idx| self.segment_indices[*idx as usize]).collect(),
            primitive: None,
        });
        let observations = observations.collect();
        map.set_vanishing(id, observations);
    }
}
