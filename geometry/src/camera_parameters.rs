//! Calibrations as users give them, number by number.

use thiserror::Error;

/// Largest width and height accepted, in pixels.
const MAX_SIDE_PX: u32 = 16_384;

/// Focal lengths in shares of the image's longer side: below are lengths in millimeters or of an image of
/// size one, above are views of less than a tenth of a degree.
const FOCAL_SHARES: std::ops::RangeInclusive<f64> = 0.05..=1000.0;

/// Coefficients of OpenCV's model that are not read, by their places behind the rational ones.
const THIN_PRISM: std::ops::Range<usize> = 8..12;
const TILT: std::ops::Range<usize> = 12..14;

/// The family of a camera's lens distortion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CameraModel {
    /// No distortion, no coefficients.
    Pinhole,
    /// Brown-Conrady, with 4, 5 or 8 coefficients in OpenCV's order `k1 k2 p1 p2 [k3 [k4 k5 k6]]`; 12 or 14
    /// if those behind, of thin prisms and a tilted sensor, are zero.
    Radtan,
    /// Equidistant fisheye with four coefficients `k1 k2 k3 k4`.
    KannalaBrandt,
    /// Field of view with one coefficient `ω`, in radians.
    Fov,
    /// Extended unified model with two coefficients `α β`; with `β = 1` the unified model.
    ExtendedUnified,
    /// Double sphere with two coefficients `ξ α`.
    DoubleSphere,
}

impl CameraModel {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Pinhole,
        Self::Radtan,
        Self::KannalaBrandt,
        Self::Fov,
        Self::ExtendedUnified,
        Self::DoubleSphere,
    ];

    /// The name users write.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pinhole => "pinhole",
            Self::Radtan => "radtan",
            Self::KannalaBrandt => "kannala-brandt",
            Self::Fov => "fov",
            Self::ExtendedUnified => "eucm",
            Self::DoubleSphere => "double-sphere",
        }
    }

    /// The coefficients in their order.
    pub fn coefficient_order(self) -> &'static str {
        match self {
            Self::Pinhole => "",
            Self::Radtan => "k1 k2 p1 p2 k3",
            Self::KannalaBrandt => "k1 k2 k3 k4",
            Self::Fov => "ω",
            Self::ExtendedUnified => "α β",
            Self::DoubleSphere => "ξ α",
        }
    }

    /// The numbers of distortion coefficients the model can have.
    pub fn coefficient_counts(self) -> &'static [usize] {
        match self {
            Self::Pinhole => &[0],
            Self::Radtan => &[4, 5, 8],
            Self::KannalaBrandt => &[4],
            Self::Fov => &[1],
            Self::ExtendedUnified | Self::DoubleSphere => &[2],
        }
    }
}

/// A calibration as users give it, not yet checked. Lengths are pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraParameters {
    /// The family of the distortion.
    pub model: CameraModel,
    /// Image width.
    pub width: u32,
    /// Image height.
    pub height: u32,
    /// Horizontal focal length.
    pub fx: f64,
    /// Vertical focal length.
    pub fy: f64,
    /// Principal point, horizontal; zero is the center of the leftmost pixel.
    pub cx: f64,
    /// Principal point, vertical; zero is the center of the topmost pixel.
    pub cy: f64,
    /// Coefficients of the model, see [`CameraModel`].
    pub distortion: Vec<f64>,
}

/// Why a calibration was refused: a sentence that names the field.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{message}")]
pub struct CameraError {
    /// The field of [`CameraParameters`] at fault.
    pub field: &'static str,
    /// A sentence for the user.
    pub message: String,
}

impl CameraParameters {
    /// A camera of which only the focal length is known, pixels: without distortion, its principal point in
    /// the middle of the image.
    pub fn of_focal_length(width: u32, height: u32, focal_px: f64) -> Self {
        let [cx, cy] = [width, height].map(|side| 0.5 * (f64::from(side) - 1.0));
        let (fx, fy, distortion) = (focal_px, focal_px, Vec::new());
        Self { model: CameraModel::Pinhole, width, height, fx, fy, cx, cy, distortion }
    }

    /// The same of a field of view across the longer side of the image, degrees.
    pub fn of_field_of_view(width: u32, height: u32, fov_deg: f64) -> Self {
        let focal_px = 0.5 * f64::from(width.max(height)) / (0.5 * fov_deg.to_radians()).tan();
        Self::of_focal_length(width, height, focal_px)
    }

