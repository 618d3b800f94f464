//! Triangulation of map points from keypoints that two keyframes see and no landmark explains.
//! [method: Point triangulation]

use super::neighbors;
use crate::config::MappingConfig;
use crate::features::FrameFeatures;
use crate::map::{Keyframe, KeyframeId, Map, Observation, PointId, median_depth};
use geometry::nalgebra::{Matrix3, Vector3};
use geometry::{Pose, so3, triangulation};
use optim::chi2_95;
use vision::matching::{RotationConsistency, STRICT_DISTANCE, nearest_two};

/// The ratio of a point's distances may differ from that of the levels it was found at by this times one
/// level.
const SCALE_TOLERANCE: f64 = 1.5;
/// Keypoints this near to the epipole constrain no depth, pixels of their level.
const EPIPOLE_MARGIN_PX: f64 = 10.0;

/// Makes points with the keyframe's neighbors. Returns their ids.
pub(super) fn triangulate_with_neighbors(
    map: &mut Map,
    id: KeyframeId,
    config: &MappingConfig,
) -> Vec<PointId> {
    let mut made = Vec::new();
    for neighbor in neighbors(map, id, config.n_triangulation_neighbors) {
        let candidates = match (map.keyframe(id), map.keyframe(neighbor)) {
            (Some(current), Some(neighbor)) => {
                PairSearch::new(current, neighbor, map, config).map(PairSearch::run)
            }
            _ => None,
        };
        for (current_idx, neighbor_idx, position) in candidates.unwrap_or_default() {
            let observations = [
                Observation { keyframe: id, feature_idx: current_idx as u32 },
                Observation { keyframe: neighbor, feature_idx: neighbor_idx as u32 },
            ];
            made.extend(map.add_point(position, id, &observations));
        }
    }
    made
}

/// The search for new points in one pair of keyframes.
struct PairSearch<'a> {
    current: &'a Keyframe,
    neighbor: &'a Keyframe,
    /// `x_neighborᵀ F x_current = 0`, pixels.
    fundamental: Matrix3<f64>,
    neighbor_from_current: Pose,
    /// Depths in the current view between which points are looked for, map units.
    depth_range: (f64, f64),
    /// The neighbor's keypoints that no landmark explains.
    free: Vec<FreeKeypoint>,
    config: &'a MappingConfig,
}

/// A keypoint without a landmark, packed for the scan along epipolar lines.
#[derive(Clone, Copy)]
struct FreeKeypoint {
    x: f32,
    y: f32,
    /// Largest squared distance from the line, pixels squared.
    max_squared_distance: f32,
    idx: u32,
}

impl<'a> PairSearch<'a> {
    /// `None` if the baseline is too short for the depth of the scene.
    fn new(
        current: &'a Keyframe,
        neighbor: &'a Keyframe,
        map: &Map,
        config: &'a MappingConfig,
    ) -> Option<Self> {
        let neighbor_from_current = neighbor.camera_from_world * current.camera_from_world.inverse();
        let median_depth = median_depth(map, neighbor)?;
        if neighbor_from_current.translation.norm() < config.min_baseline_share * median_depth {
            return None;
        }
        let essential =
            so3::skew(&neighbor_from_current.translation) * neighbor_from_current.rotation_matrix();
        let fundamental = neighbor.features.pinhole.inverse_matrix().transpose()
            * essential
            * current.features.pinhole.inverse_matrix();
        let center = neighbor_from_current.translation;
        let epipole = (center.z > 0.0).then(|| neighbor.features.pinhole.project(&center));
        // Nearer than a tenth of the baseline is behind a finger; farther than the least parallax allows is
        // noise.
        let baseline = center.norm();
        let depth_range = (0.1 * baseline, baseline / config.min_parallax_deg.to_radians() * 2.0);
        let free = (0..neighbor.features.len())
            .filter(|idx| neighbor.points[*idx].is_none())
            .filter_map(|idx| {
                let pixel = neighbor.features.undistorted[idx];
                let sigma = neighbor.features.sigma_px(idx);
                let near_epipole = epipole.is_some_and(|at| (pixel - at).norm() < EPIPOLE_MARGIN_PX * sigma);
                (!near_epipole).then_some(FreeKeypoint {
                    x: pixel.x as f32,
                    y: pixel.y as f32,
                    max_squared_distance: (chi2_95(1) * sigma * sigma) as f32,
                    idx: idx as u32,
                })
            })
            .collect();
        Some(Self { current, neighbor, fundamental, neighbor_from_current, depth_range, free, config })
    }

