//! Configuration of submaps.

/// When a lost camera begins a submap, and what becomes of submaps.
#[derive(Clone, Debug, PartialEq)]
pub struct SubmapConfig {
    /// Time without a pose after which a new submap is begun, nanoseconds. Default 1.5 s: longer than a
    /// blurred turn.
    pub max_lost_ns: i64,
    /// A submap with fewer keyframes than this is discarded when the camera is lost. Default 6.
    pub min_keyframes: usize,
    /// A submap younger than this looks for the other submaps every so many frames. Default 3.
    pub search_interval: u64,
}

impl Default for SubmapConfig {
    fn default() -> Self {
        Self { max_lost_ns: 1_500_000_000, min_keyframes: 6, search_interval: 3 }
    }
}
