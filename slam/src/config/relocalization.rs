//! Relocalization: finding a lost camera in the map.

/// Relocalization: finding a lost camera in the map.
#[derive(Clone, Debug, PartialEq)]
pub struct RelocalizationConfig {
    /// Places tried per frame. Default 5.
    pub max_candidates: usize,
    /// Neighbors of a place that is tried whose points are matched too. Default 0: the next frame may show
    /// the place better; single images have no next one.
    pub n_matched_neighbors: usize,
    /// Fewest matches with a place worth a try. Default 15.
    pub min_matches: usize,
    /// The same where vanishing points tell the camera's attitude, but for a few possibilities. Default 8:
    /// two matches then give the position, and the others can agree.
    pub min_matches_with_directions: usize,
    /// Iterations of the search for a pose. Default 300.
    pub max_iterations: usize,
    /// Points that must agree with the pose found from the matches. Default 10.
    pub min_first_inliers: usize,
    /// The same where vanishing points tell the attitude. Default 6.
    pub min_first_inliers_with_directions: usize,
    /// Landmarks that must agree in the end. Default 40: a false place is worse than a lost frame.
    pub min_inliers: usize,
    /// Share of the landmarks to be expected at a place that must be found there, up to `plentiful_inliers`.
    /// Default 0.4: true places have shown 0.41 to 0.68, corners of a corridor that look alike 0.11 to 0.36.
    pub min_found_share: f64,
    /// Landmarks that are enough however many were expected. Default 200: a blurred image of a crowded place
    /// may show no more, and no two places have been seen to share as many.
    pub plentiful_inliers: usize,
}

impl Default for RelocalizationConfig {
    fn default() -> Self {
        Self {
            max_candidates: 5,
            n_matched_neighbors: 0,
            min_matches: 15,
            min_matches_with_directions: 8,
            max_iterations: 300,
            min_first_inliers: 10,
            min_first_inliers_with_directions: 6,
            min_inliers: 40,
            min_found_share: 0.4,
            plentiful_inliers: 200,
        }
    }
}

impl RelocalizationConfig {
    /// Whether so many landmarks show a place, of those that could have been found there.
    pub(crate) fn is_enough(&self, n_inliers: usize, n_expected: usize) -> bool {
        n_inliers >= self.plentiful_inliers || n_inliers as f64 >= self.min_found_share * n_expected as f64
    }
}
