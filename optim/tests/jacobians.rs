//! The derivatives of the factors that the other tests rely on.

mod common;

use common::*;
use geometry::{Direction, Pose};
use nalgebra::{Vector2, Vector3};
use optim::testing::assert_jacobians_match;
use optim::{Factor, HoldSecond};
use rand_chacha::ChaCha8Rng;

/// A pose near the origin, looking forward.
fn random_pose(rng: &mut ChaCha8Rng) -> Pose {
    jolted(&Pose::identity(), 0.3, 0.5, rng)
}

fn random_point(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    normal3(rng) * 0.7 + Vector3::new(0.0, 0.0, 5.0)
}

#[test]
fn point_reprojection() {
    for seed in 0..32 {
        let mut rng = rng(seed);
        let factor = PointReprojection { pixel: Vector2::new(3.0, -20.0), sigma_px: 1.2 };
        let (pose, point) = (random_pose(&mut rng), random_point(&mut rng));
        assert_jacobians_match(&factor, &(pose, point), 1e-6, 1e-5);
        assert_jacobians_match(&HoldSecond { factor, second: point }, &(pose,), 1e-6, 1e-5);
    }
}

#[test]
fn line_reprojection() {
    for seed in 0..32 {
        let mut rng = rng(seed);
        let ends = [random_point(&mut rng), random_point(&mut rng)];
        let pose = random_pose(&mut rng);
        let factor =
            LineReprojection { endpoints: observe_segment(&pose, ends, 3.0, &mut rng), sigma_px: 1.0 };
        assert_jacobians_match(&factor, &(pose, line_through(ends)), 1e-6, 1e-5);
    }
}

#[test]
fn directions() {
    for seed in 0..32 {
        let mut rng = rng(seed);
        let direction =
            Direction::new(Vector3::new(0.3, 0.2, 1.0) + normal3(&mut rng) * 0.1).expect("not zero");
        let line = line_through([random_point(&mut rng), random_point(&mut rng)]);
        let factor = SegmentDirection { normal: normal3(&mut rng).normalize(), sigma_rad: 0.01 };
        assert_jacobians_match(&factor, &(random_pose(&mut rng), direction), 1e-6, 1e-5);
        assert_jacobians_match(&LineDirection { sigma_rad: 0.02 }, &(line, direction), 1e-6, 1e-5);
    }
}

#[test]
fn three_variables() {
    let mut rng = rng(7);
    let factor = PointOffset { offset: Vector3::new(0.1, 0.2, 0.3), sigma: 0.5 };
    let values = (random_point(&mut rng), random_pose(&mut rng), random_pose(&mut rng));
    assert_jacobians_match(&factor, &values, 1e-6, 1e-5);
}

#[test]
#[should_panic(expected = "relative error")]
fn a_wrong_derivative_is_noticed() {
    struct Wrong;
    impl Factor for Wrong {
        type Residual = Vector2<f64>;
        type Variables = (Vector2<f64>,);
        fn residual(&self, (x,): (&Vector2<f64>,)) -> Option<Vector2<f64>> {
            Some(Vector2::new(x.x * x.x, x.x * x.y))
        }
        fn linearize(&self, (x,): (&Vector2<f64>,)) -> Option<optim::Linearized<Self>> {
            let jacobian = nalgebra::Matrix2::new(2.0 * x.x, 0.0, x.y, 1.001 * x.x);
            Some((self.residual((x,))?, (jacobian,)))
        }
    }
    assert_jacobians_match(&Wrong, &(Vector2::new(1.0, 2.0),), 1e-6, 1e-5);
}
