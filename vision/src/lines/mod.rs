//! Line segments: finding, describing and following them.

mod segment;

pub use segment::Segment;
