//! Exponentials, logarithms and the laws every manifold obeys.

mod support;

use std::f64::consts::PI;

use geometry::nalgebra::{Matrix3, SVector, UnitQuaternion, Vector2, Vector3, Vector6};
use geometry::{Direction, Pose, Similarity, so3};
use rand::Rng;
use support::{assert_close, generators, numeric_jacobian, uniform, unit_vector};

/// Angles where formulas for rotations tend to break, and some where they do not.
const ANGLES: [f64; 15] = [
    0.0,
    1e-300,
    1e-160,
    1e-12,
    1e-8,
    1e-5,
    1e-3,
    0.009_999,
    0.010_001,
    0.1,
    1.0,
    2.0,
    3.0,
    PI - 1e-6,
    PI - 1e-12,
];

#[test]
fn rotation_exponential_and_logarithm_are_inverse_at_every_angle() {
    for (seed, mut rng) in generators("rotation_round_trip", 20) {
        for angle in ANGLES {
            let phi = unit_vector(&mut rng) * angle;
            let rotation = so3::exp(&phi);
            assert!((rotation.norm() - 1.0).abs() < 1e-15);
            let error = (so3::log(&rotation) - phi).norm();
            assert!(error <= 1e-14 * angle.max(1e-290), "seed {seed}, angle {angle}: {error:e}");
        }
    }
}

#[test]
fn rotation_logarithm_at_half_a_turn_and_beyond_is_the_short_way() {
    let half_turn = so3::log(&so3::exp(&Vector3::new(0.0, PI, 0.0)));
    assert!((half_turn.norm() - PI).abs() < 1e-15);
    let beyond = so3::log(&so3::exp(&Vector3::new(0.0, 0.0, PI + 0.1)));
    assert_close(&beyond, &Vector3::new(0.0, 0.0, 0.1 - PI), 1e-14, "just over half a turn");
    let negated = UnitQuaternion::new_unchecked(-*so3::exp(&Vector3::x()).quaternion());
    assert_close(&so3::log(&negated), &Vector3::x(), 1e-15, "the other quaternion of a rotation");
}

#[test]
fn rotation_exponential_agrees_with_the_matrix_series() {
    for (_, mut rng) in generators("rotation_series", 20) {
        let phi: Vector3<f64> = uniform(&mut rng, 1.5);
        let (mut series, mut term) = (Matrix3::identity(), Matrix3::identity());
        for k in 1..40 {
            term = term * so3::skew(&phi) / f64::from(k);
            series += term;
        }
        let rotation = so3::exp(&phi).to_rotation_matrix().into_inner();
        assert_close(&rotation, &series, 1e-14, "exp");
    }
}

#[test]
fn left_jacobian_is_the_derivative_of_the_exponential_and_its_inverse_the_inverse() {
    for (seed, mut rng) in generators("left_jacobian", 20) {
        for angle in [0.0, 1e-9, 1e-4, 0.0099, 0.0101, 0.5, 2.0, PI - 1e-9] {
            let phi = unit_vector(&mut rng) * angle;
            let jacobian = so3::left_jacobian(&phi);
            let inverse = so3::exp(&phi).inverse();
            let numeric = numeric_jacobian(|p| so3::log(&(so3::exp(p) * inverse)), &phi, 1e-5);
            assert_close(&jacobian, &numeric, 1e-9, &format!("seed {seed}, angle {angle}"));
            let product = jacobian * so3::left_jacobian_inverse(&phi);
            assert_close(&product, &Matrix3::identity(), 1e-13, &format!("seed {seed}, angle {angle}"));
        }
    }
}

#[test]
fn poses_obey_the_manifold_laws() {
    for (seed, mut rng) in generators("pose_laws", 50) {
        for angle in ANGLES {
            let mut delta: Vector6<f64> = uniform(&mut rng, 3.0);
            delta.fixed_rows_mut::<3>(0).copy_from(&(unit_vector(&mut rng) * angle));
            let context = format!("seed {seed}, angle {angle}");
            assert_close(&Pose::exp(&delta).log(), &delta, 1e-11, &context);

            let pose = support::pose(&mut rng, PI, 5.0);
            let other = support::pose(&mut rng, PI, 5.0);
            assert_close(&pose.local(&pose.retract(&delta)), &delta, 1e-8, &context);
            assert!(support::pose_error(&pose.retract(&pose.local(&other)), &other) < 1e-11, "{context}");
            assert!(support::pose_error(&pose.retract(&Vector6::zeros()), &pose) < 1e-15, "{context}");

            let moved = pose * Pose::exp(&delta);
            assert!(
                support::pose_error(&moved, &pose.retract(&(pose.adjoint() * delta))) < 1e-11,
                "{context}"
            );
        }
    }
}

