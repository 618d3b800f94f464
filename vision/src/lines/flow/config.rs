//! How segments are followed.

/// How segments are followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineFlowConfig {
    /// Distance of the places looked at along a segment, pixels. Default 10.
    pub sample_spacing_px: f32,
    /// Fewest places along a segment that must give a shift, at least 2. Default 4.
    pub min_samples: usize,
    /// Most places along a segment: longer ones are sampled further apart. Default 20.
    pub max_samples: usize,
    /// How far a segment may have moved across itself without a motion prior, pixels, at most 32. Default 24:
    /// 30 degrees per second at 500 px focal length and 10 frames per second, or fast motion at 30.
    pub search_px: f32,
    /// As `search_px` with a motion prior, pixels. Default 12.
    pub search_with_prior_px: f32,
    /// Least correlation of a path with the place found for it. Default 0.7.
    pub min_correlation: f32,
    /// Largest distance from where a path began of where it leads when followed back, pixels. Default 1.
    pub max_forward_backward_px: f32,
    /// Largest distance of an inlier from the line, pixels. Default 1.
    pub inlier_px: f32,
    /// Least share of inliers among places that lie in both images. Default 0.7.
    pub min_inlier_share: f32,
    /// Largest root mean square distance of inliers from the line, pixels. Default 0.7.
    pub max_fit_px: f32,
}

impl Default for LineFlowConfig {
    fn default() -> Self {
        Self {
            sample_spacing_px: 10.0,
            min_samples: 4,
            max_samples: 20,
            search_px: 24.0,
            search_with_prior_px: 12.0,
            min_correlation: 0.7,
            max_forward_backward_px: 1.0,
            inlier_px: 1.0,
            min_inlier_share: 0.7,
            max_fit_px: 0.7,
        }
    }
}
