//! Configuration of line tracking and line mapping.

use vision::lines::LineDetectorConfig;

/// Line tracking and line mapping. [method: Line segments; Line landmarks]
#[derive(Clone, Debug, PartialEq)]
pub struct LineConfig {
    /// How segments are detected.
    pub detector: LineDetectorConfig,
    /// Least standard deviation of a segment's ends across it, pixels. Default 0.4: on POV office segments
    /// lie 0.07 pixels from the true lines in the median and 0.3 in nine of ten cases.
    pub min_sigma_px: f64,
    /// Largest distance of a segment's ends from where a line is expected, pixels. Default 8.
    pub search_radius_px: f64,
    /// Largest angle between a segment and the expected one, degrees. Default 8.
    pub search_angle_deg: f64,
    /// Least overlap of a segment with the expected one, as a share of the shorter. Default 0.3.
    pub min_search_overlap: f64,
    /// Largest Hamming distance of the descriptors. Default 90 of 256: geometry decides first.
    pub max_descriptor_distance: u32,
    /// Views in which a line must have been tracked to be made. Default 3: any two views agree on some line.
    pub min_views: usize,
    /// Least angle between the interpretation planes of a new line's best two views, degrees. Default 0.5: a
    /// segment's place is known five times as well as a keypoint's, and where there is little else, lines
    /// made early hold the scale.
    pub min_plane_angle_deg: f64,
    /// Largest standard deviation of a new line's depth at its ends, as a share of the depth. Default 0.2: it
    /// grows without bound where the segments lie along the epipolar lines.
    pub max_depth_sigma_share: f64,
    /// Reprojection: largest distance between the midpoints of segment and visible projection, in mean
    /// lengths of the two (θ of Jiang et al., there in pixels). Default 1.5: at 1 they touch end to end, and
    /// fragments of one edge leave gaps.
    pub max_midpoint_distance: f64,
    /// Reprojection: largest distance of the segment's ends from the projection, pixels (d of Jiang et al.).
    /// Default 4.
    pub max_end_distance_px: f64,
    /// Sensitivity: largest angle by which the line may depart from being seen squarely, degrees (α of Jiang
    /// et al.). Default 75.
    pub max_sensitivity_deg: f64,
    /// Overlap of a sighting: least part that segment and visible projection have in common, as a share of
    /// the shorter, as either may be a fragment of the edge. Default 0.3.
    pub min_overlap: f64,
    /// Overlap of a new line: least share of its visible part that each of two views must show (r of Jiang et
    /// al., there of the segment). Default 0.5: ends that no two views saw together belong to two edges more
    /// often than to one.
    pub min_covered: f64,
    /// Depth at which a line may lie at most, in median depths of the scene. Default 20.
    pub max_depth_share: f64,
    /// A young line found in less than this share of the frames that should see it goes. Default 0.25.
    pub min_found_ratio: f64,
    /// Keyframes after which a line must have been seen by three. Default 3.
    pub probation_keyframes: u64,
    /// Neighbors whose lines are looked for in a new keyframe, to be joined. Default 10.
    pub n_fusion_neighbors: usize,
    /// Largest angle between two lines that are joined, degrees. Default 5.
    pub fusion_angle_deg: f64,
    /// Largest distance of one line's projected ends from the other's projection to be joined, pixels.
    /// Default 2.
    pub fusion_distance_px: f64,
}

impl Default for LineConfig {
    fn default() -> Self {
        Self {
            detector: LineDetectorConfig::default(),
            min_sigma_px: 0.4,
            search_radius_px: 8.0,
            search_angle_deg: 8.0,
            min_search_overlap: 0.3,
            max_descriptor_distance: 90,
            min_views: 3,
            min_plane_angle_deg: 0.5,
            max_depth_sigma_share: 0.2,
            max_midpoint_distance: 1.5,
            max_end_distance_px: 4.0,
            max_sensitivity_deg: 75.0,
            min_overlap: 0.3,
            min_covered: 0.5,
            max_depth_share: 20.0,
            min_found_ratio: 0.25,
            probation_keyframes: 3,
            n_fusion_neighbors: 10,
            fusion_angle_deg: 5.0,
            fusion_distance_px: 2.0,
        }
    }
}
