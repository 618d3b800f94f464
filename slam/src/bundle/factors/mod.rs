//! The terms of the cost function, one file each.

mod baseline_length;
mod calibrated_reprojection;
mod direction_prior;
mod line_reprojection;
mod orthogonality;
mod point_reprojection;
mod relative_similarity;
mod rolled_reprojection;
mod similarity_reprojection;
mod structural_consistency;
mod vanishing_reprojection;

pub use baseline_length::BaselineLengthFactor;
pub use calibrated_reprojection::{CalibratedReprojectionFactor, CalibrationPriorFactor};
pub(super) use calibrated_reprojection::{CorrectionVector, correction_of, vector_of};
pub use direction_prior::DirectionPriorFactor;
pub use line_reprojection::LineReprojectionFactor;
pub use orthogonality::OrthogonalityFactor;
pub use point_reprojection::PointReprojectionFactor;
pub use relative_similarity::RelativeSimilarityFactor;
pub use rolled_reprojection::{RolledReprojectionFactor, RollingCamera, RollingCameraPriorFactor};
pub use similarity_reprojection::{PlacedSighting, SimilarityReprojectionFactor};
pub use structural_consistency::StructuralConsistencyFactor;
pub use vanishing_reprojection::VanishingReprojectionFactor;
