//! The pose of one frame from the landmarks it sees, with wrong matches put aside. [ALGORITHMS 7.3]

use super::frame::TrackedFrame;
use crate::bundle::factors::PointReprojectionFactor;
use crate::features::FrameFeatures;
use crate::map::Map;
use geometry::Pose;
use geometry::nalgebra::Vector3;
use optim::{HoldSecond, Kernel, SingleOptions, UnaryGroup, chi2_95, optimize_single};

/// A keypoint and the fixed point it sees, as a term of the pose alone.
type PointSighting = HoldSecond<PointReprojectionFactor, Vector3<f64>>;

/// Places a frame by the landmarks it was matched to and drops the matches that disagree. Returns how many agree.
pub(crate) fn place_frame(frame: &mut TrackedFrame, map: &Map) -> usize {
    let mut feature_indices = Vec::with_capacity(frame.points.len());
    let mut sightings = Vec::with_capacity(frame.points.len());
    for (feature_idx, slot) in frame.points.iter_mut().enumerate() {
        let Some(id) = *slot else { continue };
        let Some(point) = map.point(id) else {
            *slot = None;
            continue;
        };
        sightings.push(sighting(&frame.features, feature_idx, point.position));
        feature_indices.push(feature_idx);
    }
    let mut points = UnaryGroup::new(Kernel::huber_95(2), chi2_95(2), sightings);
    let report =
        optimize_single::<Pose, 6>(&frame.camera_from_world, &mut [&mut points], &SingleOptions::default());
    frame.camera_from_world = report.value;
    for (feature_idx, _) in feature_indices.iter().zip(points.inliers()).filter(|(_, inlier)| !**inlier) {
        frame.points[*feature_idx] = None;
    }
    report.n_inliers
}

fn sighting(features: &FrameFeatures, feature_idx: usize, position: Vector3<f64>) -> PointSighting {
    let factor = PointReprojectionFactor {
        pinhole: features.pinhole,
        observed_px: features.undistorted[feature_idx],
        inverse_sigma: 1.0 / features.sigma_px(feature_idx),
    };
    HoldSecond { factor, second: position }
}
