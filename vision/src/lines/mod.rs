//! Line segments: finding, describing and following them.

mod detector;
mod edge_drawing;
mod fit;
mod gradient;
mod lsd;
mod refine;
mod segment;
mod select;
#[cfg(test)]
mod tests;

pub use detector::{DetectorKind, LineDetectorConfig, LineDetectorConfigError, SegmentDetector, detector};
pub use segment::Segment;
