//! Line segments: detection, description, matching and tracking.
//!
//! Detectors: [`DetectorKind::EdgeDrawing`] (EDLines, ELSED) and [`DetectorKind::Lsd`]. Descriptor:
//! [`LineDescriber`] (LBD). Tracking: [`LineTracker`], on optical flow by [`LineFlow`] (KLT).

mod clip;
mod descriptor;
mod detector;
mod edge_drawing;
mod fit;
mod flow;
mod gradient;
mod lsd;
mod matching;
mod merging;
mod moments;
mod raw_detector;
mod refine;
mod sampling;
mod segment;
mod select;
mod sharpen;
mod support;
#[cfg(test)]
mod test_scenes;
#[cfg(test)]
mod tests;
mod tracking;

pub use descriptor::LineDescriber;
pub use detector::{DetectorKind, LineDetectorConfig, LineDetectorConfigError, SegmentDetector, detector};
pub use flow::{FlowFailure, FlowPyramid, FlowedSegment, LineFlow, LineFlowConfig, MotionPrior};
pub use matching::{DescribedLines, LineGates, LineMatchConfig, match_lines};
pub use merging::{LineMergeConfig, MergedLines, merge_collinear, merge_pair};
pub use segment::Segment;
pub use support::EdgeSupportConfig;
pub use tracking::{
    LineOrigin, LineTracker, LineTrackerConfig, LineTrackerConfigError, LineTrackingStatistics, LostLines,
    TrackedLine, TrackedLines,
};
