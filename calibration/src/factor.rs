//! How far a corner lies from where the camera under calibration sees it.

use geometry::nalgebra::{Matrix2x6, SMatrix, SVector, Vector2, Vector3};
use geometry::{Camera, CameraModel, CameraParameters, Pose, so3};
use optim::{Factor, Linearized};

/// The most numbers a camera model has: `fx fy cx cy` and five coefficients.
pub const N_NUMBERS: usize = 9;

/// `fx fy cx cy` and the coefficients of the model; those it does not have are zero.
pub type CameraVector = SVector<f64, N_NUMBERS>;

/// A camera's kind and size, by which numbers become a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraKind {
    /// The family of lens distortion.
    pub model: CameraModel,
    /// Coefficients of the model that are looked for, at most five.
    pub n_coefficients: usize,
    /// Width and height, pixels.
    pub size: (u32, u32),
}

impl CameraKind {
    /// Of the model with its usual number of coefficients.
    pub fn new(model: CameraModel, n_coefficients: usize, size: (u32, u32)) -> Self {
        Self { model, n_coefficients, size }
    }

    /// Numbers of the camera.
    pub fn n_numbers(&self) -> usize {
        4 + self.n_coefficients
    }

    /// The calibration of these numbers.
    pub fn parameters(&self, numbers: &CameraVector) -> CameraParameters {
        let distortion = numbers.as_slice()[4..self.n_numbers()].to_vec();
        CameraParameters {
            model: self.model,
            width: self.size.0,
            height: self.size.1,
            fx: numbers[0],
            fy: numbers[1],
            cx: numbers[2],
            cy: numbers[3],
            distortion,
        }
    }

    /// The camera of these numbers, as far as they are one.
    pub fn camera(&self, numbers: &CameraVector) -> Option<Camera> {
        let is_camera = numbers.iter().all(|x| x.is_finite()) && numbers[0] > 0.0 && numbers[1] > 0.0;
        let d = numbers.as_slice();
        let is_lens = match self.model {
            CameraModel::Fov => (1e-6..3.1).contains(&d[4]),
            CameraModel::ExtendedUnified => (0.0..=1.0).contains(&d[4]) && d[5] > 1e-3,
            CameraModel::DoubleSphere => (-0.999..=1.0).contains(&d[4]) && (0.0..=1.0).contains(&d[5]),
            _ => true,
        };
        (is_camera && is_lens).then(|| Camera::under_trial(self.parameters(numbers)))
    }
}

/// Distance of a corner from its projection, in standard deviations, with the camera and the board's pose as
/// unknowns.
///
/// `r(c, T) = (z - π_c(T X)) / σ` with `c` a [`CameraVector`], `T` `camera_from_board`, `X` the corner on the
/// board. Not defined where the model sees nothing.
#[derive(Clone, Copy, Debug)]
pub struct CornerFactor {
    /// What the numbers are of.
    pub kind: CameraKind,
    /// The corner on the board, meters.
    pub corner: Vector3<f64>,
    /// Where it was seen, pixels.
    pub observed_px: Vector2<f64>,
    /// One over the standard deviation of that, 1/pixels.
    pub inverse_sigma: f64,
}

impl Factor for CornerFactor {
    type Residual = Vector2<f64>;
    type Variables = (CameraVector, Pose);

    fn residual(&self, (numbers, camera_from_board): (&CameraVector, &Pose)) -> Option<Vector2<f64>> {
        let camera = self.kind.camera(numbers)?;
        let seen = camera.project(&camera_from_board.transform(&self.corner))?;
        Some((self.observed_px - seen) * self.inverse_sigma)
    }

    fn linearize(&self, (numbers, camera_from_board): (&CameraVector, &Pose)) -> Option<Linearized<Self>> {
        let camera = self.kind.camera(numbers)?;
        let in_camera = camera_from_board.transform(&self.corner);
        let seen = camera.project_for_calibration(&in_camera)?;
        let mut d_numbers = SMatrix::<f64, 2, N_NUMBERS>::zeros();
        for (idx, column) in seen.d_pixel_d_parameters.iter().enumerate() {
            d_numbers.set_column(idx, &(column * -self.inverse_sigma));
        }
        let d_point = seen.d_pixel_d_point * -self.inverse_sigma;
        let mut d_pose = Matrix2x6::zeros();
        d_pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&(d_point * -so3::skew(&in_camera)));
        d_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&d_point);
        Some(((self.observed_px - seen.pixel) * self.inverse_sigma, (d_numbers, d_pose)))
    }
}

/// Holds numbers of a camera: `r(c) = w (c - m)`, member by member.
#[derive(Clone, Copy, Debug)]
pub struct NumbersPriorFactor {
    /// What is expected.
    pub mean: CameraVector,
    /// One over the standard deviations; zero where nothing is known.
    pub inverse_sigmas: CameraVector,
}

impl Factor for NumbersPriorFactor {
    type Residual = CameraVector;
    type Variables = (CameraVector,);

    fn residual(&self, (numbers,): (&CameraVector,)) -> Option<CameraVector> {
        Some(self.inverse_sigmas.component_mul(&(numbers - self.mean)))
    }

    fn linearize(&self, (numbers,): (&CameraVector,)) -> Option<Linearized<Self>> {
        Some((self.residual((numbers,))?, (SMatrix::from_diagonal(&self.inverse_sigmas),)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Vector6;

    #[test]
    fn jacobians_match_central_differences() {
        for (model, coefficients) in [
            (CameraModel::Pinhole, &[][..]),
            (CameraModel::Radtan, &[-0.28, 0.07, 0.0002, -0.0003, 0.01]),
            (CameraModel::KannalaBrandt, &[0.01, -0.02, 0.003, 0.001]),
            (CameraModel::Fov, &[0.9]),
            (CameraModel::ExtendedUnified, &[0.6, 1.1]),
            (CameraModel::DoubleSphere, &[-0.2, 0.6]),
        ] {
            let kind = CameraKind::new(model, coefficients.len(), (640, 480));
            let mut numbers = CameraVector::zeros();
            numbers.as_mut_slice()[..4].copy_from_slice(&[400.0, 402.0, 320.0, 241.0]);
            numbers.as_mut_slice()[4..4 + coefficients.len()].copy_from_slice(coefficients);
            let pose = Pose::exp(&Vector6::new(0.2, -0.3, 0.1, 0.05, -0.02, 0.6));
            let (corner, observed_px) = (Vector3::new(0.1, 0.2, 0.0), Vector2::new(300.0, 200.0));
            let factor = CornerFactor { kind, corner, observed_px, inverse_sigma: 0.5 };
            optim::testing::assert_jacobians_match(&factor, &(numbers, pose), 1e-6, 1e-4);
            let prior = NumbersPriorFactor { mean: numbers * 0.9, inverse_sigmas: CameraVector::repeat(2.0) };
            optim::testing::assert_jacobians_match(&prior, &(numbers,), 1e-6, 1e-5);
        }
    }
}
