//! The main axis of second moments in the plane.

use nalgebra::Vector2;

/// Sums of the products of offsets from a center: what a total least-squares line needs.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Scatter {
    xx: f32,
    xy: f32,
    yy: f32,
}

impl Scatter {
    /// Adds `weight * offset * offset^T`.
    pub fn add(&mut self, offset: Vector2<f32>, weight: f32) {
        self.xx += weight * offset.x * offset.x;
        self.xy += weight * offset.x * offset.y;
        self.yy += weight * offset.y * offset.y;
    }

    /// The direction of most scatter, a unit vector within a right angle of `towards`; and the scatter across
    /// it.
    pub fn main_axis(&self, towards: Vector2<f32>) -> (Vector2<f32>, f32) {
        let angle = 0.5 * (2.0 * self.xy).atan2(self.xx - self.yy);
        let axis = Vector2::new(angle.cos(), angle.sin());
        let across = axis.y * axis.y * self.xx - 2.0 * axis.x * axis.y * self.xy + axis.x * axis.x * self.yy;
        (if axis.dot(&towards) < 0.0 { -axis } else { axis }, across.max(0.0))
    }
}
