//! The paper's three tests of a line before it enters the map. [paper, "Global Structure Association"]

use super::triangulation::TrackView;
use crate::config::LineConfig;
use crate::map::Observation;
use crate::report::LineVerdict;
use crate::tracking::lines::project_segment;
use geometry::nalgebra::{Vector2, Vector3};

/// What a test says of one view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    Passed,
    Reprojection,
    Sensitivity,
    Overlap,
}

/// Views that must show the same part of a line. A further one that shows another part of it still confirms its place.
const MIN_OVERLAPPING_VIEWS: usize = 2;

/// The views that agree with a line, or the test after which too few did.
pub(super) fn verify(
    endpoints: &[Vector3<f64>; 2],
    views: &[TrackView],
    config: &LineConfig,
) -> Result<Vec<Observation>, LineVerdict> {
    let verdicts: Vec<Verdict> = views.iter().map(|view| judge(endpoints, view, config)).collect();
    let mut n_left = views.len();
    for (test, n_required, refusal) in [
        (Verdict::Reprojection, config.min_views, LineVerdict::Reprojection),
        (Verdict::Sensitivity, config.min_views, LineVerdict::Sensitivity),
        (Verdict::Overlap, MIN_OVERLAPPING_VIEWS, LineVerdict::Overlap),
    ] {
        n_left -= verdicts.iter().filter(|verdict| **verdict == test).count();
        if n_left < n_required {
            return Err(refusal);
        }
    }
    let passed = views.iter().zip(&verdicts).filter(|(_, verdict)| **verdict == Verdict::Passed);
    Ok(passed.map(|(view, _)| view.seen).collect())
}

/// Tests a line, given by its ends, against a segment that should see it. Segment and projection are compared where the
/// image can show both: most edges go on outside of it.
pub(crate) fn judge(endpoints: &[Vector3<f64>; 2], view: &TrackView, config: &LineConfig) -> Verdict {
    let visible = project_segment(endpoints, &view.camera_from_world, &view.pinhole, &view.bounds);
    let Some([projected_start, projected_end]) = visible else { return Verdict::Reprojection };
    let projected = projected_end - projected_start;
    let segment = &view.segment;
    let vector = segment.end - segment.start;
    let (projected_length, length) = (projected.norm(), vector.norm());
    let from_line =
        |pixel| projected.perp(&(pixel - projected_start)).abs() / projected_length.max(f64::MIN_POSITIVE);
    let end_distance = f64::max(from_line(segment.start), from_line(segment.end));
    let projected_midpoint = (projected_start + projected_end) / 2.0;
    let midpoint_distance = (projected_midpoint - segment.midpoint()).norm();
    let max_midpoint_distance = config.max_midpoint_distance * 0.5 * (projected_length + length);
    if end_distance > config.max_end_distance_px || midpoint_distance > max_midpoint_distance {
        return Verdict::Reprojection;
    }
    // Seen squarely, ray and line are at a right angle.
    let ray = view.camera_from_world.rotation.inverse() * view.pinhole.bearing(&projected_midpoint);
    let in_space = endpoints[1] - endpoints[0];
    if ray.dot(&in_space).abs() > config.max_sensitivity_deg.to_radians().sin() * in_space.norm() {
        return Verdict::Sensitivity;
    }
    let along = |pixel: Vector2<f64>| (pixel - segment.start).dot(&vector) / length;
    let (first, second) = (along(projected_start), along(projected_end));
    let common = first.max(second).min(length) - first.min(second).max(0.0);
    if common >= config.min_overlap * length.min(projected_length) {
        Verdict::Passed
    } else {
        Verdict::Overlap
    }
}
