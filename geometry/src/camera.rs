//! Real cameras: a pinhole behind a lens, validated.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

use crate::camera_parameters::error;
use crate::distortion::Distortion;
use crate::{CameraCorrection, CameraError, CameraModel, CameraParameters, CorrectedPixels, Pinhole};

/// Rays further than this from the optical axis are not undistorted: at 80 degrees one pixel of a fisheye
/// image already covers 33 of the ideal pinhole, and at 90 the pinhole has no image at all.
pub const MAX_UNDISTORTED_ANGLE_DEG: f64 = 80.0;

/// Samples along each side of the image when its border is examined.
const BORDER_SAMPLES: u32 = 64;

/// Samples along each side of the image when it is counted how much of it has rays.
const AREA_SAMPLES: u32 = 64;

/// A distortion that leaves less of the image than this is a mistake, and not one that folds in the corners.
const MIN_USABLE_SHARE: f64 = 0.5;

/// Where a point is seen, and how that depends on the point and on the calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationDerivatives {
    /// The pixel.
    pub pixel: Vector2<f64>,
    /// Its derivative by the point in the camera frame.
    pub d_pixel_d_point: Matrix2x3<f64>,
    /// Its derivatives by `fx fy cx cy` and the coefficients of the model, in their order.
    pub d_pixel_d_parameters: Vec<Vector2<f64>>,
}

/// A camera whose calibration has been checked: every pixel of the image belongs to one ray at most, and most
/// do to one. Those without are where the distortion folds back, and further than
/// [`MAX_UNDISTORTED_ANGLE_DEG`] from the axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    parameters: CameraParameters,
    /// Of the calibration: what the lens model is written in.
    nominal: Pinhole,
    correction: CameraCorrection,
    /// What the correction does to undistorted pixels.
    pixels: CorrectedPixels,
    distortion: Distortion,
    /// Least and greatest coordinates of what of the image is used, if that is not all of it.
    used: Option<[Vector2<f64>; 2]>,
}

impl Camera {
    /// Checks a calibration.
    ///
    /// # Errors
    /// A [`CameraError`] that names the first field that is wrong.
    pub fn new(mut parameters: CameraParameters) -> Result<Self, CameraError> {
        parameters.drop_zero_tail()?;
        parameters.check_numbers()?;
        let camera = Self::unchecked(parameters);
        camera.check_invertible()?;
        Ok(camera)
    }

    /// The share of the image where the distortion folds back, so that no ray belongs to a pixel; it is not
    /// used.
    pub fn folded_share(&self) -> f64 {
        if self.distortion.field_limit() >= MAX_UNDISTORTED_ANGLE_DEG.to_radians() - 1e-9 {
            return 0.0;
        }
        self.share_where(|pixel| self.unproject_nominal(pixel).is_none())
    }

    /// The share of the image further from the axis than [`MAX_UNDISTORTED_ANGLE_DEG`], which is not used,
    /// where the lens sees so far.
    pub fn share_beyond_reach(&self) -> f64 {
        if self.distortion == Distortion::None
            || self.distortion.field_limit() < MAX_UNDISTORTED_ANGLE_DEG.to_radians() - 1e-9
        {
            return 0.0;
        }
        self.share_where(|pixel| self.undistort_nominal(pixel).is_none())
    }

    /// The share of the image's pixels that are so.
    fn share_where(&self, is_so: impl Fn(&Vector2<f64>) -> bool) -> f64 {
        let [step_x, step_y] =
            [self.width(), self.height()].map(|side| f64::from(side) / f64::from(AREA_SAMPLES));
        let at = |i: u32, step: f64| (f64::from(i) + 0.5) * step - 0.5;
        let pixels = (0..AREA_SAMPLES)
            .flat_map(|y| (0..AREA_SAMPLES).map(move |x| Vector2::new(at(x, step_x), at(y, step_y))));
        pixels.filter(|pixel| is_so(pixel)).count() as f64 / f64::from(AREA_SAMPLES * AREA_SAMPLES)
    }

    /// What is doubtful about the calibration without keeping it from being used, sentences for the user.
    pub fn warnings(&self) -> Vec<String> {
        let beyond = self.share_beyond_reach();
        if beyond > 0.0 {
            return vec![format!(
                "{:.1} % of the image lie more than {MAX_UNDISTORTED_ANGLE_DEG} degrees from the axis, as far as a lens is \
                 followed, and are not used",
                100.0 * beyond
            )];
        }
        let folded = self.folded_share();
        if folded == 0.0 {
            return Vec::new();
        }
        let sentence = format!(
            "the {} distortion folds back {:.1} degrees from the axis: {:.1} % of the image, at its corners or borders, \
             are not used; a calibration with board corners there would show them",
            self.parameters.model.name(),
            self.distortion.field_limit().to_degrees(),
            100.0 * folded
        );
        vec![sentence]
    }

