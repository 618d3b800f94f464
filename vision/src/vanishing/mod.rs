//! Vanishing points: the directions that the parallel lines of a scene have in common, seen from one image.
//!
//! - [`SegmentPlane`]: what is needed of an image segment, made from its undistorted endpoints. With planes
//!   instead of pixels, a vanishing point at infinity is as good as any other.
//! - [`VanishingEstimator`]: finds them anew ([`cluster`](VanishingEstimator::cluster), J-Linkage, for key
//!   frames) or follows predicted ones ([`refit`](VanishingEstimator::refit), for all other frames).
//! - [`rotation_from_directions`]: the camera's rotation from two or more that are known in the world.
//!
//! No assumption is made of how the directions lie to one another.
//!
//! ```
//! use nalgebra::{Vector2, Vector3};
//! use vision::vanishing::{SegmentPlane, VanishingConfig, VanishingEstimator};
//!
//! // Eight lines along the optical axis, from 3 to 6 units away.
//! let segments: Vec<_> = (0..8)
//!     .filter_map(|i| {
//!         let (sin, cos) = (f64::from(i) * 0.7).sin_cos();
//!         let (near, far) = (Vector2::new(cos, sin) / 3.0, Vector2::new(cos, sin) / 6.0);
//!         SegmentPlane::from_normalized(&near, &far, 1.0 / 458.0)
//!     })
//!     .collect();
//! let mut estimator = VanishingEstimator::new(VanishingConfig::default(), 7)?;
//! let found = estimator.cluster(&segments, &[]);
//! assert_eq!(found.points.len(), 1);
//! assert!(found.points[0].direction.angle(&Vector3::z()) < 1e-3);
//! assert_eq!(found.points[0].segments.len(), 8);
//! # Ok::<(), vision::vanishing::VanishingConfigError>(())
//! ```

mod candidates;
mod config;
mod estimator;
mod linkage;
mod plane;
mod refine;
mod rotation;
mod sampling;
mod significance;
#[cfg(test)]
mod tests;

pub use config::{VanishingConfig, VanishingConfigError};
pub use estimator::{VanishingEstimator, VanishingPoint, VanishingPoints};
pub use plane::SegmentPlane;
pub use refine::fit_direction;
pub use rotation::{DirectionPair, rotation_from_directions, rotation_hypotheses};
