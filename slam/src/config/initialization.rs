//! Map initialization: the first map from two views.

/// Initialization: the first map from two views.
#[derive(Clone, Debug, PartialEq)]
pub struct InitializationConfig {
    /// Features asked of the extractor while there is no map. Default 2000: matches are scarce at first.
    pub n_features: usize,
    /// Fewest keypoints a usable view has. Default 100.
    pub min_keypoints: usize,
    /// Views kept to start from; every second one goes when full. Default 30: a second of video.
    pub max_reference_views: usize,
    /// Frames that are kept to be placed once the map is good enough. Default 150: five seconds of video, 25
    /// MB.
    pub max_backfill_views: usize,
    /// Width of the keyframes' positions as a share of the scene's median depth from which a map is good
    /// enough to place older frames in, and those that were tracked in it while it was younger once more.
    /// Default 0.3: a map begun on few points believes to be wider than it is.
    pub mature_baseline_share: f64,
    /// Keyframes it must have as well. Default 5: how wide two views lie apart is known no better than their
    /// depths.
    pub mature_keyframes: usize,
    /// Pairs tried per frame: the widest usable baseline and shorter ones. Default 2, to bound the time.
    pub max_attempts_per_frame: usize,
    /// Side of the square a keypoint is looked for in is twice this, pixels at 640 wide. Default 100.
    pub search_radius_px: f64,
    /// Fewest matches two views need. Default 80.
    pub min_matches: usize,
    /// Iterations of the search for a motion. Default 300.
    pub max_iterations: usize,
    /// Fewest points the first map may have. Default 50.
    pub min_points: usize,
    /// Share of the matches that must agree with the motion found. Default 0.7.
    pub min_inlier_share: f64,
    /// A second motion whose cost over all matches is below this many times the best one's makes the pair
    /// ambiguous. Default 1.3.
    pub min_runner_up_cost_ratio: f64,
    /// A second motion whose cost over all matches is above the best one's by less than this, χ², makes the
    /// pair ambiguous too, at first; later less is asked for, as of the direction. Default 25: among few
    /// matches the errors of some, which are not independent, may speak for the wrong one of the two motions
    /// that a plane allows. Of twenty first maps one was wrong, and led by 16; one true one led by 15, the
    /// others by 30 and more.
    pub min_runner_up_lead: f64,
    /// Least parallax, reached by the widest fiftieth point, degrees. Default 1.0: below it depth is noise.
    pub min_parallax_deg: f64,
    /// Largest standard deviation of the direction of motion, degrees. Default 1.0: turning and moving
    /// sideways look alike over a short baseline, and a map begun on a wrong mixture of the two bends.
    pub max_direction_sigma_deg: f64,
    /// Views after which twice that is accepted, and in between and beyond in proportion. Default 90: three
    /// seconds.
    pub patience_views: usize,
    /// Share of the map's points a view between the two must confirm. Default 0.6.
    pub min_third_view_share: f64,
}

impl Default for InitializationConfig {
    fn default() -> Self {
        Self {
            n_features: 2000,
            min_keypoints: 100,
            max_reference_views: 30,
            max_backfill_views: 150,
            mature_baseline_share: 0.3,
            mature_keyframes: 5,
            max_attempts_per_frame: 2,
            search_radius_px: 100.0,
            min_matches: 80,
            max_iterations: 300,
            min_points: 50,
            min_inlier_share: 0.7,
            min_runner_up_cost_ratio: 1.3,
            min_runner_up_lead: 25.0,
            min_parallax_deg: 1.0,
            max_direction_sigma_deg: 1.0,
            patience_views: 90,
            min_third_view_share: 0.6,
        }
    }
}
