//! How a camera is calibrated.

use geometry::CameraModel;

/// How a camera is calibrated, and when that is called good.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationConfig {
    /// The family of lens distortion. Default radial-tangential.
    pub model: CameraModel,
    /// Whether radial-tangential distortion has the coefficient `k3` of r⁶. Default not: without corners to
    /// the very edge it is what folds back there.
    pub with_k3: bool,
    /// Standard deviation of the principal point from the middle of the image, shares of its width, so that
    /// few views leave it there. Default 0.1.
    pub center_sigma: f64,
    /// Standard deviation of radial coefficients. Default 1.
    pub radial_sigma: f64,
    /// Standard deviation of tangential coefficients. Default 0.01: lenses are centered to a thousandth.
    pub tangential_sigma: f64,
    /// A view whose errors are more than this many times the median of all is left out: a board that is bent,
    /// moved while it was taken, or wrongly found. Default 3.
    pub max_view_ratio: f64,
    /// Views from which on the camera is called well calibrated. Default 10.
    pub min_views: usize,
    /// How far the board must be tilted in the views against each other, degrees: boards that all lie alike
    /// leave the focal length to guesses. Default 30.
    pub min_tilt_deg: f64,
    /// Share of the image's cells, 8 by 6, that must hold a corner. Default 0.7.
    pub min_coverage: f64,
    /// Mean error that is called good, pixels for 1000 pixels of the image's width. Default 0.5.
    pub max_error_px: f64,
    /// Standard deviation of the focal length that is called good, as a share of it. Default 0.003.
    pub max_focal_sigma: f64,
    /// Iterations of each adjustment. Default 50.
    pub max_iterations: usize,
}

impl Default for CalibrationConfig {
    fn default() -> Self {
        Self {
            model: CameraModel::Radtan,
            with_k3: false,
            center_sigma: 0.1,
            radial_sigma: 1.0,
            tangential_sigma: 0.01,
            max_view_ratio: 3.0,
            min_views: 10,
            min_tilt_deg: 30.0,
            min_coverage: 0.7,
            max_error_px: 0.5,
            max_focal_sigma: 0.003,
            max_iterations: 50,
        }
    }
}
