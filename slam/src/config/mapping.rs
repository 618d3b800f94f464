//! Local mapping: extending and maintaining the map.

/// Local mapping: extending and maintaining the map.
#[derive(Clone, Debug, PartialEq)]
pub struct MappingConfig {
    /// Shared points that make two keyframes neighbors. Default 15.
    pub min_covisible_points: u32,
    /// Neighbors with which new points are triangulated. Default 20.
    pub n_triangulation_neighbors: usize,
    /// Baseline as a share of the scene's median depth below which no point is made. Default 0.01.
    pub min_baseline_share: f64,
    /// Parallax below which no point is made, degrees. Default 0.7: half a pixel of error is then a tenth of
    /// the depth at usual focal lengths, and turning slowly past a bare wall gives no more.
    pub min_parallax_deg: f64,
    /// Best match's distance as a share of the second best's along the epipolar line. Default 0.8.
    pub match_ratio: f32,
    /// Neighbors into which points are fused. Default 20.
    pub n_fusion_neighbors: usize,
    /// Radius in which a duplicate of a point is looked for, pixels of its level. Default 3.
    pub fusion_radius_px: f64,
    /// A young point found in less than this share of the frames that should see it goes. Default 0.25.
    pub min_found_ratio: f64,
    /// Keyframes after which a point must have been seen by three. Default 2.
    pub probation_keyframes: u64,
    /// Keyframes that local bundle adjustment moves at most. Default 20, for a steady latency.
    pub max_local_keyframes: usize,
    /// Keyframes that hold the local window in place at most, those with the most shared points. Default 40.
    pub max_fixed_keyframes: usize,
    /// Iterations of local bundle adjustment before and after outliers are dropped. Default 5 and 10.
    pub local_iterations: (usize, usize),
    /// A keyframe goes when this share of its points is seen by three others as well. Default 0.9.
    pub redundant_share: f64,
}

impl Default for MappingConfig {
    fn default() -> Self {
        Self {
            min_covisible_points: 15,
            n_triangulation_neighbors: 20,
            min_baseline_share: 0.01,
            min_parallax_deg: 0.7,
            match_ratio: 0.8,
            n_fusion_neighbors: 20,
            fusion_radius_px: 3.0,
            min_found_ratio: 0.25,
            probation_keyframes: 2,
            max_local_keyframes: 20,
            max_fixed_keyframes: 40,
            local_iterations: (5, 10),
            redundant_share: 0.9,
        }
    }
}
