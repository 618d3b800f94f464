//! The paper's three tests of a line before it enters the map. [paper, "Global Structure Association"]

use super::triangulation::TrackView;
use crate::config::LineConfig;
use geometry::nalgebra::Vector3;

/// How many candidates each test turned away, and how many passed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Verification {
    /// Views that agreed.
    pub n_passed: usize,
    /// Views turned away for the distance of projection and segment.
    pub n_reprojection: usize,
    /// Views turned away for seeing the line nearly end on.
    pub n_sensitivity: usize,
    /// Views turned away for showing another part of the line.
    pub n_overlap: usize,
}

/// What a test says of one view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    Passed,
    Reprojection,
    Sensitivity,
    Overlap,
}

impl Verification {
    /// Whether a view agrees with a line; counts the verdict.
    pub fn check(&mut self, endpoints: &[Vector3<f64>; 2], view: &TrackView, config: &LineConfig) -> bool {
        let verdict = judge(endpoints, view, config);
        match verdict {
            Verdict::Passed => self.n_passed += 1,
            Verdict::Reprojection => self.n_reprojection += 1,
            Verdict::Sensitivity => self.n_sensitivity += 1,
            Verdict::Overlap => self.n_overlap += 1,
        }
        verdict == Verdict::Passed
    }
}

/// Tests a line, given by its ends, against a segment that should see it.
pub(crate) fn judge(endpoints: &[Vector3<f64>; 2], view: &TrackView, config: &LineConfig) -> Verdict {
    let [start, end] = endpoints.map(|end| view.camera_from_world.transform(&end));
    if start.z <= 0.0 || end.z <= 0.0 {
        return Verdict::Reprojection;
    }
    let (projected_start, projected_end) = (view.pinhole.project(&start), view.pinhole.project(&end));
    let projected = projected_end - projected_start;
    let segment = &view.segment;
    let from_line =
        |pixel| projected.perp(&(pixel - projected_start)).abs() / projected.norm().max(f64::MIN_POSITIVE);
    let end_distance = f64::max(from_line(segment.start), from_line(segment.end));
    let midpoint_distance = ((projected_start + projected_end) / 2.0 - segment.midpoint()).norm();
    if end_distance > config.max_end_distance_px || midpoint_distance > config.max_midpoint_distance_px {
        return Verdict::Reprojection;
    }
    // Seen squarely, ray and line are at a right angle.
    let ray = view.pinhole.bearing(&((projected_start + projected_end) / 2.0));
    let cosine = ray.dot(&(end - start)).abs() / (end - start).norm();
    if cosine > config.max_sensitivity_deg.to_radians().sin() {
        return Verdict::Sensitivity;
    }
    let vector = segment.end - segment.start;
    let share = |pixel: geometry::nalgebra::Vector2<f64>| {
        (pixel - segment.start).dot(&vector) / vector.norm_squared()
    };
    let (first, second) = (share(projected_start), share(projected_end));
    let overlap = first.max(second).min(1.0) - first.min(second).max(0.0);
    if overlap >= config.min_overlap { Verdict::Passed } else { Verdict::Overlap }
}
