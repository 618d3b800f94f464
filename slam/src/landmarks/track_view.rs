//! A line segment with the keyframe that observes it.

use crate::features::LineFeature;
use crate::map::{Map, Observation};
use geometry::nalgebra::Vector3;
use geometry::{Line3, Pinhole, Pose};
use vision::GridBounds;

/// A segment in the keyframe that shows it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TrackView {
    pub seen: Observation,
    pub camera_from_world: Pose,
    pub pinhole: Pinhole,
    /// Where undistorted pixels of the image can lie.
    pub bounds: GridBounds,
    pub segment: LineFeature,
}

impl TrackView {
    /// `None` if there is no such keyframe.
    pub fn of(map: &Map, seen: Observation) -> Option<Self> {
        let keyframe = map.keyframe(seen.keyframe)?;
        Some(Self {
            seen,
            camera_from_world: keyframe.camera_from_world,
            pinhole: keyframe.features.pinhole,
            bounds: keyframe.features.bounds,
            segment: *keyframe.features.lines.get(seen.feature_idx as usize)?,
        })
    }

    /// Unit normal, in the camera, of the plane that the camera's center and the segment span.
    pub fn plane_normal(&self) -> Option<Vector3<f64>> {
        let [start, end] = [self.segment.start, self.segment.end].map(|end| self.pinhole.bearing(&end));
        start.cross(&end).try_normalize(f64::MIN_POSITIVE)
    }
}

/// The same line with its direction from the first end to the second.
pub(crate) fn directed(line: &Line3, endpoints: &[Vector3<f64>; 2]) -> Option<Line3> {
    if line.direction().dot(&(endpoints[1] - endpoints[0])) >= 0.0 {
        return Some(*line);
    }
    Line3::from_pluecker(&-line.moment(), &-line.direction())
}
