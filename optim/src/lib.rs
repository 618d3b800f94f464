//! Nonlinear least squares on manifolds, for bundle adjustment, pose graphs and the pose of a frame.
//!
//! * [`Problem`]: a factor graph of variables and factors, solved by Levenberg-Marquardt with the Schur
//!   complement over landmarks.
//! * [`Factor`]: one term of the cost. What it measures is the business of the crate that defines it.
//! * [`Manifold`]: a type of variable; implemented for poses, similarities, directions, lines and vectors.
//! * [`optimize_single`]: one variable against many unary factors, for every frame.
//!
//! Everything runs on the caller's thread, reads no clock and draws no random numbers: the same input gives
//! the same bytes. Numbers that are not finite are reported, never taken over.
//!
//! # Bundle adjustment in miniature
//!
//! Two cameras of unit focal length look at points; the first one and the direction of scale are known.
//!
//! ```
//! use geometry::{Pose, so3};
//! use nalgebra::{Matrix2x3, Matrix2x6, Matrix3, Matrix3x6, Vector2, Vector3, Vector6};
//! use optim::{Factor, Kernel, Linearized, Problem, SolverOptions};
//!
//! /// `r = ([x/z, y/z] − seen) / sigma`, with `[x, y, z] = camera_from_world * point`.
//! struct Seen { at: Vector2<f64>, sigma: f64 }
//!
//! impl Factor for Seen {
//!     type Residual = Vector2<f64>;
//!     type Variables = (Pose, Vector3<f64>);
//!
//!     fn residual(&self, (camera_from_world, point): (&Pose, &Vector3<f64>)) -> Option<Vector2<f64>> {
//!         let p = camera_from_world.transform(point);
//!         (p.z > 0.0).then(|| (p.xy() / p.z - self.at) / self.sigma)
//!     }
//!
//!     fn linearize(&self, (camera_from_world, point): (&Pose, &Vector3<f64>)) -> Option<Linearized<Self>> {
//!         let p = camera_from_world.transform(point);
//!         let d_residual_d_p =
//!             Matrix2x3::new(1.0, 0.0, -p.x / p.z, 0.0, 1.0, -p.y / p.z) / (p.z * self.sigma);
//!         let mut d_p_d_pose = Matrix3x6::zeros();
//!         d_p_d_pose.fixed_columns_mut::<3>(0).copy_from(&-so3::skew(&p));
//!         d_p_d_pose.fixed_columns_mut::<3>(3).copy_from(&Matrix3::identity());
//!         let d_residual_d_pose: Matrix2x6<f64> = d_residual_d_p * d_p_d_pose;
//!         let d_residual_d_point = d_residual_d_p * camera_from_world.rotation_matrix();
//!         Some((self.residual((camera_from_world, point))?, (d_residual_d_pose, d_residual_d_point)))
//!     }
//! }
//!
//! let cameras = [Pose::identity(), Pose::exp(&Vector6::new(0.0, 0.1, 0.0, -1.0, 0.0, 0.0))];
//! let point = |i| Vector3::new(f64::from(i % 4), f64::from(i / 4), 5.0 + f64::from(i % 3));
//! let points: Vec<_> = (0..12).map(point).collect();
//!
//! let mut problem = Problem::new();
//! let first = problem.add_variable(cameras[0]);
//! let second = problem.add_variable(cameras[1].retract(&Vector6::repeat(0.01)));
//! problem.set_fixed(first, true);
//! let mut seen = Vec::new();
//! for point in &points {
//!     let id = problem.add_landmark(point + Vector3::repeat(0.05));
//!     for (camera, camera_id) in cameras.iter().zip([first, second]) {
//!         let p = camera.transform(point);
//!         seen.push(((camera_id, id), Seen { at: p.xy() / p.z, sigma: 0.002 }));
//!     }
//! }
//! problem.add_factors(Kernel::huber_95(2), seen);
//!
//! let report = problem.solve(&SolverOptions::default(), || false);
//! assert!(report.stop.is_converged() && report.last.robust < 1e-6);
//! // The scale is free here; everything else is found.
//! let rotation = problem.value(second).rotation.angle_to(&cameras[1].rotation);
//! assert!(rotation < 1e-6);
//! ```
#![warn(missing_docs)]

mod arithmetic;
mod cost;
mod factor;
mod kernel;
mod layout;
mod manifold;
mod normal;
mod pose_only;
mod problem;
mod reduced;
mod schur;
mod solver;
pub mod testing;
mod variables;
mod wiring;

pub use cost::{Cost, INVALID_CHI2};
pub use factor::{Factor, HoldSecond, Jacobians, Linearized, Residual, ValueRefs, VariableIds};
pub use kernel::{Kernel, chi2_95};
pub use manifold::{Manifold, Tangent};
pub use pose_only::{SingleOptions, SingleReport, UnaryGroup, UnaryTerms, optimize_single};
pub use problem::{ClusteredCovariance, GroupId, Problem};
pub use reduced::LinearSolver;
pub use solver::{SolveReport, SolverOptions, StopReason};
pub use variables::VariableId;
pub use wiring::Variables;
