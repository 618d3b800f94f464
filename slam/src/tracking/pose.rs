//! Pose-only optimization: the pose of one frame from the landmarks it observes, outliers left out.
//! [method: Pose-only optimization]

use super::frame::{Inliers, TrackedFrame};
use crate::bundle::anchored_line::AnchoredLine;
use crate::bundle::factors::{LineReprojectionFactor, PointReprojectionFactor, VanishingReprojectionFactor};
use crate::bundle::scatter::segment_sigma_factor;
use crate::config::PrimitiveConfig;
use crate::features::{FrameFeatures, LineFeature};
use crate::map::{Map, PrimitiveId};
use crate::report::PoseUncertainty;
use geometry::nalgebra::{Matrix6, Vector3};
use geometry::{Direction, OrthonormalLine, Pose};
use optim::{HoldSecond, Kernel, SingleOptions, UnaryGroup, chi2_95, optimize_single};
use std::collections::{BTreeMap, BTreeSet};

/// A keypoint and the fixed point it sees, as a term of the pose alone.
type PointObservation = HoldSecond<PointReprojectionFactor, Vector3<f64>>;
/// A segment and the fixed line it sees, likewise.
type LineObservation = HoldSecond<LineReprojectionFactor, OrthonormalLine>;

/// A segment and the fixed direction it runs along, likewise.
type VanishingObservation = HoldSecond<VanishingReprojectionFactor, Direction>;

/// A frame's pose as its landmarks determine it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    /// Landmarks that agree with the pose.
    pub inliers: Inliers,
    /// How well they determine it.
    pub uncertainty: PoseUncertainty,
    /// Inverse of its covariance, in the pose's tangent: turn, then shift.
    pub information: Matrix6<f64>,
}

/// Places a frame by the landmarks it was matched to and by the primitives its segments run along, and drops
/// the matches that disagree.
pub(crate) fn place_frame(frame: &mut TrackedFrame, map: &Map, config: &PrimitiveConfig) -> Placement {
    let (mut point_slots, mut points) = (Vec::with_capacity(frame.points.len()), Vec::new());
    for (feature_idx, slot) in frame.points.iter_mut().enumerate() {
        let Some(id) = *slot else { continue };
        let Some(point) = map.point(id) else {
            *slot = None;
            continue;
        };
        points.push(point_observation(&frame.features, feature_idx, point.position));
        point_slots.push(feature_idx);
    }
    let (mut line_slots, mut lines) = (Vec::with_capacity(frame.lines.len()), Vec::new());
    for (feature_idx, slot) in frame.lines.iter_mut().enumerate() {
        let Some(id) = *slot else { continue };
        let Some(line) = map.line(id).and_then(AnchoredLine::of) else {
            *slot = None;
            continue;
        };
        let factor = line.factor(frame.features.pinhole, &frame.features.lines[feature_idx]);
        lines.push(LineObservation { factor, second: line.line });
        line_slots.push(feature_idx);
    }
    let mut points = UnaryGroup::new(Kernel::huber_95(2), chi2_95(2), points);
    let mut lines = UnaryGroup::new(Kernel::huber_95(2), chi2_95(2), lines);
    let directions = vanishing_observations(frame, map, config);
    let mut directions = UnaryGroup::new(Kernel::huber_95(1), chi2_95(1), directions);
    let report = optimize_single::<Pose, 6>(
        &frame.camera_from_world,
        &mut [&mut points, &mut lines, &mut directions],
        &SingleOptions::default(),
    );
    frame.camera_from_world = report.value;
    for (feature_idx, _) in point_slots.iter().zip(points.inliers()).filter(|(_, inlier)| !**inlier) {
        frame.points[*feature_idx] = None;
    }
    for (feature_idx, _) in line_slots.iter().zip(lines.inliers()).filter(|(_, inlier)| !**inlier) {
        frame.lines[*feature_idx] = None;
    }
    Placement {
        inliers: Inliers { n_points: points.n_inliers(), n_lines: lines.n_inliers() },
        uncertainty: uncertainty_of(&report.information, median_depth(frame, map)),
        information: report.information,
    }
}

fn vanishing_observations(
    frame: &TrackedFrame,
    map: &Map,
    config: &PrimitiveConfig,
) -> Vec<VanishingObservation> {
    let shown: BTreeSet<PrimitiveId> = frame.primitives.iter().flatten().copied().collect();
    let known: BTreeMap<PrimitiveId, (Direction, f64)> = shown
        .into_iter()
        .filter_map(|id| map.primitive(id))
        .map(|primitive| (primitive.id, (primitive.direction, segment_sigma_factor(map, primitive, config))))
        .collect();
    let segments = frame.features.lines.iter().zip(&frame.primitives);
    let sighting = |(segment, id): (&LineFeature, &Option<PrimitiveId>)| {
        let (direction, sigma_factor) = known.get(&(*id)?)?;
        let factor = VanishingReprojectionFactor::of(frame.features.pinhole, segment, *sigma_factor);
        Some(HoldSecond { factor, second: *direction })
    };
    segments.filter_map(sighting).collect()
}

/// Standard deviations from the information on a pose, whose tangent is the turn, then the shift, of the
/// camera.
fn uncertainty_of(information: &Matrix6<f64>, depth: f64) -> PoseUncertainty {
    let Some(covariance) = information.try_inverse() else { return PoseUncertainty::UNDETERMINED };
    let worst = |corner: usize| {
        let block = covariance.fixed_view::<3, 3>(corner, corner).into_owned();
        let variance = block.symmetric_eigenvalues().max();
        if variance.is_finite() && variance >= 0.0 { variance.sqrt() } else { f64::INFINITY }
    };
    PoseUncertainty { rotation_rad: worst(0), position_share: worst(3) / depth }
}

/// Median depth of the landmarks a frame sees; zero where it sees none.
fn median_depth(frame: &TrackedFrame, map: &Map) -> f64 {
    let points = frame.points.iter().flatten().filter_map(|id| map.point(*id)).map(|point| point.position);
    let lines = frame.lines.iter().flatten().filter_map(|id| map.line(*id));
    let middles = lines.map(|line| (line.endpoints[0] + line.endpoints[1]) / 2.0);
    let mut depths: Vec<f64> =
        points.chain(middles).map(|position| frame.camera_from_world.transform(&position).z).collect();
    if depths.is_empty() {
        return 0.0;
    }
    let middle = depths.len() / 2;
    *depths.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn point_observation(
    features: &FrameFeatures,
    feature_idx: usize,
    position: Vector3<f64>,
) -> PointObservation {
    let factor = PointReprojectionFactor {
        pinhole: features.pinhole,
        observed_px: features.undistorted[feature_idx],
        inverse_sigma: 1.0 / features.sigma_px(feature_idx),
    };
    HoldSecond { factor, second: position }
}
