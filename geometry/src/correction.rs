//! How a camera differs from what was said of it.

use nalgebra::{Matrix3, Vector2};

use crate::Pinhole;
use crate::camera::MAX_UNDISTORTED_ANGLE_DEG;
use crate::distortion::Radtan;

/// How a camera differs from its calibration in focal length, principal point and radial distortion; the same
/// at every size of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraCorrection {
    /// Relative change of both focal lengths.
    pub focal: f64,
    /// Shift of the principal point to the right, in horizontal focal lengths of the calibration.
    pub center_x: f64,
    /// Shift of the principal point downwards, in vertical focal lengths of the calibration.
    pub center_y: f64,
    /// Radial distortion that the calibration does not describe, about the corrected principal point: a ray
    /// through `p` of the plane `z = 1` is seen where an undistorted one through `p (1 + k1 r² + k2 r⁴)`
    /// would be.
    pub k1: f64,
    /// See [`k1`](Self::k1).
    pub k2: f64,
}

impl CameraCorrection {
    /// The corrected ideal camera.
    pub fn apply(&self, nominal: &Pinhole) -> Pinhole {
        Pinhole {
            fx: nominal.fx * (1.0 + self.focal),
            fy: nominal.fy * (1.0 + self.focal),
            cx: nominal.cx + nominal.fx * self.center_x,
            cy: nominal.cy + nominal.fy * self.center_y,
        }
    }

    /// Whether it changes nothing.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Whether it bends what the calibration has straight.
    #[inline]
    pub fn bends(&self) -> bool {
        self.k1 != 0.0 || self.k2 != 0.0
    }

    /// Whether all its members are finite and the camera still sees.
    pub fn leaves_a_camera(&self) -> bool {
        let Self { focal, center_x, center_y, k1, k2 } = *self;
        [focal, center_x, center_y, k1, k2].iter().all(|value| value.is_finite()) && focal > -1.0
    }

    /// Takes a ray of the corrected camera, its distortion applied, to that of the nominal one which is seen
    /// at the same pixel. Linear in the ray.
    pub fn nominal_from_corrected(&self) -> Matrix3<f64> {
        let focal = 1.0 + self.focal;
        Matrix3::new(focal, 0.0, self.center_x, 0.0, focal, self.center_y, 0.0, 0.0, 1.0)
    }

    /// Reverses [`nominal_from_corrected`](Self::nominal_from_corrected).
    pub fn corrected_from_nominal(&self) -> Matrix3<f64> {
        let by_focal = 1.0 / (1.0 + self.focal);
        let (x, y) = (-self.center_x * by_focal, -self.center_y * by_focal);
        Matrix3::new(by_focal, 0.0, x, 0.0, by_focal, y, 0.0, 0.0, 1.0)
    }

    /// The radial distortion, if there is any.
    pub(crate) fn radial(&self) -> Option<Radtan> {
        let coefficients = [self.k1, self.k2, 0.0, 0.0];
        self.bends().then(|| Radtan::new(&coefficients, MAX_UNDISTORTED_ANGLE_DEG.to_radians()))
    }
}

/// Goes between the undistorted pixels of a calibration and those of the camera as it was found to be. The
/// same pixels where the correction bends nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectedPixels {
    corrected: Pinhole,
    radial: Option<Radtan>,
}

impl CorrectedPixels {
    /// For a calibration and what it is corrected by.
    pub fn new(nominal: &Pinhole, correction: &CameraCorrection) -> Self {
        Self { corrected: correction.apply(nominal), radial: correction.radial() }
    }

    /// The distortion that the correction adds.
    #[inline]
    pub(crate) fn radial(&self) -> Option<&Radtan> {
        self.radial.as_ref()
    }

    /// Where the corrected ideal camera sees what the calibration sees at `nominal_px`. Beyond the circle
    /// where the distortion is one-to-one it goes on as at its edge.
    pub fn ideal(&self, nominal_px: &Vector2<f64>) -> Vector2<f64> {
        let Some(radial) = &self.radial else { return *nominal_px };
        self.corrected.denormalized(&radial.undistort_anywhere(&self.corrected.normalized(nominal_px)))
    }

    /// Reverses [`ideal`](Self::ideal).
    pub fn nominal(&self, ideal_px: &Vector2<f64>) -> Vector2<f64> {
        let Some(radial) = &self.radial else { return *ideal_px };
        self.corrected.denormalized(&radial.distort_anywhere(&self.corrected.normalized(ideal_px)))
    }
}
