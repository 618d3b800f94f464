//! Configuration of place recognition and loop closing.

/// Loop closing: recognizing a place seen before and correcting the map by it.
/// [method: Loop detection and correction]
#[derive(Clone, Debug, PartialEq)]
pub struct LoopConfig {
    /// Places looked at per keyframe. Default 3: looking at one takes some milliseconds of the mapping
    /// thread.
    pub max_candidates: usize,
    /// Fewest descriptors that must vote for a place. Default 20: the geometry needs as many.
    pub min_votes: u32,
    /// Least likeness of a place as a share of that of the most similar keyframe around the new one. Default
    /// 0.2.
    pub min_score_share: f32,
    /// Neighbors of the recognized keyframe whose points are looked for too. Default 10.
    pub n_window_neighbors: usize,
    /// Fewest pairs of points matched by their descriptors. Default 20.
    pub min_matches: usize,
    /// Iterations of the search for a similarity. Default 300.
    pub max_iterations: usize,
    /// Fewest pairs of points that must agree with the similarity found. Default 15, before more pairs are
    /// looked for where it puts them.
    pub min_first_inliers: usize,
    /// Fewest pairs of points that must agree with the refined similarity. Default 20.
    pub min_inliers: usize,
    /// Radius in which points are looked for around where the similarity puts them, pixels of the level.
    /// Default 8, and half of it once the similarity is refined.
    pub search_radius_px: f64,
    /// Fewest points of the recognized place that the new keyframe must find. Default 45.
    pub min_projected_matches: usize,
    /// Share of the recognized place's points to be expected in the new keyframe that it must find. Default
    /// 0.25: true places have shown 0.26 to 0.60, corners of a corridor that look alike 0.11 to 0.18.
    pub min_found_share: f64,
    /// Neighbors of the new keyframe that must find points of the place too. Default 3, or all there are.
    pub n_confirmations: usize,
    /// Fewest points that each of them must find. Default 20.
    pub min_confirming_matches: usize,
    /// Largest turn between directions of the world, vanishing points on both sides, after the correction,
    /// degrees. Default 3: look-alike places at another angle are told apart by it.
    pub max_direction_error_deg: f64,
    /// Within one submap the largest shift by a correction, as a share of the way since the place was seen.
    /// Default 0.3: drift is less, while the way between two places that look alike is all of it.
    pub max_drift_share: f64,
    /// Within one submap the largest turn by a correction, degrees. Default 45.
    pub max_turn_deg: f64,
    /// Within one submap the largest change of scale by a correction, either way. Default 3.
    pub max_scale_change: f64,
    /// Shared points that make two keyframes neighbors in the essential graph. Default 100.
    pub min_essential_points: u32,
    /// Iterations of the optimization of the essential graph. Default 20.
    pub essential_iterations: usize,
    /// Iterations of the global bundle adjustment after a correction. Default 10.
    pub global_iterations: usize,
}

impl Default for LoopConfig {
    fn default() -> Self {
        Self {
            max_candidates: 3,
            min_votes: 20,
            min_score_share: 0.2,
            n_window_neighbors: 10,
            min_matches: 20,
            max_iterations: 300,
            min_first_inliers: 15,
            min_inliers: 20,
            search_radius_px: 8.0,
            min_projected_matches: 45,
            min_found_share: 0.25,
            n_confirmations: 3,
            min_confirming_matches: 20,
            max_direction_error_deg: 3.0,
            max_drift_share: 0.3,
            max_turn_deg: 45.0,
            max_scale_change: 3.0,
            min_essential_points: 100,
            essential_iterations: 20,
            global_iterations: 10,
        }
    }
}
