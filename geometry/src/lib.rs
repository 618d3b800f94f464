//! Poses, cameras, lines, directions and the small solvers between them: everything in the system that is
//! pure geometry, with no images, maps or optimization in it.
//!
//! # Conventions, stated once for the whole project
//!
//! - Transforms are named `target_from_source`, coordinates `thing_in_frame`. Keyframes store
//!   `camera_from_world`: `X_camera = R X_world + t`, so that the camera center is `-Rᵀ t`.
//! - Perturbations act on the left, `exp(δ) * T`, with `δ = [rotation(3), translation(3)]`, and one more
//!   entry for the logarithm of the scale where there is one.
//! - Quaternions are Hamilton's, stored `x, y, z, w`.
//! - Camera axes: `x` right, `y` down, `z` forward. Pixel centers are at integers: the origin is the center
//!   of the top-left pixel, and the image covers `[-0.5, width - 0.5] × [-0.5, height - 0.5]`.
//! - Angles are radians unless the name ends in `_deg`. Lengths are map units: monocular scale is free.
//! - A *bearing* is the unit vector from the camera center towards a scene point, in the camera frame.
//!
//! # Example
//!
//! ```
//! use geometry::{Camera, CameraModel, CameraParameters, Pose, nalgebra::{Vector2, Vector3, Vector6}};
//!
//! let camera = Camera::new(CameraParameters {
//!     model: CameraModel::Radtan,
//!     width: 752,
//!     height: 480,
//!     fx: 458.7, fy: 457.3, cx: 367.2, cy: 248.4,
//!     distortion: vec![-0.283, 0.074, 0.0002, 0.00002],
//! })?;
//! let camera_from_world = Pose::exp(&Vector6::new(0.0, 0.1, 0.0, 0.2, 0.0, 0.0));
//! let point_in_world = Vector3::new(0.5, -0.2, 4.0);
//!
//! let point_in_camera = camera_from_world * point_in_world;
//! let pixel = camera.project(&point_in_camera).expect("the point is in front of the camera");
//! let bearing = camera.unproject(&pixel).expect("the pixel is inside the image");
//! assert!((bearing - point_in_camera.normalize()).norm() < 1e-9);
//! # Ok::<(), geometry::CameraError>(())
//! ```

pub mod absolute_pose;
pub mod line;
pub mod ransac;
pub mod so3;
pub mod triangulation;
pub mod two_view;

mod camera;
mod camera_parameters;
mod correction;
mod direction;
mod distortion;
mod pinhole;
mod polynomial;
mod pose;
mod similarity;
mod spheres;

pub use camera::{CalibrationDerivatives, Camera, MAX_UNDISTORTED_ANGLE_DEG};
pub use camera_parameters::{CameraError, CameraModel, CameraParameters};
pub use correction::{CameraCorrection, CorrectedPixels};
pub use direction::Direction;
pub use line::{Line3, OrthonormalLine};
pub use nalgebra;
pub use pinhole::Pinhole;
pub use pose::Pose;
pub use similarity::Similarity;
