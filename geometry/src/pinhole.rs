//! The ideal pinhole camera.

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// A camera without distortion: `u = fx x/z + cx`, `v = fy y/z + cy`.
///
/// The rest of the system works in the pixels of this camera; [`Camera`](crate::Camera) goes between these
/// and the pixels of the real image. All lengths are pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Horizontal focal length.
    pub fx: f64,
    /// Vertical focal length.
    pub fy: f64,
    /// Principal point, horizontal.
    pub cx: f64,
    /// Principal point, vertical.
    pub cy: f64,
}

impl Pinhole {
    /// The pixel of a point in the camera frame. The caller guarantees `z > 0`.
    #[inline]
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Vector2<f64> {
        let inverse_z = 1.0 / point_in_camera.z;
        Vector2::new(
            self.fx * point_in_camera.x * inverse_z + self.cx,
            self.fy * point_in_camera.y * inverse_z + self.cy,
        )
    }

    /// The pixel of a point in the camera frame and its derivative by that point. The caller guarantees
    /// `z > 0`.
    #[inline]
    pub fn project_with_jacobian(&self, point_in_camera: &Vector3<f64>) -> (Vector2<f64>, Matrix2x3<f64>) {
        let inverse_z = 1.0 / point_in_camera.z;
        let (x, y) = (point_in_camera.x * inverse_z, point_in_camera.y * inverse_z);
        let (fx, fy) = (self.fx * inverse_z, self.fy * inverse_z);
        let pixel = Vector2::new(self.fx * x + self.cx, self.fy * y + self.cy);
        (pixel, Matrix2x3::new(fx, 0.0, -fx * x, 0.0, fy, -fy * y))
    }

    /// The unit vector towards the scene point seen at `pixel`.
    #[inline]
    pub fn bearing(&self, pixel: &Vector2<f64>) -> Vector3<f64> {
        let p = self.normalized(pixel);
        Vector3::new(p.x, p.y, 1.0).normalize()
    }

    /// Where the ray of `pixel` meets the plane `z = 1`.
    #[inline]
    pub fn normalized(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy)
    }

    /// The pixel of the point `(p.x, p.y, 1)`; the inverse of [`normalized`](Self::normalized).
    #[inline]
    pub fn denormalized(&self, p: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.fx * p.x + self.cx, self.fy * p.y + self.cy)
    }

    /// The calibration matrix `K`.
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// `K⁻¹`.
    pub fn inverse_matrix(&self) -> Matrix3<f64> {
        let (fx, fy) = (1.0 / self.fx, 1.0 / self.fy);
        Matrix3::new(fx, 0.0, -self.cx * fx, 0.0, fy, -self.cy * fy, 0.0, 0.0, 1.0)
    }

    /// `det(K) K⁻ᵀ`: takes the moment `n` of a line in the camera frame to its image line.
    pub fn line_matrix(&self) -> Matrix3<f64> {
        let Self { fx, fy, cx, cy } = *self;
        Matrix3::new(fy, 0.0, 0.0, 0.0, fx, 0.0, -fy * cx, -fx * cy, fx * fy)
    }

    /// The mean of the two focal lengths: pixels per radian near the axis.
    #[inline]
    pub fn mean_focal_px(&self) -> f64 {
        0.5 * (self.fx + self.fy)
    }
}