    /// Keypoint of the current view, keypoint of the neighbor, position in the world.
    fn run(self) -> Vec<(usize, usize, Vector3<f64>)> {
        let mut claims: Vec<Option<(u32, usize)>> = vec![None; self.neighbor.features.len()];
        for current_idx in (0..self.current.features.len()).filter(|idx| self.current.points[*idx].is_none())
        {
            let Some((distance, neighbor_idx)) = self.best_match(current_idx) else { continue };
            if claims[neighbor_idx].is_none_or(|(claimed, _)| distance < claimed) {
                claims[neighbor_idx] = Some((distance, current_idx));
            }
        }
        let angle = |features: &FrameFeatures, idx: usize| features.keypoints[idx].angle;
        let pairs: Vec<(usize, usize, f32)> = claims
            .iter()
            .enumerate()
            .filter_map(|(neighbor_idx, claim)| {
                let (_, current_idx) = (*claim)?;
                let change =
                    angle(&self.neighbor.features, neighbor_idx) - angle(&self.current.features, current_idx);
                Some((current_idx, neighbor_idx, change))
            })
            .collect();
        let mut rotation = RotationConsistency::new();
        pairs.iter().for_each(|(_, _, change)| rotation.add(*change));
        let dominant = rotation.dominant();
        let consistent = pairs.into_iter().filter(|(_, _, change)| dominant.accepts(*change));
        consistent.filter_map(|(a, b, _)| Some((a, b, self.triangulate(a, b)?))).collect()
    }

    /// The unexplained keypoint of the neighbor that looks most alike, along the epipolar segment of a
    /// keypoint.
    fn best_match(&self, current_idx: usize) -> Option<(u32, usize)> {
        let descriptor = &self.current.features.descriptors[current_idx];
        let pixel = &self.current.features.undistorted[current_idx];
        let line = self.fundamental * Vector3::new(pixel.x, pixel.y, 1.0);
        let line = line / line.xy().norm();
        let (a, b, c) = (line.x as f32, line.y as f32, line.z as f32);
        let is_near = |free: &&FreeKeypoint| {
            let from_line = a * free.x + b * free.y + c;
            from_line * from_line <= free.max_squared_distance
        };
        let described =
            |free: &FreeKeypoint| (free.idx as usize, &self.neighbor.features.descriptors[free.idx as usize]);
        let (best, second) = nearest_two(descriptor, self.free.iter().filter(is_near).map(described));
        if best.0 > STRICT_DISTANCE {
            return None;
        }
        let unique = second == u32::MAX || best.0 as f32 <= self.config.match_ratio * second as f32;
        (best.1 != usize::MAX && unique).then_some(best)
    }

    /// The point two keypoints see, if it passes every test.
    fn triangulate(&self, current_idx: usize, neighbor_idx: usize) -> Option<Vector3<f64>> {
        let (current, neighbor) = (&self.current.features, &self.neighbor.features);
        let (pixel_a, pixel_b) = (&current.undistorted[current_idx], &neighbor.undistorted[neighbor_idx]);
        let bearing_a = current.pinhole.bearing(pixel_a);
        let bearing_b = neighbor.pinhole.bearing(pixel_b);
        let a_from_world = &self.current.camera_from_world;
        let b_from_world = &self.neighbor.camera_from_world;
        let ray_b_in_a = self.neighbor_from_current.rotation.inverse() * bearing_b;
        if bearing_a.dot(&ray_b_in_a) > self.config.min_parallax_deg.to_radians().cos() {
            return None;
        }
        let point = triangulation::two_view(a_from_world, &bearing_a, b_from_world, &bearing_b)?;
        let (in_a, in_b) = (a_from_world.transform(&point), b_from_world.transform(&point));
        if in_a.z < self.depth_range.0 || in_a.z > self.depth_range.1 || in_b.z <= 0.0 {
            return None;
        }
        let reprojects = |features: &FrameFeatures, idx: usize, in_camera: &Vector3<f64>| {
            let sigma = features.sigma_px(idx);
            let error = features.pinhole.project(in_camera) - features.undistorted[idx];
            error.norm_squared() <= chi2_95(2) * sigma * sigma
        };
        if !reprojects(current, current_idx, &in_a) || !reprojects(neighbor, neighbor_idx, &in_b) {
            return None;
        }
        // Seen from twice the distance a point appears twice as small: levels and distances must agree.
        let distance_ratio = in_b.norm() / in_a.norm();
        let scale_ratio = current.sigma_px(current_idx) / neighbor.sigma_px(neighbor_idx);
        let tolerance = SCALE_TOLERANCE * current.pyramid.scale_factor;
        let agreement = distance_ratio / scale_ratio;
        (agreement < tolerance && agreement > 1.0 / tolerance).then_some(point)
    }
}
