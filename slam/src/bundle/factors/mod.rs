//! The terms of the cost function, one file each.

mod baseline_length;
mod point_reprojection;

pub use baseline_length::BaselineLengthFactor;
pub use point_reprojection::PointReprojectionFactor;
