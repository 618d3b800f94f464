//! Uniform cubic B-splines: twice continuously differentiable, and inside the hull of four control points.

use nalgebra::SVector;

/// A curve over `[0, n_spans]` in knot units.
#[derive(Clone, Debug)]
pub(crate) struct UniformSpline<const N: usize> {
    controls: Vec<SVector<f64, N>>,
}

impl<const N: usize> UniformSpline<N> {
    /// A curve that starts near the first control point and ends near the last (both are repeated, so that
    /// the curve reaches them).
    pub fn new(points: &[SVector<f64, N>]) -> Self {
        let (first, last) = (points[0], points[points.len() - 1]);
        let mut controls = vec![first, first];
        controls.extend_from_slice(points);
        controls.extend([last, last]);
        Self { controls }
    }

    pub fn n_spans(&self) -> usize {
        self.controls.len() - 3
    }

    /// The curve at `knot`, clamped to its ends.
    pub fn at(&self, knot: f64) -> SVector<f64, N> {
        let knot = knot.clamp(0.0, self.n_spans() as f64);
        let span = (knot as usize).min(self.n_spans() - 1);
        let t = knot - span as f64;
        let (t2, t3) = (t * t, t * t * t);
        let weights = [
            (1.0 - t).powi(3) / 6.0,
            (3.0 * t3 - 6.0 * t2 + 4.0) / 6.0,
            (-3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0) / 6.0,
            t3 / 6.0,
        ];
        (0..4).map(|i| self.controls[span + i] * weights[i]).sum()
    }
}
