//! What a calibration is worth: errors, how much of the image was covered, and a verdict in plain sentences.

use crate::config::CalibrationConfig;
use geometry::nalgebra::{Vector2, Vector3};
use geometry::{CameraParameters, Pose};

/// Cells of the image in which corners are counted, across and down.
const CELLS: (usize, usize) = (8, 6);
/// A corner of the image is covered if a board's corner lies within this share of its sides.
const CORNER_SHARE: f64 = 0.2;

/// What one view came to.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewErrors {
    /// Which view, counted from 0.
    pub idx: usize,
    /// Whether the camera was fitted to it.
    pub is_used: bool,
    /// `camera_from_board`, meters.
    pub pose: Pose,
    /// Where its corners were seen, pixels.
    pub pixels: Vec<Vector2<f64>>,
    /// Seen minus projected for each, pixels.
    pub residuals: Vec<Vector2<f64>>,
}

impl ViewErrors {
    /// Root mean square of the errors, pixels.
    pub fn rms_px(&self) -> f64 {
        rms(&self.residuals)
    }
}

/// Something to be put right.
#[derive(Clone, Debug, PartialEq)]
pub enum Finding {
    /// There are few views.
    FewViews(usize),
    /// The board is tilted much alike in all views: by so many degrees against each other at most.
    OneTilt(f64),
    /// Corners of the image without a corner of the board, such as "top left".
    CornersNotCovered(Vec<&'static str>),
    /// Only so much of the image was covered.
    LittleCovered(f64),
    /// Errors are large, pixels.
    LargeErrors(f64),
    /// The focal length is uncertain, by this share of it.
    FocalUncertain(f64),
    /// Views were left out, by their numbers from 0.
    ViewsLeftOut(Vec<usize>),
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::FewViews(n) => write!(f, "too few views: {n}; take 15 to 30"),
            Self::OneTilt(deg) => write!(
                f,
                "one tilt only: in all views the board lies within {deg:.0} degrees of the same attitude; tilt it by 30 to \
                 45 degrees to all sides, or the focal length is a guess"
            ),
            Self::CornersNotCovered(corners) => write!(
                f,
                "the image is not covered {}: hold the board there, or the distortion is a guess",
                corners.join(", ")
            ),
            Self::LittleCovered(share) => {
                write!(f, "only {:.0} % of the image was covered by boards", 100.0 * share)
            }
            Self::LargeErrors(px) => write!(
                f,
                "large errors ({px:.2} px): is the board flat, are the pictures sharp, is the model that of the lens?"
            ),
            Self::FocalUncertain(share) => {
                write!(
                    f,
                    "the focal length is uncertain by {:.1} %: take more, and more tilted, views",
                    100.0 * share
                )
            }
            Self::ViewsLeftOut(views) => write!(
                f,
                "{} views do not fit the others and were left out (blurred, bent or wrongly found)",
                views.len()
            ),
        }
    }
}

/// Whether a calibration can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Yes.
    Good,
    /// Yes, but what was found should be put right.
    Usable,
    /// Better not.
    Poor,
}

/// A camera, and how far it is to be believed.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibrated {
    /// The camera.
    pub camera: CameraParameters,
    /// Standard deviations of `fx fy cx cy` and of the coefficients.
    pub sigmas: Vec<f64>,
    /// The views with a board.
    pub views: Vec<ViewErrors>,
    /// Root mean square of the errors of the views used, pixels.
    pub rms_px: f64,
    /// Share of the image's cells, 8 by 6, that hold a corner of a board.
    pub coverage: f64,
    /// The largest angle between the board's attitudes in two views, degrees.
    pub tilt_deg: f64,
    /// What is to be put right.
    pub findings: Vec<Finding>,
}

impl Calibrated {
    /// Whether it can be used.
    pub fn verdict(&self) -> Verdict {
        let is_poor = |finding: &Finding| match finding {
            Finding::OneTilt(_) | Finding::FocalUncertain(_) | Finding::LargeErrors(_) => true,
            Finding::FewViews(n) => *n < 6,
            Finding::LittleCovered(share) => *share < 0.4,
            _ => false,
        };
        match &self.findings {
            findings if findings.iter().any(is_poor) => Verdict::Poor,
            findings if findings.is_empty() => Verdict::Good,
            _ => Verdict::Usable,
        }
    }
}

