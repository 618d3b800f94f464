//! Nonlinear least squares on manifolds for bundle adjustment and pose graphs.
//!
//! * [`Problem`]: a factor graph of variables and factors, solved by Levenberg-Marquardt with the Schur
//!   complement over landmarks.
//! * [`Factor`]: one term of the cost; what it measures is the business of the crate that defines it.
//! * [`Manifold`]: a type of variable.
//!
//! Everything runs on the caller's thread, reads no clock and draws no random numbers: the same input gives
//! the same bytes.
#![warn(missing_docs)]

mod factor;
mod kernel;
mod manifold;
mod problem;
mod reduced;
mod schur;
mod solver;
pub mod testing;

pub use factor::{Factor, HoldSecond, Jacobians, Linearized, Residual, ValueRefs, VariableIds, Variables};
pub use kernel::{Kernel, chi2_95};
pub use manifold::{Manifold, Tangent};
pub use problem::{Cost, GroupId, INVALID_CHI2, Problem, VariableId};
pub use solver::{LinearSolver, SolveReport, SolverOptions, StopReason};
