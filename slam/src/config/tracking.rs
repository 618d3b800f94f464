//! Tracking from frame to frame.

/// Tracking from frame to frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackingConfig {
    /// Radius in which a point of the last frame is looked for, pixels of its level. Default 15.
    pub motion_search_radius_px: f64,
    /// Fewer matches than this by the motion model double the radius. Default 20.
    pub min_motion_matches: usize,
    /// Fewest matches with the reference keyframe. Default 15.
    pub min_reference_matches: usize,
    /// Fewest landmarks that must agree with the first estimate of a pose. Default 6, as for a weak pose.
    pub min_first_inliers: usize,
    /// Radius in which a point of the local map is looked for, pixels of its level. Default 4.
    pub map_search_radius_px: f64,
    /// Largest angle between the direction a point was seen from and the one it is seen from now, degrees.
    /// Default 60: beyond it descriptors no longer match.
    pub max_view_angle_deg: f64,
    /// Best match's distance as a share of the second best's. Default 0.8.
    pub match_ratio: f32,
    /// Keyframes of the local map at most. Default 80.
    pub max_local_keyframes: usize,
    /// Landmarks that must agree for a good pose. Default 10: few edges and corners in general position
    /// determine a pose, and whether they do is judged by its uncertainty.
    pub min_inliers: usize,
    /// Landmarks that must agree for a weak pose; fewer and the camera is lost. Default 6: fewer
    /// agree by chance.
    pub min_weak_inliers: usize,
    /// Share of the landmarks that could be found again which a good pose needs, between `min_inliers` and
    /// `plentiful_inliers`; a weak one needs half of it. Default 0.2: true poses reach 0.3 and more, false
    /// ones 0.01.
    pub min_found_share: f64,
    /// A pose that was followed with fewer than this share of the landmarks of the frame before has to
    /// compete with poses found by descriptors alone. Default 0.6: in blur and after quick turns a wrong pose
    /// has kept half, and the right one nearly all.
    pub doubtful_kept_share: f64,
    /// How many times as many landmarks the other pose needs. Default 1.15: otherwise both are the same pose.
    pub better_pose_factor: f64,
    /// Landmarks that are enough for a good pose however many were expected, and half of it for a weak one.
    /// Default 60: in crowded places 35 have been seen to agree by chance, while blur and people in the way
    /// may hide all but some.
    pub plentiful_inliers: usize,
    /// Largest standard deviation of a good pose's attitude, degrees. Default 0.4; textured places reach
    /// 0.02.
    pub max_rotation_sigma_deg: f64,
    /// Largest standard deviation of a good pose's position, as a share of the scene's median depth. Default
    /// 0.01; textured places reach 0.0004.
    pub max_position_sigma_share: f64,
    /// How many times as uncertain as a good pose that of a keyframe may be. Default 1.5: where a camera
    /// turns from a bare wall to new texture, the pose is weak until there are landmarks, and there are none
    /// until there is a keyframe.
    pub keyframe_sigma_factor: f64,
    /// How many times as uncertain a weak pose may be; beyond it the camera is lost. Default 5.
    pub weak_sigma_factor: f64,
    /// For how long a camera that was lost is looked for where it was heading, nanoseconds. Default 0.5 s:
    /// then people have turned.
    pub max_coasting_ns: i64,
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            motion_search_radius_px: 15.0,
            min_motion_matches: 20,
            min_reference_matches: 15,
            min_first_inliers: 6,
            map_search_radius_px: 4.0,
            max_view_angle_deg: 60.0,
            match_ratio: 0.8,
            max_local_keyframes: 80,
            min_inliers: 10,
            min_weak_inliers: 6,
            min_found_share: 0.2,
            doubtful_kept_share: 0.6,
            better_pose_factor: 1.15,
            plentiful_inliers: 60,
            max_rotation_sigma_deg: 0.4,
            max_position_sigma_share: 0.01,
            keyframe_sigma_factor: 1.5,
            weak_sigma_factor: 5.0,
            max_coasting_ns: 500_000_000,
        }
    }
}