    /// A camera of numbers that are being looked for: finite, as many as the model has, but not checked
    /// otherwise.
    pub fn under_trial(parameters: CameraParameters) -> Self {
        Self::unchecked(parameters)
    }

    fn unchecked(parameters: CameraParameters) -> Self {
        let CameraParameters { fx, fy, cx, cy, .. } = parameters;
        let max_angle = MAX_UNDISTORTED_ANGLE_DEG.to_radians();
        let distortion = Distortion::new(parameters.model, &parameters.distortion, max_angle);
        let correction = CameraCorrection::default();
        let nominal = Pinhole { fx, fy, cx, cy };
        let pixels = CorrectedPixels::new(&nominal, &correction);
        Self { nominal, correction, pixels, distortion, parameters, used: None }
    }

    /// The calibration.
    pub fn parameters(&self) -> &CameraParameters {
        &self.parameters
    }

    /// Image width in pixels.
    #[inline]
    pub fn width(&self) -> u32 {
        self.parameters.width
    }

    /// Image height in pixels.
    #[inline]
    pub fn height(&self) -> u32 {
        self.parameters.height
    }

    /// The ideal camera with the focal lengths and principal point of the calibration. Undistorted pixels are
    /// its pixels, unless the correction bends them.
    #[inline]
    pub fn nominal_pinhole(&self) -> Pinhole {
        self.nominal
    }

    /// The ideal camera that sees the undistorted pixels: the nominal one, corrected.
    #[inline]
    pub fn pinhole(&self) -> Pinhole {
        self.correction.apply(&self.nominal)
    }

    /// This camera with another correction of its calibration. Unless it bends them, undistorted pixels stay
    /// as they are, only the rays they belong to change.
    #[must_use]
    pub fn with_correction(&self, correction: CameraCorrection) -> Self {
        let pixels = CorrectedPixels::new(&self.nominal, &correction);
        Self { correction, pixels, ..self.clone() }
    }

    /// This camera where no more of its image is used than a box with these least and greatest coordinates;
    /// all of it if `None`. Which pixels have rays stays; [`undistorted_bounds`](Self::undistorted_bounds)
    /// are those of the box.
    #[must_use]
    pub fn with_used_box(&self, used: Option<[Vector2<f64>; 2]>) -> Self {
        Self { used, ..self.clone() }
    }

    /// The calibration with what was found put right. Exact for a calibration without lens distortion; else
    /// the same to first order, as the lens model is written in the nominal focal lengths, and radial
    /// distortion that a model other than `radtan` cannot take up is left out.
    pub fn corrected_parameters(&self) -> CameraParameters {
        let Pinhole { fx, fy, cx, cy } = self.pinhole();
        let CameraParameters { mut model, mut distortion, width, height, .. } = self.parameters.clone();
        if self.correction.bends() {
            if model == CameraModel::Pinhole {
                (model, distortion) = (CameraModel::Radtan, vec![0.0; 4]);
            }
            if model == CameraModel::Radtan {
                distortion[0] += self.correction.k1;
                distortion[1] += self.correction.k2;
            }
        }
        CameraParameters { model, width, height, fx, fy, cx, cy, distortion }
    }

    /// How the camera differs from its calibration.
    #[inline]
    pub fn correction(&self) -> CameraCorrection {
        self.correction
    }

    /// Whether the lens bends what an ideal camera would see straight.
    #[inline]
    pub fn is_distorted(&self) -> bool {
        if self.correction.bends() {
            return true;
        }
        match self.parameters.model {
            CameraModel::Pinhole => false,
            CameraModel::Radtan => self.parameters.distortion.iter().any(|k| *k != 0.0),
            _ => true,
        }
    }

