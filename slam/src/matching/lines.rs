//! Finding the map's lines among the segments of a view by where they should appear.
//! [method: Line tracking by optical flow; Pose from the last frame]

use crate::config::LineConfig;
use crate::features::{FrameFeatures, LineFeature};
use crate::map::{LineId, LineLandmark};
use geometry::nalgebra::{Vector2, Vector3};
use geometry::{Pinhole, Pose};
use vision::GridBounds;

/// Lines nearer to the camera's plane than this are cut off there, map units: the first map's median depth
/// is 1.
const NEAR: f64 = 0.01;
/// Shorter projections are not looked for, pixels: their direction is not determined.
const MIN_PROJECTED_LENGTH_PX: f64 = 15.0;
/// Pixels of distance across a line that weigh as much as one bit of the descriptors' distance.
const PIXELS_PER_BIT: f64 = 0.2;

/// Where a line should appear in a view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PredictedSegment {
    start: Vector2<f64>,
    direction: Vector2<f64>,
    length: f64,
}

impl PredictedSegment {
    /// `None` if the line is behind the camera, outside the image or seen end on.
    pub fn of(
        endpoints: &[Vector3<f64>; 2],
        camera_from_world: &Pose,
        features: &FrameFeatures,
    ) -> Option<Self> {
        let [start, end] =
            project_segment(endpoints, camera_from_world, &features.pinhole, &features.bounds)?;
        let length = (end - start).norm();
        (length >= MIN_PROJECTED_LENGTH_PX).then(|| Self { start, direction: (end - start) / length, length })
    }

    /// Distance of a pixel from the infinite line.
    pub fn distance(&self, pixel: &Vector2<f64>) -> f64 {
        self.direction.perp(&(pixel - self.start)).abs()
    }

    /// How a segment lies to this one; `None` if it runs elsewhere.
    pub fn compare(
        &self,
        segment: &LineFeature,
        radius_px: f64,
        min_cosine: f64,
        min_overlap: f64,
    ) -> Option<f64> {
        let vector = segment.end - segment.start;
        let length = vector.norm();
        // Directed: the brighter side must be the same.
        if self.direction.dot(&vector) < min_cosine * length {
            return None;
        }
        let distance = self.distance(&segment.start).max(self.distance(&segment.end));
        if distance > radius_px {
            return None;
        }
        let along = |pixel: &Vector2<f64>| self.direction.dot(&(pixel - self.start));
        let common = along(&segment.end).min(self.length) - along(&segment.start).max(0.0);
        (common >= min_overlap * length.min(self.length)).then_some(distance)
    }
}

/// Projection of the part of a segment that is in front of the camera and inside the image, pixels.
pub(crate) fn project_segment(
    endpoints: &[Vector3<f64>; 2],
    camera_from_world: &Pose,
    pinhole: &Pinhole,
    bounds: &GridBounds,
) -> Option<[Vector2<f64>; 2]> {
    let [a, b] = endpoints.map(|end| camera_from_world.transform(&end));
    let (a, b) = clip_near(a, b)?;
    clip_to_image(pinhole.project(&a), pinhole.project(&b), bounds)
}

/// The part of a segment in front of the camera.
fn clip_near(a: Vector3<f64>, b: Vector3<f64>) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let cut = |inside: Vector3<f64>, outside: Vector3<f64>| {
        outside + (inside - outside) * ((NEAR - outside.z) / (inside.z - outside.z))
    };
    match (a.z >= NEAR, b.z >= NEAR) {
        (true, true) => Some((a, b)),
        (true, false) => Some((a, cut(a, b))),
        (false, true) => Some((cut(b, a), b)),
        (false, false) => None,
    }
}

/// The part of a segment inside the image [Liang & Barsky 1984].
fn clip_to_image(a: Vector2<f64>, b: Vector2<f64>, bounds: &GridBounds) -> Option<[Vector2<f64>; 2]> {
    let (min, max) = (
        Vector2::new(f64::from(bounds.min_x), f64::from(bounds.min_y)),
        Vector2::new(f64::from(bounds.max_x), f64::from(bounds.max_y)),
    );
    let d = b - a;
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for (step, room) in [(-d.x, a.x - min.x), (d.x, max.x - a.x), (-d.y, a.y - min.y), (d.y, max.y - a.y)] {
        if step == 0.0 {
            if room < 0.0 {
                return None;
            }
        } else if step < 0.0 {
            enter = enter.max(room / step);
        } else {
            leave = leave.min(room / step);
        }
    }
    (enter < leave && d.iter().all(|value| value.is_finite())).then(|| [a + d * enter, a + d * leave])
}

/// A line, where it is expected, and how often it should be seen.
pub(crate) struct ExpectedLine<'a> {
    pub line: &'a LineLandmark,
    pub segment: PredictedSegment,
}

/// Pairs of segment and line that fit, best first, each used once. `is_free` says which segments may be
/// given.
pub(crate) fn match_lines(
    expected: &[ExpectedLine<'_>],
    features: &FrameFeatures,
    is_free: impl Fn(usize) -> bool,
    config: &LineConfig,
) -> Vec<(usize, LineId)> {
    let min_cosine = config.search_angle_deg.to_radians().cos();
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (segment_idx, segment) in features.lines.iter().enumerate().filter(|(idx, _)| is_free(*idx)) {
        for (expected_idx, candidate) in expected.iter().enumerate() {
            let fit = candidate.segment.compare(
                segment,
                config.search_radius_px,
                min_cosine,
                config.min_search_overlap,
            );
            let Some(distance_px) = fit else { continue };
            let bits = segment.descriptor.distance(&candidate.line.descriptor);
            if bits <= config.max_descriptor_distance {
                pairs.push((f64::from(bits) + distance_px / PIXELS_PER_BIT, segment_idx, expected_idx));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut segment_taken = vec![false; features.lines.len()];
    let mut line_taken = vec![false; expected.len()];
    let mut chosen = Vec::new();
    for (_, segment_idx, expected_idx) in pairs {
        if !segment_taken[segment_idx] && !line_taken[expected_idx] {
            (segment_taken[segment_idx], line_taken[expected_idx]) = (true, true);
            chosen.push((segment_idx, expected[expected_idx].line.id));
        }
    }
    chosen
}
