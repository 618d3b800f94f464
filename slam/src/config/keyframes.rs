//! When a frame becomes a keyframe.

/// When a frame becomes a keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframeConfig {
    /// A frame that finds less than this share of what its reference keyframe sees is kept. Default 0.9.
    pub max_tracked_share: f64,
    /// Median way that landmarks must have moved in the image since the last keyframe, as a share of its
    /// width. Default 0.025: views closer than that add work and no parallax.
    pub min_displacement: f64,
    /// A frame that finds less than this share is kept after a smaller way. Default 0.6: what is seen changes
    /// fast.
    pub urgent_tracked_share: f64,
    /// That smaller way, as a share of the image's width. Default 0.015.
    pub urgent_displacement: f64,
    /// After this way a frame is kept however much of the map it finds, as a share of the image's width.
    /// Default 0.1: points that two keyframes have made are known well once a third sees them from
    /// elsewhere.
    pub ample_displacement: f64,
    /// With fewer landmarks than this found, a smaller way is enough. Default 250.
    pub scarce_landmarks: usize,
    /// That smaller way, as a share of the image's width. Default 0.04.
    pub scarce_displacement: f64,
    /// And a frame is kept at once that finds less than this share of the most found since the last keyframe.
    /// Default 0.5.
    pub fallen_share: f64,
    /// The same share once `max_interval_ns` have gone by. Default 0.97: a slow camera still refreshes the
    /// map.
    pub max_tracked_share_after_wait: f64,
    /// With fewer points than this found, segments ask for keyframes too. Default 100: a pose hangs on them
    /// then.
    pub plentiful_points: usize,
    /// Segments followed since the last keyframe and not yet in the map that ask for another. Default 6.
    pub min_followed_segments: usize,
    /// How many times the last keyframe's segments ask for another. Default 1.3.
    pub risen_segments_share: f64,
    /// Landmarks a keyframe must find at least. Default 10, as for a good pose.
    pub min_inliers: usize,
    /// After this time a smaller change is enough for a keyframe, nanoseconds. Default 1 s.
    pub max_interval_ns: i64,
    /// Frames after a relocalization that are not kept. Default 5: the pose settles first.
    pub settle_frames: u64,
    /// Keyframes kept per session; beyond it the most redundant one goes for each new one. Default 2000.
    pub max_keyframes: usize,
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self {
            max_tracked_share: 0.9,
            min_displacement: 0.025,
            urgent_tracked_share: 0.6,
            urgent_displacement: 0.015,
            ample_displacement: 0.1,
            scarce_landmarks: 250,
            scarce_displacement: 0.04,
            fallen_share: 0.5,
            plentiful_points: 100,
            min_followed_segments: 6,
            risen_segments_share: 1.3,
            max_tracked_share_after_wait: 0.97,
            min_inliers: 10,
            max_interval_ns: 1_000_000_000,
            settle_frames: 5,
            max_keyframes: 2000,
        }
    }
}
