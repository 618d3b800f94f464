//! Directions without a sign: the manifold of vanishing directions.

use nalgebra::{Matrix3x2, UnitQuaternion, Vector2, Vector3};

/// How far a stored unit vector may be from unit length: rounding makes far less.
const MAX_STORED_ERROR: f64 = 1e-9;

/// A unit vector that equals its negative, such as the common direction of parallel lines.
///
/// The sign is fixed on construction, so equal directions have equal coordinates. Tangent vectors are two
/// coordinates in [`basis`](Self::basis).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    vector: Vector3<f64>,
}

impl Direction {
    /// The direction of `vector`, of any length and sign. `None` if it is zero or not finite.
    pub fn new(vector: Vector3<f64>) -> Option<Self> {
        // Scaled by the largest component first, so that squares neither overflow nor vanish.
        let largest = vector.amax();
        if !(largest.is_finite() && largest > 0.0 && vector.iter().all(|x| x.is_finite())) {
            return None;
        }
        Some(Self::from_nonzero(vector / largest))
    }

    /// A direction that was one before, taken over bit for bit: for what was stored. `None` if the vector is
    /// not of unit length or its sign is not the one the constructor gives.
    pub fn from_stored(vector: Vector3<f64>) -> Option<Self> {
        let direction = Self::new(vector)?;
        let is_same = (direction.vector - vector).amax() <= MAX_STORED_ERROR;
        is_same.then_some(Self { vector })
    }

    /// Normalizes and fixes the sign: the last component that is not zero is positive.
    #[inline]
    fn from_nonzero(vector: Vector3<f64>) -> Self {
        let unit = vector.normalize();
        let leading = if unit.z != 0.0 {
            unit.z
        } else if unit.y != 0.0 {
            unit.y
        } else {
            unit.x
        };
        Self { vector: if leading < 0.0 { -unit } else { unit } }
    }

    /// The representative unit vector.
    #[inline]
    pub fn as_vector(&self) -> &Vector3<f64> {
        &self.vector
    }

    /// Two orthonormal vectors orthogonal to the direction. Depends on nothing but the direction.
    #[inline]
    pub fn basis(&self) -> Matrix3x2<f64> {
        let d = &self.vector;
        let axis = match d.iamin() {
            0 => Vector3::x(),
            1 => Vector3::y(),
            _ => Vector3::z(),
        };
        let first = d.cross(&axis).normalize();
        Matrix3x2::from_columns(&[first, d.cross(&first)])
    }

    /// Moves along the great circle that starts in the tangent direction `delta`, by `|delta|` radians.
    #[inline]
    pub fn retract(&self, delta: &Vector2<f64>) -> Self {
        let angle2 = delta.norm_squared();
        let (sinc, _) = crate::so3::sinc_and_cosc(angle2);
        Self::from_nonzero(self.vector * angle2.sqrt().cos() + self.basis() * (delta * sinc))
    }

    /// The shortest `delta` with `self.retract(delta) == other`; its length is the angle between the axes.
    #[inline]
    pub fn local(&self, other: &Self) -> Vector2<f64> {
        let cos = self.vector.dot(&other.vector);
        let tangent = self.basis().transpose() * other.vector * if cos < 0.0 { -1.0 } else { 1.0 };
        let sin = tangent.norm();
        if sin < 1e-9 { tangent } else { tangent * (sin.atan2(cos.abs()) / sin) }
    }

    /// The angle between the two axes, in `[0, π/2]`.
    #[inline]
    pub fn angle(&self, other: &Self) -> f64 {
        self.vector.cross(&other.vector).norm().atan2(self.vector.dot(&other.vector).abs())
    }

    /// The direction seen from a rotated frame, `R d`.
    #[inline]
    pub fn rotated(&self, rotation: &UnitQuaternion<f64>) -> Self {
        Self::from_nonzero(rotation * self.vector)
    }
}