    /// The pixel where a point in the camera frame is seen, which may be outside the image. `None` if it is
    /// behind the camera or outside the field where the model is one-to-one.
    #[inline]
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        if self.correction.is_none() {
            return self.project_nominal(point_in_camera);
        }
        self.project_nominal(&(self.correction.nominal_from_corrected() * self.bend(point_in_camera)?))
    }

    /// The ray that is seen where `point_in_camera` is, had the correction no distortion. `None` beyond what
    /// it is one-to-one for.
    #[inline]
    fn bend(&self, point_in_camera: &Vector3<f64>) -> Option<Vector3<f64>> {
        let Some(radial) = self.pixels.radial() else { return Some(*point_in_camera) };
        let bent = Distortion::Radtan(*radial).project(point_in_camera)?;
        Some(bent.push(1.0))
    }

    fn project_nominal(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.distortion.project(point).map(|p| self.nominal.denormalized(&p))
    }

    /// As [`project`](Self::project), with the derivative of the pixel by the point.
    #[inline]
    pub fn project_with_jacobian(
        &self,
        point_in_camera: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let (bent, d_bent_d_point) = match self.pixels.radial() {
            None => (*point_in_camera, Matrix3::identity()),
            Some(radial) => {
                let (bent, jacobian) = Distortion::Radtan(*radial).project_with_jacobian(point_in_camera)?;
                let mut d_bent_d_point = Matrix3::zeros();
                d_bent_d_point.fixed_view_mut::<2, 3>(0, 0).copy_from(&jacobian);
                (bent.push(1.0), d_bent_d_point)
            }
        };
        let nominal_from_corrected = self.correction.nominal_from_corrected();
        let (p, mut jacobian) = self.distortion.project_with_jacobian(&(nominal_from_corrected * bent))?;
        for column in 0..3 {
            jacobian[(0, column)] *= self.nominal.fx;
            jacobian[(1, column)] *= self.nominal.fy;
        }
        Some((self.nominal.denormalized(&p), jacobian * nominal_from_corrected * d_bent_d_point))
    }

    /// As [`project`](Self::project) of the calibration without its correction, with the derivatives of the
    /// pixel by the point and by the calibration's numbers: `fx fy cx cy` and the coefficients.
    pub fn project_for_calibration(&self, point_in_camera: &Vector3<f64>) -> Option<CalibrationDerivatives> {
        let (seen, d_seen) = self.distortion.project_with_jacobian(point_in_camera)?;
        let Pinhole { fx, fy, .. } = self.nominal;
        let focals = Matrix2::new(fx, 0.0, 0.0, fy);
        let mut d_parameters = vec![
            Vector2::new(seen.x, 0.0),
            Vector2::new(0.0, seen.y),
            Vector2::new(1.0, 0.0),
            Vector2::new(0.0, 1.0),
        ];
        let n_coefficients = self.parameters.distortion.len();
        let by_coefficients = self.distortion.by_coefficients(point_in_camera, n_coefficients);
        d_parameters.extend(by_coefficients.into_iter().map(|column| focals * column));
        Some(CalibrationDerivatives {
            pixel: self.nominal.denormalized(&seen),
            d_pixel_d_point: focals * d_seen,
            d_pixel_d_parameters: d_parameters,
        })
    }

    /// The unit vector, in the camera frame, towards what is seen at `pixel`. `None` where the model has no
    /// unique answer.
    #[inline]
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let nominal = self.unproject_nominal(pixel)?;
        if self.correction.is_none() {
            return Some(nominal);
        }
        let bent = self.correction.corrected_from_nominal() * nominal;
        match self.pixels.radial() {
            None => Some(bent.normalize()),
            Some(_) if bent.z <= 0.0 => None,
            Some(radial) => Distortion::Radtan(*radial).unproject(&(bent.xy() / bent.z)),
        }
    }

    fn unproject_nominal(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        self.distortion.unproject(&self.nominal.normalized(pixel))
    }

    /// Where the corrected ideal pinhole sees what this camera sees at `pixel`. `None` further than
    /// [`MAX_UNDISTORTED_ANGLE_DEG`] from the axis.
    #[inline]
    pub fn undistort(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        self.undistort_nominal(pixel).map(|nominal_px| self.pixels.ideal(&nominal_px))
    }

    fn undistort_nominal(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        if self.distortion == Distortion::None {
            return (pixel.x.is_finite() && pixel.y.is_finite()).then_some(*pixel);
        }
        let bearing = self.unproject_nominal(pixel)?;
        (bearing.z > MAX_UNDISTORTED_ANGLE_DEG.to_radians().cos()).then(|| self.nominal.project(&bearing))
    }

    /// Where this camera sees what the corrected ideal pinhole sees at `pixel`; the inverse of
    /// [`undistort`](Self::undistort).
    #[inline]
    pub fn distort(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let p = self.nominal.normalized(&self.pixels.nominal(pixel));
        self.project_nominal(&Vector3::new(p.x, p.y, 1.0))
    }

    /// Least and greatest coordinates of the undistorted image, from its border. Parts of the border outside
    /// the usable field count as if they were at its edge.
    pub fn undistorted_bounds(&self) -> (Vector2<f64>, Vector2<f64>) {
        let max_radius = self.distortion.field_limit().min(MAX_UNDISTORTED_ANGLE_DEG.to_radians()).tan();
        let mut low = Vector2::repeat(f64::INFINITY);
        let mut high = Vector2::repeat(f64::NEG_INFINITY);
        for pixel in self.border() {
            let nominal_px = self.undistort_nominal(&pixel).unwrap_or_else(|| {
                let outwards = self.nominal.normalized(&pixel).normalize();
                self.nominal.denormalized(&(outwards * max_radius))
            });
            let undistorted = self.pixels.ideal(&nominal_px);
            low = low.inf(&undistorted);
            high = high.sup(&undistorted);
        }
        (low, high)
    }

    /// Whether `pixel`, of the distorted image, lies in the image.
    #[inline]
    pub fn contains(&self, pixel: &Vector2<f64>) -> bool {
        pixel.x >= -0.5
            && pixel.y >= -0.5
            && pixel.x < f64::from(self.parameters.width) - 0.5
            && pixel.y < f64::from(self.parameters.height) - 0.5
    }

    /// The camera of the image resized by `factor_x` and `factor_y`, where pixel `u` becomes
    /// `(u + 0.5) factor - 0.5`. Width and height are rounded to the nearest pixel and at least one.
    ///
    /// # Panics
    /// If a factor is not finite and positive.
    pub fn scaled(&self, factor_x: f64, factor_y: f64) -> Self {
        assert!(
            factor_x.is_finite() && factor_x > 0.0 && factor_y.is_finite() && factor_y > 0.0,
            "an image cannot be resized by {factor_x} x {factor_y}"
        );
        let side = |length: u32, factor: f64| (f64::from(length) * factor).round().max(1.0) as u32;
        let mut parameters = self.parameters.clone();
        parameters.width = side(parameters.width, factor_x);
        parameters.height = side(parameters.height, factor_y);
        parameters.fx *= factor_x;
        parameters.fy *= factor_y;
        parameters.cx = (parameters.cx + 0.5) * factor_x - 0.5;
        parameters.cy = (parameters.cy + 0.5) * factor_y - 0.5;
        let resized = |place: Vector2<f64>| {
            let [x, y] = [(place.x, factor_x), (place.y, factor_y)].map(|(at, by)| (at + 0.5) * by - 0.5);
            Vector2::new(x, y)
        };
        let used = self.used.map(|corners| corners.map(resized));
        Self::unchecked(parameters).with_correction(self.correction).with_used_box(used)
    }

    /// Pixels along the border of the image, or of what of it is used, corners included.
    fn border(&self) -> impl Iterator<Item = Vector2<f64>> {
        let whole =
            [Vector2::repeat(-0.5), Vector2::new(self.width().into(), self.height().into()).add_scalar(-0.5)];
        let [low, high] = self.used.map_or(whole, |[low, high]| [low.sup(&whole[0]), high.inf(&whole[1])]);
        let (left, top, right, bottom) = (low.x, low.y, high.x, high.y);
        (0..=BORDER_SAMPLES).flat_map(move |i| {
            let share = f64::from(i) / f64::from(BORDER_SAMPLES);
            let x = left + share * (right - left);
            let y = top + share * (bottom - top);
            [Vector2::new(x, top), Vector2::new(x, bottom), Vector2::new(left, y), Vector2::new(right, y)]
        })
    }

    fn check_invertible(&self) -> Result<(), CameraError> {
        if self.distortion.field_limit() >= MAX_UNDISTORTED_ANGLE_DEG.to_radians() - 1e-9 {
            return Ok(());
        }
        let folded = self.folded_share();
        if folded <= 1.0 - MIN_USABLE_SHARE {
            return Ok(());
        }
        Err(error(
            "distortion",
            format!(
                "distortion cannot be inverted over most of the image: the {} coefficients fold back {:.1} degrees from the \
                 axis, and {:.0} % of the image lie beyond. Are they in the order {}?",
                self.parameters.model.name(),
                self.distortion.field_limit().to_degrees(),
                100.0 * folded,
                self.parameters.model.coefficient_order()
            ),
        ))
    }
}
