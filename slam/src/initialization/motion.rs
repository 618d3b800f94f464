//! Relative pose refinement: rotation and direction of translation that agree best with the matches, from
//! many starts.
//!
//! Over a short baseline turning and moving sideways look alike, and a nearly planar scene has a second
//! motion that explains it: the cost has several minima, and a search from one start may end in a wrong one.

use super::correspondence::Correspondence;
use geometry::nalgebra::{Matrix1, SMatrix, SVector, UnitQuaternion, Vector1, Vector3};
use geometry::{Direction, Pose, so3};
use optim::{Factor, Kernel, Linearized, Manifold, SingleOptions, UnaryGroup, optimize_single};

/// Directions of motion tried from a rotation, spread evenly over a half sphere (the sign does not matter
/// here).
const N_DIRECTIONS: usize = 16;
/// Matches that take part in the search, evenly picked; all of them judge the result.
const N_SEARCH_MATCHES: usize = 150;
/// Scale of the robust kernel, standard deviations: real matches are better than the assumed pixel.
const KERNEL_SCALE: f64 = 1.0;

/// A motion up to the length of its baseline.
#[derive(Clone, Copy, Debug)]
pub(super) struct RelativeMotion {
    pub rotation: UnitQuaternion<f64>,
    /// Unit vector of the translation of `second_from_first`.
    pub direction: Vector3<f64>,
}

impl RelativeMotion {
    pub fn of(second_from_first: &Pose) -> Self {
        Self { rotation: second_from_first.rotation, direction: second_from_first.translation.normalize() }
    }

    /// The pose with unit baseline, forwards or backwards.
    pub fn to_pose(self, sign: f64) -> Pose {
        Pose::new(self.rotation, self.direction * sign)
    }

    /// Two vectors that span the plane across the direction.
    fn tangents(&self) -> SMatrix<f64, 3, 2> {
        Direction::new(self.direction).map_or_else(SMatrix::zeros, |direction| direction.basis())
    }
}

/// Tangent order: rotation (3, on the left), direction (2).
impl Manifold for RelativeMotion {
    type Tangent = SVector<f64, 5>;

    fn retract(&self, delta: &SVector<f64, 5>) -> Self {
        let turn = so3::exp(&delta.fixed_rows::<3>(0).into_owned());
        let moved = self.direction + self.tangents() * delta.fixed_rows::<2>(3);
        Self {
            rotation: UnitQuaternion::new_normalize((turn * self.rotation).into_inner()),
            direction: moved.normalize(),
        }
    }

    fn local(&self, other: &Self) -> SVector<f64, 5> {
        let turn = so3::log(&(other.rotation * self.rotation.inverse()));
        let moved = other.direction / other.direction.dot(&self.direction) - self.direction;
        let across = self.tangents().transpose() * moved;
        SVector::from([turn.x, turn.y, turn.z, across.x, across.y])
    }
}

/// Distance of a match from the epipolar constraint, to first order and in standard deviations [Sampson
/// 1982].
///
/// `r(R, d) = b·(d × R a) / s`, with `a`, `b` the homogeneous normalized coordinates in the two views and `s`
/// the standard deviation that their noise gives the numerator. The derivative takes `s` as constant, which
/// is exact where `r` vanishes.
#[derive(Clone, Copy, Debug)]
struct SampsonFactor {
    correspondence: Correspondence,
}

impl SampsonFactor {
    fn numerator_and_sigma(&self, motion: &RelativeMotion) -> (f64, f64) {
        let c = &self.correspondence;
        let (a, b) = (c.first.push(1.0), c.second.push(1.0));
        let line_in_second = motion.direction.cross(&(motion.rotation * a));
        let line_in_first = motion.rotation.inverse() * b.cross(&motion.direction);
        let variance = line_in_second.xy().norm_squared() * c.second_variance
            + line_in_first.xy().norm_squared() * c.first_variance;
        (b.dot(&line_in_second), variance.sqrt())
    }
}

impl Factor for SampsonFactor {
    type Residual = Vector1<f64>;
    type Variables = (RelativeMotion,);

    fn residual(&self, (motion,): (&RelativeMotion,)) -> Option<Vector1<f64>> {
        let (numerator, sigma) = self.numerator_and_sigma(motion);
        (sigma > 0.0).then(|| Vector1::new(numerator / sigma))
    }

