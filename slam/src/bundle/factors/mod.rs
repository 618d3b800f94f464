//! The terms of the cost function, one file each.

mod point_reprojection;

pub use point_reprojection::PointReprojectionFactor;