    /// Takes off the coefficients of thin prisms and of a tilted sensor, which must be zero.
    pub(crate) fn drop_zero_tail(&mut self) -> Result<(), CameraError> {
        let n = self.distortion.len();
        if self.model != CameraModel::Radtan || !(n == THIN_PRISM.end || n == TILT.end) {
            return Ok(());
        }
        for (range, name) in [(THIN_PRISM, "thin prism (s1 to s4)"), (TILT, "tilted sensor (tx, ty)")] {
            let used = range.clone().find(|i| self.distortion.get(*i).is_some_and(|k| *k != 0.0));
            if let Some(i) = used {
                return Err(error(
                    "distortion",
                    format!(
                        "distortion by a {name} is not supported, and coefficient {i} is {}; calibrate without it \
                         (OpenCV's CALIB_RATIONAL_MODEL at most)",
                        shown(self.distortion[i])
                    ),
                ));
            }
        }
        self.distortion.truncate(THIN_PRISM.start);
        Ok(())
    }

    /// Each number by itself.
    pub(crate) fn check_numbers(&self) -> Result<(), CameraError> {
        for (field, side) in [("width", self.width), ("height", self.height)] {
            if !(1..=MAX_SIDE_PX).contains(&side) {
                return Err(error(
                    field,
                    format!("{field} must be between 1 and {MAX_SIDE_PX} pixels, not {side}"),
                ));
            }
        }
        let longer = f64::from(self.width.max(self.height));
        for (field, focal) in [("fx", self.fx), ("fy", self.fy)] {
            if !(focal.is_finite() && focal > 0.0) {
                return Err(error(
                    field,
                    format!("{field} must be a positive focal length in pixels, not {}", shown(focal)),
                ));
            }
            if !FOCAL_SHARES.contains(&(focal / longer)) {
                let (least, most) = (FOCAL_SHARES.start() * longer, FOCAL_SHARES.end() * longer);
                let hint = if focal < least {
                    "; millimeters become pixels when divided by the width of the sensor and multiplied by that of the image"
                } else {
                    ""
                };
                return Err(error(
                    field,
                    format!(
                        "{field} must be a focal length in pixels, between {least} and {most} for images of {}x{}, not \
                         {}{hint}",
                        self.width,
                        self.height,
                        shown(focal)
                    ),
                ));
            }
        }
        for (field, center, side) in [("cx", self.cx, self.width), ("cy", self.cy, self.height)] {
            let end = f64::from(side) - 0.5;
            if !(center >= -0.5 && center <= end) {
                return Err(error(
                    field,
                    format!(
                        "{field} must be inside the image, between -0.5 and {end}, not {}",
                        shown(center)
                    ),
                ));
            }
        }
        self.check_coefficients()
    }

    fn check_coefficients(&self) -> Result<(), CameraError> {
        let counts = self.model.coefficient_counts();
        if !counts.contains(&self.distortion.len()) {
            let allowed = counts.iter().map(ToString::to_string).collect::<Vec<_>>().join(" or ");
            return Err(error(
                "distortion",
                format!(
                    "distortion of the {} model must have {allowed} coefficients, not {}",
                    self.model.name(),
                    self.distortion.len()
                ),
            ));
        }
        if let Some((i, k)) = self.distortion.iter().enumerate().find(|(_, k)| !k.is_finite()) {
            return Err(error("distortion", format!("distortion coefficient {i} must be finite, not {k}")));
        }
        if self.model == CameraModel::Fov && !(1e-6..3.1).contains(&self.distortion[0]) {
            return Err(error(
                "distortion",
                format!(
                    "distortion of the fov model must be an angle between 0.000001 and 3.1 radians, not {}",
                    shown(self.distortion[0])
                ),
            ));
        }
        self.check_spheres()
    }

    /// What the coefficients of the models with spheres can be.
    fn check_spheres(&self) -> Result<(), CameraError> {
        let (alpha, other, name, least, most) = match self.model {
            CameraModel::ExtendedUnified => (self.distortion[0], self.distortion[1], "β", 1e-3, 1e3),
            CameraModel::DoubleSphere => (self.distortion[1], self.distortion[0], "ξ", -0.999, 1.0),
            _ => return Ok(()),
        };
        let model = self.model.name();
        if !(0.0..=1.0).contains(&alpha) {
            let message = format!("α of the {model} model must be between 0 and 1, not {}", shown(alpha));
            return Err(error("distortion", message));
        }
        if !(least..=most).contains(&other) {
            let message = format!(
                "{name} of the {model} model must be between {least} and {most}, not {}",
                shown(other)
            );
            return Err(error("distortion", message));
        }
        Ok(())
    }
}

/// A number as people read it: one that cannot be meant may have hundreds of digits.
fn shown(number: f64) -> String {
    if number.abs() < 1e9 { number.to_string() } else { format!("{number:e}") }
}

/// The refusal of a field.
pub(crate) fn error(field: &'static str, message: String) -> CameraError {
    CameraError { field, message }
}
