//! Line triangulation: a 3D line from the segments of one track.
//! [method: Line triangulation; Degenerate lines]

use super::verification::verify;
use crate::bundle::anchored_line::AnchoredLine;
use crate::bundle::factors::LineReprojectionFactor;
use crate::config::LineConfig;
use crate::landmarks::{TrackView, directed, seen_part};
use crate::map::{LinePlace, Observation};
use crate::report::LineVerdict;
use geometry::nalgebra::{Matrix4, Vector2, Vector3, Vector4};
use geometry::{Line3, OrthonormalLine, Pose, line};
use optim::{Factor, Kernel, Linearized, SingleOptions, UnaryGroup, chi2_95, optimize_single};

/// Step of the difference quotients that lead from a line's parameters to depths, radians.
const DIFFERENCE_STEP: f64 = 1e-6;

/// A line's reprojection with the camera held where it is.
struct HeldPose {
    camera_from_world: Pose,
    factor: LineReprojectionFactor,
}

impl HeldPose {
    fn new(view: &TrackView, anchored: &AnchoredLine) -> Self {
        let factor = anchored.factor(view.pinhole, &view.segment);
        Self { camera_from_world: view.camera_from_world, factor }
    }
}

impl Factor for HeldPose {
    type Residual = Vector2<f64>;
    type Variables = (OrthonormalLine,);

    fn residual(&self, (line,): (&OrthonormalLine,)) -> Option<Vector2<f64>> {
        self.factor.residual((&self.camera_from_world, line))
    }

    fn linearize(&self, (line,): (&OrthonormalLine,)) -> Option<Linearized<Self>> {
        let (residual, (_, d_residual_d_line)) = self.factor.linearize((&self.camera_from_world, line))?;
        Some((residual, (d_residual_d_line,)))
    }
}

/// What came of a track: a place in space, the verdict on it, and the views that agree if it is to be made.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub place: LinePlace,
    pub outcome: Result<Vec<Observation>, LineVerdict>,
}

/// The line that a track's views agree on and whether it may enter the map. `None` if the track has no place
/// in space yet: too few views, or no two whose planes are far enough apart.
pub(super) fn triangulate(
    views: &[TrackView],
    median_depth: Option<f64>,
    config: &LineConfig,
) -> Option<Candidate> {
    if views.len() < config.min_views {
        return None;
    }
    let (first, second) = best_pair(views, config.min_plane_angle_deg)?;
    let line = line::triangulate(
        &first.camera_from_world,
        &first.plane_normal()?,
        &second.camera_from_world,
        &second.plane_normal()?,
    )?;
    let rough = LinePlace { line, endpoints: seen_part(&line, &[*first, *second])? };
    let (line, depth_sigma_share) = refine(&rough, views)?;
    let endpoints = seen_part(&line, views)?;
    let place = LinePlace { line: directed(&line, &endpoints)?, endpoints };
    let depth = first.camera_from_world.transform(&place.middle()).z;
    let outcome = if depth_sigma_share > config.max_depth_sigma_share {
        Err(LineVerdict::UncertainDepth)
    } else if median_depth.is_some_and(|median| depth > config.max_depth_share * median) {
        Err(LineVerdict::TooFar)
    } else {
        verify(&place.endpoints, views, config)
    };
    Some(Candidate { place, outcome })
}

/// The two views whose planes cross at the largest angle; `None` if that is below the least.
fn best_pair(views: &[TrackView], min_angle_deg: f64) -> Option<(&TrackView, &TrackView)> {
    let normal = |view: &TrackView| {
        view.plane_normal().map(|normal| view.camera_from_world.rotation.inverse() * normal)
    };
    let normals: Vec<Vector3<f64>> = views.iter().map(|view| normal(view).unwrap_or_default()).collect();
    let mut best = (min_angle_deg.to_radians().sin(), None);
    for (i, first) in normals.iter().enumerate() {
        for (j, second) in normals.iter().enumerate().skip(i + 1) {
            let sine = first.cross(second).norm();
            if sine > best.0 {
                best = (sine, Some((&views[i], &views[j])));
            }
        }
    }
    best.1
}

/// The line that agrees best with every view, poses held, and the standard deviation of its depth at the seen
/// ends as a share of the depth. Large where the planes of all views nearly coincide: then nothing is known
/// along the rays.
fn refine(rough: &LinePlace, views: &[TrackView]) -> Option<(Line3, f64)> {
    let anchored = AnchoredLine::new(rough)?;
    let factors = views.iter().map(|view| HeldPose::new(view, &anchored)).collect();
    let mut group = UnaryGroup::new(Kernel::huber_95(2), chi2_95(2), factors);
    let report =
        optimize_single::<OrthonormalLine, 4>(&anchored.line, &mut [&mut group], &SingleOptions::default());
    let line = anchored.line_in_world(&report.value)?;
    let covariance = report.information.try_inverse()?;
    let view = views.first()?;
    let share = [view.segment.start, view.segment.end]
        .map(|pixel| depth_sigma_share(&anchored, &report.value, &covariance, view, &pixel))
        .into_iter()
        .try_fold(0.0f64, |worst, share| Some(worst.max(share?)))?;
    Some((line, share))
}

/// Standard deviation of the depth at which a view's ray meets the line, as a share of that depth.
fn depth_sigma_share(
    anchored: &AnchoredLine,
    line: &OrthonormalLine,
    covariance: &Matrix4<f64>,
    view: &TrackView,
    pixel: &Vector2<f64>,
) -> Option<f64> {
    let ray = view.camera_from_world.rotation.inverse() * view.pinhole.bearing(pixel);
    let center = view.camera_from_world.center();
    let distance = |line: &OrthonormalLine| {
        let line = anchored.line_in_world(line)?;
        Some((line.at(line.parameter_nearest_to_ray(&center, &ray)?) - center).dot(&ray))
    };
    let at = distance(line)?;
    let mut gradient = Vector4::zeros();
    for axis in 0..4 {
        let step = Vector4::ith(axis, DIFFERENCE_STEP);
        gradient[axis] = (distance(&line.retract(&step))? - at) / DIFFERENCE_STEP;
    }
    let variance = gradient.dot(&(covariance * gradient));
    (at > 0.0 && variance >= 0.0).then(|| variance.sqrt() / at)
}