#[test]
fn poses_act_as_a_group_on_points() {
    for (_, mut rng) in generators("pose_group", 50) {
        let (a, b) = (support::pose(&mut rng, PI, 5.0), support::pose(&mut rng, PI, 5.0));
        let point: Vector3<f64> = uniform(&mut rng, 5.0);
        assert_close(&((a * b) * point), &(a * (b * point)), 1e-14, "composition");
        assert_close(&(a.inverse() * (a * point)), &point, 1e-14, "inverse");
        assert_close(&(a.rotation_matrix() * point + a.translation), &(a * point), 1e-14, "matrix");
        assert_close(&(a * a.center()), &Vector3::zeros(), 1e-14, "centre");
        let back = Pose::from_rotation_matrix(&a.rotation_matrix(), &a.translation);
        assert!(support::pose_error(&a, &back) < 1e-14);
        assert!(support::pose_error(&a.interpolate(&b, 0.0), &a) < 1e-14);
        assert!(support::pose_error(&a.interpolate(&b, 1.0), &b) < 1e-12);
        let halves = a.interpolate(&b, 0.5);
        assert_close(&a.local(&halves), &halves.local(&b), 1e-8, "half way");
    }
}

#[test]
fn rotation_stays_a_rotation_over_many_retractions() {
    let mut pose = Pose::identity();
    let step = Vector6::new(0.01, -0.02, 0.03, 0.1, 0.0, 0.0);
    for _ in 0..100_000 {
        pose = pose.retract(&step);
    }
    assert!((pose.rotation.norm() - 1.0).abs() < 1e-15);
    assert!(pose.is_finite());
    assert!(!Pose::exp(&Vector6::repeat(f64::NAN)).is_finite());
}

#[test]
fn similarities_obey_the_manifold_laws() {
    for (seed, mut rng) in generators("similarity_laws", 30) {
        for angle in ANGLES {
            for log_scale in [0.0, 1e-300, 1e-9, -1e-4, 0.3, -2.0, 9.0] {
                let mut delta: SVector<f64, 7> = uniform(&mut rng, 2.0);
                delta.fixed_rows_mut::<3>(0).copy_from(&(unit_vector(&mut rng) * angle));
                delta[6] = log_scale;
                let context = format!("seed {seed}, angle {angle}, log scale {log_scale}");
                assert_close(&Similarity::exp(&delta).log(), &delta, 1e-10, &context);
                let base = Similarity::exp(&uniform(&mut rng, 1.0));
                assert_close(&base.local(&base.retract(&delta)), &delta, 1e-7, &context);
            }
        }
    }
}

#[test]
fn similarity_exponential_is_a_one_parameter_group() {
    // exp((a + b) δ) = exp(a δ) exp(b δ) pins down the translation part, which has no other simple check.
    for (seed, mut rng) in generators("similarity_group", 50) {
        let delta: SVector<f64, 7> = uniform(&mut rng, 1.5);
        let split = rng.random_range(0.0..1.0);
        let whole = Similarity::exp(&delta);
        let parts = Similarity::exp(&(delta * split)) * Similarity::exp(&(delta * (1.0 - split)));
        let point: Vector3<f64> = uniform(&mut rng, 5.0);
        assert_close(&parts.transform(&point), &whole.transform(&point), 1e-13, &format!("seed {seed}"));
        assert_close(&whole.inverse().transform(&(whole * point)), &point, 1e-12, &format!("seed {seed}"));
    }
    let mut rigid = SVector::<f64, 7>::zeros();
    rigid.fixed_rows_mut::<6>(0).copy_from(&Vector6::new(0.3, -0.2, 0.9, 1.0, 2.0, 3.0));
    let expected = Pose::exp(&Vector6::new(0.3, -0.2, 0.9, 1.0, 2.0, 3.0));
    assert!(support::pose_error(&Similarity::exp(&rigid).pose_part(), &expected) < 1e-14);
}