    fn linearize(&self, (motion,): (&RelativeMotion,)) -> Option<Linearized<Self>> {
        let (numerator, sigma) = self.numerator_and_sigma(motion);
        if sigma <= 0.0 {
            return None;
        }
        let turned = motion.rotation * self.correspondence.first.push(1.0);
        let b = self.correspondence.second.push(1.0);
        let d_rotation = turned.cross(&b.cross(&motion.direction)) / sigma;
        let d_direction = motion.tangents().transpose() * (turned.cross(&b) / sigma);
        let jacobian = SMatrix::<f64, 1, 5>::from_row_slice(&[
            d_rotation.x,
            d_rotation.y,
            d_rotation.z,
            d_direction.x,
            d_direction.y,
        ]);
        Some((Matrix1::new(numerator / sigma), (jacobian,)))
    }
}

/// The minima of the cost reached from the given motions, and from their first one's rotation with every
/// direction.
pub(super) fn minima(starts: &[RelativeMotion], correspondences: &[Correspondence]) -> Vec<RelativeMotion> {
    let step = correspondences.len().div_ceil(N_SEARCH_MATCHES).max(1);
    let factors: Vec<SampsonFactor> =
        correspondences.iter().step_by(step).map(|c| SampsonFactor { correspondence: *c }).collect();
    let around = starts.first().into_iter().flat_map(|start| {
        half_sphere().map(|direction| RelativeMotion { rotation: start.rotation, direction })
    });
    let options =
        SingleOptions { n_rounds: 1, n_robust_rounds: 1, max_iterations: 20, ..SingleOptions::default() };
    let kernel = Kernel::Cauchy { scale: KERNEL_SCALE };
    let mut group = UnaryGroup::new(kernel, f64::INFINITY, factors);
    starts
        .iter()
        .copied()
        .chain(around)
        .map(|start| optimize_single(&start, &mut [&mut group], &options).value)
        .collect()
}

/// Unit vectors spread evenly over a half sphere, on a Fibonacci spiral.
fn half_sphere() -> impl Iterator<Item = Vector3<f64>> {
    let golden_angle = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..N_DIRECTIONS).map(move |i| {
        let z = (i as f64 + 0.5) / N_DIRECTIONS as f64;
        let (sin, cos) = (golden_angle * i as f64).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        Vector3::new(radius * cos, radius * sin, z)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::{Vector2, Vector6};

    fn correspondences(second_from_first: &Pose, noise: f64) -> Vec<Correspondence> {
        (0..200)
            .map(|i| {
                let s = f64::from(i);
                let point = Vector3::new((1.3 * s).sin(), (2.1 * s).cos(), 3.0 + (0.7 * s).sin());
                let shake =
                    |phase: f64| Vector2::new((17.0 * s + phase).sin(), (23.0 * s + phase).cos()) * noise;
                let second = second_from_first.transform(&point);
                Correspondence::of_normalized(
                    point.xy() / point.z + shake(0.0),
                    second.xy() / second.z + shake(1.0),
                    1e-6,
                )
            })
            .collect()
    }

    #[test]
    fn the_true_motion_is_among_the_minima_from_a_wrong_start() {
        let truth = Pose::exp(&Vector6::new(0.02, -0.03, 0.01, 0.1, 0.02, -0.03));
        let found = minima(
            &[RelativeMotion { rotation: UnitQuaternion::identity(), direction: Vector3::z() }],
            &correspondences(&truth, 2e-4),
        );
        let off = |motion: &RelativeMotion| {
            let direction = motion.direction.cross(&truth.translation.normalize()).norm();
            so3::angle_between(&motion.rotation, &truth.rotation).max(direction)
        };
        let best = found.iter().map(off).fold(f64::INFINITY, f64::min);
        assert!(best < 0.03, "the nearest minimum is off by {best}");
    }

    #[test]
    fn jacobians_match_central_differences_near_the_solution() {
        let truth = Pose::exp(&Vector6::new(0.02, -0.03, 0.01, 0.1, 0.02, -0.03));
        for correspondence in correspondences(&truth, 0.0).into_iter().take(20) {
            let factor = SampsonFactor { correspondence };
            optim::testing::assert_jacobians_match(&factor, &(RelativeMotion::of(&truth),), 1e-6, 1e-5);
        }
    }

    #[test]
    fn motions_obey_the_laws_of_a_manifold() {
        let motion = RelativeMotion::of(&Pose::exp(&Vector6::new(0.2, -0.3, 0.1, 1.0, 0.2, -0.3)));
        optim::testing::assert_manifold_laws(&motion, &SVector::from([0.01, -0.02, 0.03, 0.02, -0.01]), 1e-9);
    }
}
