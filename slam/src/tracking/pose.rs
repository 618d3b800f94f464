//! The pose of one frame from the landmarks it sees, with wrong matches put aside. [ALGORITHMS 7.3]

use super::frame::{Inliers, TrackedFrame};
use crate::bundle::anchored_line::AnchoredLine;
use crate::bundle::factors::{LineReprojectionFactor, PointReprojectionFactor};
use crate::features::FrameFeatures;
use crate::map::Map;
use geometry::nalgebra::Vector3;
use geometry::{OrthonormalLine, Pose};
use optim::{HoldSecond, Kernel, SingleOptions, UnaryGroup, chi2_95, optimize_single};

/// A keypoint and the fixed point it sees, as a term of the pose alone.
type PointSighting = HoldSecond<PointReprojectionFactor, Vector3<f64>>;
/// A segment and the fixed line it sees, likewise.
type LineSighting = HoldSecond<LineReprojectionFactor, OrthonormalLine>;

/// Places a frame by the landmarks it was matched to and drops the matches that disagree. Returns how many agree.
pub(crate) fn place_frame(frame: &mut TrackedFrame, map: &Map) -> Inliers {
    let (mut point_slots, mut points) = (Vec::with_capacity(frame.points.len()), Vec::new());
    for (feature_idx, slot) in frame.points.iter_mut().enumerate() {
        let Some(id) = *slot else { continue };
        let Some(point) = map.point(id) else {
            *slot = None;
            continue;
        };
        points.push(point_sighting(&frame.features, feature_idx, point.position));
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
        lines.push(LineSighting { factor, second: line.line });
        line_slots.push(feature_idx);
    }
    let mut points = UnaryGroup::new(Kernel::huber_95(2), chi2_95(2), points);
    let mut lines = UnaryGroup::new(Kernel::huber_95(2), chi2_95(2), lines);
    let report = optimize_single::<Pose, 6>(
        &frame.camera_from_world,
        &mut [&mut points, &mut lines],
        &SingleOptions::default(),
    );
    frame.camera_from_world = report.value;
    for (feature_idx, _) in point_slots.iter().zip(points.inliers()).filter(|(_, inlier)| !**inlier) {
        frame.points[*feature_idx] = None;
    }
    for (feature_idx, _) in line_slots.iter().zip(lines.inliers()).filter(|(_, inlier)| !**inlier) {
        frame.lines[*feature_idx] = None;
    }
    Inliers { n_points: points.n_inliers(), n_lines: lines.n_inliers() }
}

fn point_sighting(features: &FrameFeatures, feature_idx: usize, position: Vector3<f64>) -> PointSighting {
    let factor = PointReprojectionFactor {
        pinhole: features.pinhole,
        observed_px: features.undistorted[feature_idx],
        inverse_sigma: 1.0 / features.sigma_px(feature_idx),
    };
    HoldSecond { factor, second: position }
}
