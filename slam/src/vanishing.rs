//! The vanishing points of a view.

use crate::config::{ConfigError, PrimitiveConfig};
use crate::features::FrameFeatures;
use crate::map::VanishingObservation;
use geometry::nalgebra::Vector3;
use vision::vanishing::{SegmentPlane, VanishingEstimator, VanishingPoint};

/// Clusters the segments of views.
pub(crate) struct VanishingFinder {
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

    /// The vanishing points of a view's segments. Directions known to be there, in the camera's frame, help
    /// to find theirs.
    pub fn find(&mut self, features: &FrameFeatures, known: &[Vector3<f64>]) -> Vec<VanishingObservation> {
        self.planes.clear();
        self.segment_indices.clear();
        for idx in 0..features.lines.len() {
            if let Some(plane) = features.segment_plane(idx) {
                self.planes.push(plane);
                self.segment_indices.push(idx as u32);
            }
        }
        let found = self.estimator.cluster(&self.planes, known);
        let observation = |point: VanishingPoint| VanishingObservation {
            direction: point.direction,
            covariance: point.covariance,
            segments: point.segments.iter().map(|idx| self.segment_indices[*idx as usize]).collect(),
            primitive: None,
        };
        found.points.into_iter().map(observation).collect()
    }
}
