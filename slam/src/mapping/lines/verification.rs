//! Line verification: the three tests of Jiang et al. before a line enters the map.
//! [method: Line verification]

use crate::config::LineConfig;
use crate::landmarks::TrackView;
use crate::map::Observation;
use crate::matching::project_segment;
use crate::report::LineVerdict;
use geometry::nalgebra::{Vector2, Vector3};

/// What a test says of one view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ViewCheck {
    Passed,
    Reprojection,
    Sensitivity,
    Overlap,
}

/// Views that must each show enough of a new line. A further one that shows another part of it still confirms
/// its place.
const MIN_COVERING_VIEWS: usize = 2;

/// The views that agree with a line, or the test after which too few did.
pub(super) fn verify(
    endpoints: &[Vector3<f64>; 2],
    views: &[TrackView],
    config: &LineConfig,
) -> Result<Vec<Observation>, LineVerdict> {
    let compared: Vec<_> = views
        .iter()
        .map(|view| {
            let comparison = Comparison::of(endpoints, view);
            (
                view.seen,
                comparison.as_ref().map_or(ViewCheck::Reprojection, |it| it.verdict(config)),
                comparison,
            )
        })
        .collect();
    let n_without =
        |tests: &[ViewCheck]| compared.iter().filter(|(_, test, _)| !tests.contains(test)).count();
    if n_without(&[ViewCheck::Reprojection]) < config.min_views {
        return Err(LineVerdict::Reprojection);
    }
    if n_without(&[ViewCheck::Reprojection, ViewCheck::Sensitivity]) < config.min_views {
        return Err(LineVerdict::Sensitivity);
    }
    let passed = || compared.iter().filter(|(_, verdict, _)| *verdict == ViewCheck::Passed);
    let covers = |comparison: &Comparison| comparison.covered_share() >= config.min_covered;
    if passed().filter(|(.., comparison)| comparison.as_ref().is_some_and(covers)).count()
        < MIN_COVERING_VIEWS
    {
        return Err(LineVerdict::Overlap);
    }
    Ok(passed().map(|(seen, ..)| *seen).collect())
}

/// Tests a line, given by its ends, against a segment that should see it.
pub(crate) fn judge(endpoints: &[Vector3<f64>; 2], view: &TrackView, config: &LineConfig) -> ViewCheck {
    Comparison::of(endpoints, view).map_or(ViewCheck::Reprojection, |comparison| comparison.verdict(config))
}

/// A segment beside the projection of a line that it should see, where the image can show both: most edges go
/// on outside of it. Lengths in pixels.
struct Comparison {
    projected_length: f64,
    length: f64,
    /// Of the segment's farther end from the projection.
    end_distance: f64,
    midpoint_distance: f64,
    /// Cosine of the angle between the ray to the projection's middle and the line: 0 if it is seen squarely.
    ray_cosine: f64,
    /// What segment and projection have in common, along the segment; negative if there is a gap.
    common_length: f64,
}

impl Comparison {
    /// `None` if nothing of the line is in the image.
    fn of(endpoints: &[Vector3<f64>; 2], view: &TrackView) -> Option<Self> {
        let [projected_start, projected_end] =
            project_segment(endpoints, &view.camera_from_world, &view.pinhole, &view.bounds)?;
        let segment = &view.segment;
        let (projected, vector) = (projected_end - projected_start, segment.end - segment.start);
        let (projected_length, length) = (projected.norm(), vector.norm());
        let from_line = |pixel| {
            projected.perp(&(pixel - projected_start)).abs() / projected_length.max(f64::MIN_POSITIVE)
        };
        let projected_midpoint = (projected_start + projected_end) / 2.0;
        let ray = view.camera_from_world.rotation.inverse() * view.pinhole.bearing(&projected_midpoint);
        let in_space = (endpoints[1] - endpoints[0]).try_normalize(f64::MIN_POSITIVE)?;
        let along = |pixel: Vector2<f64>| (pixel - segment.start).dot(&vector) / length;
        let (first, second) = (along(projected_start), along(projected_end));
        Some(Self {
            projected_length,
            length,
            end_distance: f64::max(from_line(segment.start), from_line(segment.end)),
            midpoint_distance: (projected_midpoint - segment.midpoint()).norm(),
            ray_cosine: ray.dot(&in_space).abs(),
            common_length: first.max(second).min(length) - first.min(second).max(0.0),
        })
    }

