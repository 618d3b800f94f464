//! A camera from pictures of a chessboard: its corners are found in each ([`find_board`]), and the camera
//! whose projection explains them best is estimated with the board's poses ([`calibrate`]), by bundle
//! adjustment with `optim`. What comes of it says how far it is to be believed ([`Calibrated`], [`Verdict`]).
//!
//! No files, no maps; the same pictures give the same camera. Coordinates as in `geometry`.
//!
//! ```
//! use calibration::{Board, CalibrationConfig, View, calibrate};
//! use geometry::nalgebra::Vector6;
//! use geometry::{Camera, CameraModel, CameraParameters, Pose};
//!
//! let board = Board::new(7, 5, 0.03)?;
//! let truth = Camera::new(CameraParameters::of_focal_length(640, 480, 500.0))?;
//! let views: Vec<View> = (0..8)
//!     .map(|i| {
//!         let (tilt, turn) = (0.5 * f64::from(i).sin(), 0.5 * f64::from(2 * i).cos());
//!         let camera_from_board = Pose::exp(&Vector6::new(tilt, turn, 0.1 * f64::from(i), -0.09, -0.06,
//! 0.3));
//!         let corners = board.corners().map(|corner| truth.project(&(camera_from_board * corner)));
//!         View { corners: corners.collect::<Option<_>>().expect("before the camera") }
//!     })
//!     .collect();
//! let config = CalibrationConfig { model: CameraModel::Pinhole, ..CalibrationConfig::default() };
//! let found = calibrate(&board, &views, (640, 480), &config)?;
//! assert!((found.camera.fx - 500.0).abs() < 0.01);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod adjustment;
mod board;
mod config;
mod detection;
mod factor;
mod pose;
mod report;

pub use adjustment::{CalibrationError, calibrate};
pub use board::{Board, BoardError, View};
pub use config::CalibrationConfig;
pub use detection::{DetectionConfig, find_board};
pub use report::{Calibrated, Finding, Verdict, ViewErrors};
