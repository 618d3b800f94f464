//! The terms of the cost function, one file each.

mod baseline_length;
mod line_reprojection;
mod point_reprojection;

pub use baseline_length::BaselineLengthFactor;
pub use line_reprojection::LineReprojectionFactor;
pub use point_reprojection::PointReprojectionFactor;