    fn verdict(&self, config: &LineConfig) -> ViewCheck {
        let max_midpoint_distance =
            config.max_midpoint_distance * 0.5 * (self.projected_length + self.length);
        if self.end_distance > config.max_end_distance_px || self.midpoint_distance > max_midpoint_distance {
            return ViewCheck::Reprojection;
        }
        if self.ray_cosine > config.max_sensitivity_deg.to_radians().sin() {
            return ViewCheck::Sensitivity;
        }
        if self.common_length >= config.min_overlap * self.length.min(self.projected_length) {
            ViewCheck::Passed
        } else {
            ViewCheck::Overlap
        }
    }

    /// How much of the line's visible part the segment shows.
    fn covered_share(&self) -> f64 {
        self.common_length / self.projected_length.max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::LineFeature;
    use crate::map::KeyframeId;
    use geometry::nalgebra::UnitQuaternion;
    use geometry::{Pinhole, Pose};
    use vision::{Descriptor, GridBounds};

    /// A camera at `x` that looks along z, and the part of a line from `share[0]` to `share[1]` that it saw,
    /// `off_px` beside where it is.
    fn view(endpoints: &[Vector3<f64>; 2], x: f64, share: [f64; 2], off_px: f64) -> TrackView {
        let camera_from_world = Pose::new(UnitQuaternion::identity(), Vector3::new(-x, 0.0, 0.0));
        let pinhole = Pinhole { fx: 460.0, fy: 460.0, cx: 320.0, cy: 240.0 };
        let at = |share| {
            let point = endpoints[0].lerp(&endpoints[1], share);
            pinhole.project(&camera_from_world.transform(&point)) + Vector2::new(0.0, off_px)
        };
        TrackView {
            seen: Observation { keyframe: KeyframeId::new(1).expect("in range"), feature_idx: 0 },
            camera_from_world,
            pinhole,
            bounds: GridBounds { min_x: 0.0, min_y: 0.0, max_x: 640.0, max_y: 480.0 },
            segment: LineFeature {
                start: at(share[0]),
                end: at(share[1]),
                sigma_px: 0.4,
                descriptor: Descriptor::default(),
                track: 0,
            },
        }
    }

    fn verdict(endpoints: &[Vector3<f64>; 2], views: &[([f64; 2], f64)]) -> LineVerdict {
        let views: Vec<TrackView> = views
            .iter()
            .enumerate()
            .map(|(i, (share, off_px))| view(endpoints, 0.1 * i as f64, *share, *off_px))
            .collect();
        verify(endpoints, &views, &LineConfig::default()).err().unwrap_or(LineVerdict::Made)
    }

    #[test]
    fn an_edge_that_goes_on_outside_of_the_image_is_true() {
        // From a second view on only a fifth of it is in the image, so that the midpoints are far apart.
        let long = [Vector3::new(1.0, 0.5, 2.0), Vector3::new(8.0, 0.5, 2.0)];
        assert_eq!(
            verdict(&long, &[([0.0, 0.05], 0.0), ([0.0, 0.06], 0.0), ([0.01, 0.07], 0.0)]),
            LineVerdict::Made
        );
    }

    #[test]
    fn each_step_refuses_what_it_is_for() {
        let whole = ([0.0, 1.0], 0.0);
        let square = [Vector3::new(-0.5, 0.5, 3.0), Vector3::new(0.5, 0.5, 3.0)];
        assert_eq!(verdict(&square, &[whole, whole, whole]), LineVerdict::Made);
        assert_eq!(verdict(&square, &[whole, whole, ([0.0, 1.0], 5.0)]), LineVerdict::Reprojection);
        let end_on = [Vector3::new(0.1, 0.3, 2.0), Vector3::new(0.3, 0.9, 8.0)];
        assert_eq!(verdict(&end_on, &[whole, whole, whole]), LineVerdict::Sensitivity);
        // A view of another part confirms the place, as long as two show the same.
        let (left, right) = (([-0.5, 0.1], 0.0), ([0.95, 1.6], 0.0));
        assert_eq!(verdict(&square, &[whole, whole, left]), LineVerdict::Made);
        assert_eq!(verdict(&square, &[whole, left, right]), LineVerdict::Overlap);
        // Ends that no two views saw together: of each other's part, two show a third.
        let (first, last) = (([0.0, 0.35], 0.0), ([0.65, 1.0], 0.0));
        assert_eq!(verdict(&square, &[first, whole, last]), LineVerdict::Overlap);
        assert_eq!(verdict(&square, &[first, whole, whole]), LineVerdict::Made);
        let behind = [Vector3::new(-0.5, 0.5, -3.0), Vector3::new(0.5, 0.5, -3.0)];
        assert_eq!(verdict(&behind, &[whole, whole, whole]), LineVerdict::Reprojection);
    }
}
