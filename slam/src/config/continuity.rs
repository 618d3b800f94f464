//! Configuration of the motion continuity check.

/// Motion continuity: how far a lost camera can have moved, to tell places that look alike apart.
#[derive(Clone, Debug, PartialEq)]
pub struct ContinuityConfig {
    /// Time after which the camera may be anywhere, nanoseconds. Default 10 s.
    pub max_elapsed_ns: i64,
    /// How many times as fast as before it may have moved on the mean. Default 2.
    pub speed_factor: f64,
    /// How far it may be in any case, as a share of the median depth of what it saw. Default 0.5.
    pub depth_share: f64,
    /// Landmarks that show a place beyond doubt, wherever it is. Default 100: recordings may be cut, and two
    /// places that look alike share a picture or a door, hardly ever everything.
    pub n_beyond_doubt: usize,
    /// Share of the landmarks to be expected at a place that must be among them. Default 0.4: true places
    /// have shown 0.41 and more, the most alike of false ones 0.36.
    pub share_beyond_doubt: f64,
}

impl Default for ContinuityConfig {
    fn default() -> Self {
        Self {
            max_elapsed_ns: 10_000_000_000,
            speed_factor: 2.0,
            depth_share: 0.5,
            n_beyond_doubt: 100,
            share_beyond_doubt: 0.4,
        }
    }
}
