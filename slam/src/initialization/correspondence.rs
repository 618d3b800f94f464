//! A match of two views in the coordinates that the solvers want.

use crate::features::FrameFeatures;
use geometry::Pinhole;
use geometry::nalgebra::{Matrix3, Vector2, Vector3};

/// One match in the coordinates the solvers want.
#[derive(Clone, Copy, Debug)]
pub(super) struct Correspondence {
    /// Normalized image coordinates, (pixel - center) / focal length.
    pub first: Vector2<f64>,
    pub second: Vector2<f64>,
    pub first_bearing: Vector3<f64>,
    pub second_bearing: Vector3<f64>,
    /// Variances of the positions, normalized coordinates squared.
    pub first_variance: f64,
    pub second_variance: f64,
}

impl Correspondence {
    /// A match of normalized coordinates, for tests.
    #[cfg(test)]
    pub fn of_normalized(first: Vector2<f64>, second: Vector2<f64>, variance: f64) -> Self {
        Self {
            first,
            second,
            first_bearing: first.push(1.0).normalize(),
            second_bearing: second.push(1.0).normalize(),
            first_variance: variance,
            second_variance: variance,
        }
    }

    pub fn new(first: &FrameFeatures, first_idx: usize, second: &FrameFeatures, second_idx: usize) -> Self {
        let variance = |features: &FrameFeatures, idx: usize| {
            let sigma = features.sigma_px(idx) / features.pinhole.mean_focal_px();
            sigma * sigma
        };
        let of = |pinhole: &Pinhole, pixel| (pinhole.normalized(pixel), pinhole.bearing(pixel));
        let (a, first_bearing) = of(&first.pinhole, &first.undistorted[first_idx]);
        let (b, second_bearing) = of(&second.pinhole, &second.undistorted[second_idx]);
        Self {
            first: a,
            second: b,
            first_bearing,
            second_bearing,
            first_variance: variance(first, first_idx),
            second_variance: variance(second, second_idx),
        }
    }

    /// Squared first-order distance to the epipolar constraint, in standard deviations [Sampson].
    #[inline]
    pub fn squared_sampson(&self, essential: &Matrix3<f64>) -> f64 {
        let (a, b) = (self.first.push(1.0), self.second.push(1.0));
        let (line_in_second, line_in_first) = (essential * a, essential.transpose() * b);
        let error = b.dot(&line_in_second);
        let variance = line_in_second.xy().norm_squared() * self.second_variance
            + line_in_first.xy().norm_squared() * self.first_variance;
        error * error / variance
    }
}