/// Puts together what there is to say.
pub(crate) fn judge(
    camera: CameraParameters,
    sigmas: Vec<f64>,
    views: Vec<ViewErrors>,
    config: &CalibrationConfig,
) -> Calibrated {
    let used: Vec<&ViewErrors> = views.iter().filter(|view| view.is_used).collect();
    let residuals: Vec<Vector2<f64>> = used.iter().flat_map(|view| view.residuals.iter().copied()).collect();
    let pixels: Vec<Vector2<f64>> = used.iter().flat_map(|view| view.pixels.iter().copied()).collect();
    let size = Vector2::new(f64::from(camera.width), f64::from(camera.height));
    let (rms_px, coverage) = (rms(&residuals), coverage(&pixels, &size));
    let normals: Vec<Vector3<f64>> =
        used.iter().map(|view| view.pose.rotation_matrix().column(2).into_owned()).collect();
    let tilt_deg = largest_angle(&normals).to_degrees();
    let focal_sigma = sigmas[0] / camera.fx;
    let missing = corners_not_covered(&pixels, &size);
    let left_out: Vec<usize> = views.iter().filter(|view| !view.is_used).map(|view| view.idx).collect();
    let max_error_px = config.max_error_px * (size.x / 1000.0).max(0.5);
    let findings = [
        (used.len() < config.min_views, Finding::FewViews(used.len())),
        (tilt_deg < config.min_tilt_deg, Finding::OneTilt(tilt_deg)),
        (rms_px > max_error_px, Finding::LargeErrors(rms_px)),
        // Also where it is not a number.
        (focal_sigma.is_nan() || focal_sigma > config.max_focal_sigma, Finding::FocalUncertain(focal_sigma)),
        (!missing.is_empty(), Finding::CornersNotCovered(missing)),
        (coverage < config.min_coverage, Finding::LittleCovered(coverage)),
        (!left_out.is_empty(), Finding::ViewsLeftOut(left_out)),
    ];
    let findings = findings.into_iter().filter(|(is_so, _)| *is_so).map(|(_, finding)| finding).collect();
    Calibrated { camera, sigmas, views, rms_px, coverage, tilt_deg, findings }
}

fn coverage(pixels: &[Vector2<f64>], size: &Vector2<f64>) -> f64 {
    let mut is_covered = [false; CELLS.0 * CELLS.1];
    for pixel in pixels {
        let cell = |at: f64, side: f64, n: usize| {
            ((at + 0.5) / side * n as f64).floor().clamp(0.0, n as f64 - 1.0) as usize
        };
        is_covered[cell(pixel.y, size.y, CELLS.1) * CELLS.0 + cell(pixel.x, size.x, CELLS.0)] = true;
    }
    is_covered.iter().filter(|covered| **covered).count() as f64 / is_covered.len() as f64
}

fn corners_not_covered(pixels: &[Vector2<f64>], size: &Vector2<f64>) -> Vec<&'static str> {
    let is_covered = |x: f64, y: f64| {
        pixels.iter().any(|pixel| {
            let off = (pixel - Vector2::new(x * size.x, y * size.y)).component_div(size);
            off.x.abs() <= CORNER_SHARE && off.y.abs() <= CORNER_SHARE
        })
    };
    [("top left", 0.0, 0.0), ("top right", 1.0, 0.0), ("bottom left", 0.0, 1.0), ("bottom right", 1.0, 1.0)]
        .into_iter()
        .filter(|(_, x, y)| !is_covered(*x, *y))
        .map(|(name, ..)| name)
        .collect()
}

/// The largest angle between two directions.
fn largest_angle(directions: &[Vector3<f64>]) -> f64 {
    let pairs = directions.iter().enumerate().flat_map(|(i, a)| directions[..i].iter().map(move |b| (a, b)));
    pairs.map(|(a, b)| a.angle(b)).fold(0.0, f64::max)
}

/// Root mean square length, pixels.
pub fn rms(residuals: &[Vector2<f64>]) -> f64 {
    (residuals.iter().map(Vector2::norm_squared).sum::<f64>() / residuals.len().max(1) as f64).sqrt()
}