#[test]
fn pose_part_of_a_similarity_sees_the_same_bearings() {
    for (_, mut rng) in generators("pose_part", 20) {
        let similarity = Similarity::exp(&uniform(&mut rng, 1.0));
        let point: Vector3<f64> = uniform(&mut rng, 5.0);
        let bearing = similarity.transform(&point).normalize();
        assert_close(&similarity.pose_part().transform(&point).normalize(), &bearing, 1e-14, "bearing");
    }
}

#[test]
fn similarity_is_recovered_from_correspondences() {
    for (seed, mut rng) in generators("horn", 200) {
        let truth = Similarity::new(
            support::pose(&mut rng, PI, 1.0).rotation,
            uniform(&mut rng, 10.0),
            rng.random_range(0.05..20.0),
        );
        let n = rng.random_range(3..12);
        let source: Vec<Vector3<f64>> = (0..n).map(|_| uniform(&mut rng, 4.0)).collect();
        let target: Vec<_> = source.iter().map(|p| truth.transform(p)).collect();
        let found = Similarity::from_correspondences(&source, &target, true).expect("enough points");
        let error = truth.local(&found).norm();
        assert!(error < 1e-9, "seed {seed}: {error:e}");

        let rigid = Similarity::new(truth.rotation, truth.translation, 1.0);
        let target: Vec<_> = source.iter().map(|p| rigid.transform(p)).collect();
        let found = Similarity::from_correspondences(&source, &target, false).expect("enough points");
        assert_eq!(found.scale, 1.0);
        assert!(rigid.local(&found).norm() < 1e-9, "seed {seed}");
    }
}

#[test]
fn degenerate_correspondences_are_refused() {
    let line: Vec<_> = (0..5).map(|i| Vector3::new(f64::from(i), 2.0 * f64::from(i), 1.0)).collect();
    assert_eq!(Similarity::from_correspondences(&line, &line, true), None);
    assert_eq!(Similarity::from_correspondences(&line[..2], &line[..2], true), None);
    assert_eq!(Similarity::from_correspondences(&line, &line[..3], true), None);
    let same = vec![Vector3::x(); 4];
    assert_eq!(Similarity::from_correspondences(&same, &same, true), None);
    let broken = vec![Vector3::repeat(f64::NAN); 4];
    assert_eq!(Similarity::from_correspondences(&broken, &broken, true), None);
}

#[test]
fn directions_have_no_sign() {
    for (_, mut rng) in generators("direction_sign", 50) {
        let v = unit_vector(&mut rng) * rng.random_range(0.1..10.0);
        let (a, b) = (Direction::new(v).unwrap(), Direction::new(-v).unwrap());
        assert_eq!(a, b);
        assert_eq!(a.angle(&b), 0.0);
    }
    assert_eq!(Direction::new(Vector3::x()), Direction::new(-Vector3::x()));
    assert_eq!(Direction::new(Vector3::zeros()), None);
    assert_eq!(Direction::new(Vector3::new(1.0, f64::NAN, 0.0)), None);
    assert_eq!(Direction::new(Vector3::new(f64::INFINITY, 0.0, 0.0)), None);
    assert!(Direction::new(Vector3::repeat(1e-300)).is_some());
    let orthogonal = Direction::new(Vector3::x()).unwrap().angle(&Direction::new(Vector3::y()).unwrap());
    assert!((orthogonal - PI / 2.0).abs() < 1e-15);
}

#[test]
fn directions_obey_the_manifold_laws() {
    for (seed, mut rng) in generators("direction_laws", 300) {
        let d = Direction::new(unit_vector(&mut rng)).unwrap();
        let basis = d.basis();
        assert_close(&(basis.transpose() * basis), &geometry::nalgebra::Matrix2::identity(), 1e-15, "basis");
        assert!((basis.transpose() * d.as_vector()).amax() < 1e-15);
        let delta: Vector2<f64> = uniform(&mut rng, 1.0);
        let delta = if seed % 3 == 0 { delta * 1e-9 } else { delta };
        let moved = d.retract(&delta);
        assert_close(&d.local(&moved), &delta, 1e-13, &format!("seed {seed}"));
        assert!((d.angle(&moved) - delta.norm()).abs() < 1e-14, "seed {seed}");
        let other = Direction::new(unit_vector(&mut rng)).unwrap();
        assert!(d.retract(&d.local(&other)).angle(&other) < 1e-14, "seed {seed}");
        assert!(d.local(&d).norm() < 1e-15);
    }
}
