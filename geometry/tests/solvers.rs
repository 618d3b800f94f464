//! Two-view geometry, triangulation, absolute pose and RANSAC, against random truth.

mod support;

use geometry::absolute_pose::{PoseObservation, p3p, ransac_pose, ransac_pose_with_rotations, refine_pose};
use geometry::nalgebra::{Matrix3, Vector2, Vector3};
use geometry::ransac::{Estimator, RansacConfig, ransac};
use geometry::two_view::{
    decompose_essential, decompose_homography, essential_five_point, fundamental_eight_point,
    homography_four_point, squared_epipolar_distances, squared_sampson_distance, squared_transfer_errors,
    two_point_with_known_rotation,
};
use geometry::{Pinhole, Pose, so3, triangulation};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::{generators, point_in_view, pose_error, uniform, unit_vector};

const CAMERA: Pinhole = Pinhole { fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0 };

/// Points in front of two cameras, `b_from_a` of which is a moderate motion with a unit translation.
fn two_view_scene(rng: &mut impl Rng, n: usize) -> (Pose, Vec<Vector3<f64>>) {
    let mut b_from_a = support::pose(rng, 0.3, 1.0);
    b_from_a.translation = unit_vector(rng);
    let mut points = Vec::new();
    while points.len() < n {
        let point = point_in_view(rng);
        if b_from_a.transform(&point).z > 0.5 {
            points.push(point);
        }
    }
    (b_from_a, points)
}

fn bearings(pose: &Pose, points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    points.iter().map(|p| pose.transform(p).normalize()).collect()
}

fn projections(pose: &Pose, points: &[Vector3<f64>]) -> Vec<Vector2<f64>> {
    points.iter().map(|p| CAMERA.project(&pose.transform(p))).collect()
}

/// Least difference of two matrices known up to scale and sign, at unit norm.
fn difference_up_to_scale(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    let (a, b) = (a / a.norm(), b / b.norm());
    (a - b).norm().min((a + b).norm())
}

fn essential_of(pose: &Pose) -> Matrix3<f64> {
    so3::skew(&pose.translation) * pose.rotation_matrix()
}

#[test]
fn fundamental_matrix_of_eight_and_more_points_is_exact() {
    for (seed, mut rng) in generators("eight_point", 100) {
        let (b_from_a, points) = two_view_scene(&mut rng, if seed % 2 == 0 { 8 } else { 40 });
        let a = projections(&Pose::identity(), &points);
        let b = projections(&b_from_a, &points);
        let f = fundamental_eight_point(&a, &b).unwrap();
        assert!(f.determinant().abs() < 1e-12, "seed {seed}: rank two");
        for (a, b) in a.iter().zip(&b) {
            let (in_a, in_b) = squared_epipolar_distances(&f, a, b);
            assert!(in_a.max(in_b).sqrt() < 1e-4, "seed {seed}: {:e} px", in_a.max(in_b).sqrt());
            assert!(squared_sampson_distance(&f, a, b) <= in_a.min(in_b) * (1.0 + 1e-9));
        }
        let k = CAMERA.matrix();
        let error = difference_up_to_scale(&(k.transpose() * f * k), &essential_of(&b_from_a));
        assert!(error < 1e-5, "seed {seed}: {error:e}");
    }
}

#[test]
fn essential_matrix_of_five_points_is_among_the_solutions() {
    let mut n_found = 0;
    for (_, mut rng) in generators("five_point", 500) {
        let (b_from_a, points) = two_view_scene(&mut rng, 5);
        let solutions =
            essential_five_point(&bearings(&Pose::identity(), &points), &bearings(&b_from_a, &points));
        assert!(solutions.len() <= 10);
        let truth = essential_of(&b_from_a);
        let error = solutions.iter().map(|e| difference_up_to_scale(e, &truth)).fold(f64::INFINITY, f64::min);
        n_found += usize::from(error < 1e-6);
        for e in &solutions {
            assert!((e.norm() - std::f64::consts::SQRT_2).abs() < 1e-12);
        }
    }
    assert!(n_found >= 495, "only {n_found} of 500");
}

#[test]
fn essential_matrix_of_many_points_is_among_the_solutions() {
    for (seed, mut rng) in generators("five_point_many", 30) {
        let (b_from_a, points) = two_view_scene(&mut rng, 30);
        let solutions =
            essential_five_point(&bearings(&Pose::identity(), &points), &bearings(&b_from_a, &points));
        let truth = essential_of(&b_from_a);
        let error = solutions.iter().map(|e| difference_up_to_scale(e, &truth)).fold(f64::INFINITY, f64::min);
        assert!(error < 1e-6, "seed {seed}: {error:e}");
    }
}

#[test]
fn essential_matrix_decomposes_into_the_motion() {
    for (seed, mut rng) in generators("decompose_essential", 200) {
        let (b_from_a, _) = two_view_scene(&mut rng, 0);
        let e = essential_of(&b_from_a) * rng.random_range(-3.0..-0.1);
        let motions = decompose_essential(&e).unwrap();
        let error = motions.iter().map(|m| pose_error(m, &b_from_a)).fold(f64::INFINITY, f64::min);
        assert!(error < 1e-10, "seed {seed}: {error:e}");
        for motion in &motions {
            assert!((motion.translation.norm() - 1.0).abs() < 1e-12);
            assert!(difference_up_to_scale(&essential_of(motion), &e) < 1e-10, "seed {seed}");
        }
    }
    assert!(decompose_essential(&Matrix3::zeros()).is_none());
    assert!(decompose_essential(&Matrix3::repeat(f64::NAN)).is_none());
}

#[test]
fn homography_of_a_plane_is_recovered_and_decomposes_into_the_motion() {
    for (seed, mut rng) in generators("homography", 200) {
        let (b_from_a, _) = two_view_scene(&mut rng, 0);
        // A plane n · X = d at some distance in front, tilted at random; both cameras on the same side.
        let tilt: Vector2<f64> = uniform(&mut rng, 0.6);
        let normal = Vector3::new(tilt.x, tilt.y, 1.0).normalize();
        let distance = rng.random_range(3.0..6.0);
        let n_points = if seed % 2 == 0 { 4 } else { 30 };
        let points: Vec<Vector3<f64>> = (0..n_points)
            .map(|_| {
                let ray = point_in_view(&mut rng);
                ray * (distance / normal.dot(&ray))
            })
            .collect();
        if points.iter().any(|p| p.z < 0.5 || p.z > 50.0 || b_from_a.transform(p).z < 0.5) {
            continue;
        }
        let a = projections(&Pose::identity(), &points);
        let b = projections(&b_from_a, &points);
        let Some(h) = homography_four_point(&a, &b) else {
            assert_eq!(n_points, 4, "seed {seed}: only a minimal sample can be degenerate");
            continue;
        };
        let h_inverse = h.try_inverse().unwrap();
        for (a, b) in a.iter().zip(&b) {
            let (in_a, in_b) = squared_transfer_errors(&h, &h_inverse, a, b);
            assert!(in_a.max(in_b).sqrt() < 1e-4, "seed {seed}: {:e} px", in_a.max(in_b).sqrt());
        }
        let normalized = CAMERA.inverse_matrix() * h * CAMERA.matrix();
        let solutions = decompose_homography(&normalized);
        assert_eq!(solutions.len(), 4, "seed {seed}");
        let expected = Pose::new(b_from_a.rotation, b_from_a.translation / distance);
        let error = solutions
            .iter()
            .map(|(pose, n)| pose_error(pose, &expected).max((n - normal).norm()))
            .fold(f64::INFINITY, f64::min);
        assert!(error < 1e-5, "seed {seed}: {error:e}");
    }
}

#[test]
fn homography_of_a_rotation_has_no_translation() {
    let rotation = so3::exp(&Vector3::new(0.1, -0.2, 0.05));
    let solutions = decompose_homography(&(rotation.to_rotation_matrix().into_inner() * -2.5));
    assert_eq!(solutions.len(), 1);
    assert!(so3::angle_between(&solutions[0].0.rotation, &rotation) < 1e-12);
    assert_eq!(solutions[0].0.translation, Vector3::zeros());
    assert!(decompose_homography(&Matrix3::zeros()).is_empty());
    assert!(decompose_homography(&Matrix3::repeat(f64::NAN)).is_empty());
}

#[test]
fn degenerate_two_view_input_is_refused() {
    let same = vec![Vector2::new(3.0, 4.0); 8];
    assert_eq!(fundamental_eight_point(&same, &same), None);
    assert_eq!(homography_four_point(&same, &same), None);
    assert_eq!(fundamental_eight_point(&same[..7], &same[..7]), None);
    let broken = vec![Vector2::repeat(f64::NAN); 8];
    assert_eq!(fundamental_eight_point(&broken, &broken), None);
    let collinear: Vec<_> = (0..4).map(|i| Vector2::new(f64::from(i), f64::from(i * 2))).collect();
    assert_eq!(homography_four_point(&collinear, &collinear), None);
    let broken = vec![Vector3::repeat(f64::NAN); 5];
    assert!(essential_five_point(&broken, &broken).is_empty());
}

#[test]
fn translation_direction_follows_from_two_points_when_the_rotation_is_known() {
    for (seed, mut rng) in generators("two_point", 200) {
        let (b_from_a, points) = two_view_scene(&mut rng, 2 + (seed % 5) as usize);
        let (a, b) = (bearings(&Pose::identity(), &points), bearings(&b_from_a, &points));
        let t = two_point_with_known_rotation(&b_from_a.rotation, &a, &b).unwrap();
        assert!((t - b_from_a.translation).norm() < 1e-6, "seed {seed}: {t} is not {}", b_from_a.translation);
    }
    let still = [Vector3::z(), Vector3::new(0.6, 0.0, 0.8)];
    assert_eq!(two_point_with_known_rotation(&Pose::identity().rotation, &still, &still), None);
}

#[test]
fn points_are_triangulated_from_two_and_more_views() {
    for (seed, mut rng) in generators("triangulation", 300) {
        let point = point_in_view(&mut rng);
        let views: Vec<_> = (0..5)
            .map(|_| {
                let pose = support::pose(&mut rng, 0.3, 1.0);
                (pose, pose.transform(&point).normalize())
            })
            .collect();
        let [(pose_a, bearing_a), (pose_b, bearing_b)] = [views[0], views[1]];
        let two = triangulation::two_view(&pose_a, &bearing_a, &pose_b, &bearing_b).unwrap();
        let angle = triangulation::parallax(&pose_a.center(), &pose_b.center(), &point);
        assert!((two - point).norm() < 1e-13 / angle.powi(2).min(1.0), "seed {seed}: {angle} rad");
        let many = triangulation::many_view(&views).unwrap();
        assert!((many - point).norm() < 1e-9, "seed {seed}: {:e}", (many - point).norm());
    }
}

#[test]
fn noisy_two_view_points_reproject_within_the_noise() {
    for (seed, mut rng) in generators("noisy_triangulation", 200) {
        let (b_from_a, points) = two_view_scene(&mut rng, 1);
        let sigma = 1.0 / CAMERA.fx;
        let noisy = |b: Vector3<f64>, rng: &mut ChaCha8Rng| (b + uniform::<3>(rng, sigma)).normalize();
        let bearing_a = noisy(points[0].normalize(), &mut rng);
        let bearing_b = noisy(b_from_a.transform(&points[0]).normalize(), &mut rng);
        let Some(found) = triangulation::two_view(&Pose::identity(), &bearing_a, &b_from_a, &bearing_b)
        else {
            // Only rays that are nearly parallel may diverge by their noise.
            let angle = triangulation::parallax(&Vector3::zeros(), &b_from_a.center(), &points[0]);
            assert!(angle < 8.0 * sigma, "seed {seed}: refused at {angle} rad");
            continue;
        };
        let error_a = found.normalize().cross(&bearing_a).norm();
        let error_b = b_from_a.transform(&found).normalize().cross(&bearing_b).norm();
        assert!(error_a + error_b < 6.0 * sigma, "seed {seed}: {:.2} px", (error_a + error_b) * CAMERA.fx);
    }
}

#[test]
fn impossible_points_are_refused() {
    let a = Pose::identity();
    let b = Pose::new(a.rotation, Vector3::new(-1.0, 0.0, 0.0));
    let (left, right) = (Vector3::new(-0.6, 0.0, 0.8), Vector3::new(0.6, 0.0, 0.8));
    assert!(triangulation::two_view(&a, &right, &b, &left).is_some(), "rays that meet in front");
    assert_eq!(triangulation::two_view(&a, &left, &b, &right), None, "rays that meet behind");
    assert_eq!(triangulation::two_view(&a, &right, &b, &right), None, "parallel rays");
    assert_eq!(triangulation::two_view(&a, &right, &a, &left), None, "no baseline");
    assert_eq!(triangulation::two_view(&a, &Vector3::x(), &b, &Vector3::x()), None, "along the baseline");
    assert_eq!(triangulation::two_view(&a, &Vector3::repeat(f64::NAN), &b, &left), None);
    assert_eq!(triangulation::many_view(&[(a, right), (b, right)]), None, "parallel rays");
    assert_eq!(triangulation::many_view(&[(a, left), (b, right)]), None, "behind");
    assert_eq!(triangulation::many_view(&[(a, right)]), None, "one view");
    assert_eq!(triangulation::many_view(&[(a, right), (b, Vector3::repeat(f64::NAN))]), None);
}

#[test]
fn three_point_pose_is_among_the_solutions() {
    let (mut n_found, mut n_solutions) = (0, 0);
    for (seed, mut rng) in generators("p3p", 1000) {
        let truth = support::pose(&mut rng, 3.1, 5.0);
        let seen: [Vector3<f64>; 3] = std::array::from_fn(|_| point_in_view(&mut rng));
        let points = seen.map(|p| truth.inverse().transform(&p));
        let solutions = p3p(&seen.map(|p| p.normalize()), &points);
        assert!(solutions.len() <= 4, "seed {seed}");
        n_solutions += solutions.len();
        for pose in &solutions {
            for (point, seen) in points.iter().zip(&seen) {
                let error = (pose.transform(point).normalize() - seen.normalize()).norm();
                assert!(error < 1e-6, "seed {seed}: a solution that is none, {error:e}");
            }
        }
        n_found += usize::from(solutions.iter().any(|pose| pose_error(pose, &truth) < 1e-6));
    }
    assert!(n_found >= 990, "only {n_found} of 1000");
    assert!(n_solutions < 2500, "{n_solutions} solutions: are some reported twice?");
    println!("p3p: {n_found} of 1000 recovered, {n_solutions} solutions");
}

#[test]
fn three_points_without_a_pose_are_refused() {
    let bearings = [Vector3::z(), Vector3::new(0.6, 0.0, 0.8), Vector3::new(0.0, 0.6, 0.8)];
    let line = [Vector3::x(), Vector3::x() * 2.0, Vector3::x() * 3.0];
    assert!(p3p(&bearings, &line).is_empty());
    assert!(p3p(&bearings, &[Vector3::x(); 3]).is_empty());
    assert!(p3p(&bearings, &[Vector3::repeat(f64::NAN); 3]).is_empty());
    assert!(p3p(&[Vector3::repeat(f64::NAN); 3], &[Vector3::x(), Vector3::y(), Vector3::z()]).is_empty());
    let same = [Vector3::z(); 3];
    assert!(p3p(&same, &[Vector3::x(), Vector3::y(), Vector3::z()]).is_empty());
}

/// `n` observations from a random pose with one pixel of noise, the first half of which is replaced by
/// nonsense.
fn observations_with_outliers(rng: &mut impl Rng, n: usize) -> (Pose, Vec<PoseObservation>) {
    let truth = support::pose(rng, 3.1, 5.0);
    let sigma_rad = 1.0 / CAMERA.fx;
    let observations = (0..n)
        .map(|i| {
            let seen = point_in_view(rng);
            let bearing = if i < n / 2 {
                point_in_view(rng).normalize()
            } else {
                // Uniform of this half width has a standard deviation of one.
                (seen.normalize() + uniform::<3>(rng, 3.0_f64.sqrt() * sigma_rad)).normalize()
            };
            PoseObservation { bearing, point: truth.inverse().transform(&seen), sigma_rad }
        })
        .collect();
    (truth, observations)
}

#[test]
fn pose_is_found_among_half_outliers_and_the_same_seed_gives_the_same_result() {
    for (seed, mut rng) in generators("ransac_pose", 50) {
        let (truth, observations) = observations_with_outliers(&mut rng, 120);
        let run = || {
            ransac_pose(&observations, &RansacConfig::default(), &mut ChaCha8Rng::seed_from_u64(seed))
                .unwrap()
        };
        let report = run();
        assert_eq!(report, run(), "seed {seed}");
        let error = truth.local(&report.model);
        assert!(error.fixed_rows::<3>(0).norm() < 0.004, "seed {seed}: rotation off by {error}");
        let shift = (truth.center() - report.model.center()).norm();
        assert!(shift < 0.02, "seed {seed}: centre off by {shift}");
        let n_false = report.inliers[..60].iter().filter(|inlier| **inlier).count();
        assert!(n_false <= 2 && report.n_inliers >= 55, "seed {seed}: {} inliers", report.n_inliers);
        assert!(report.iterations < 150, "seed {seed}: {} samples, no adaptive stop", report.iterations);
        assert!(report.score > 0.0 && report.score <= report.n_inliers as f64);
    }
}

#[test]
fn a_known_rotation_finds_the_pose_among_few_and_bad_observations() {
    let (mut n_found, mut n_found_without) = (0, 0);
    for (seed, mut rng) in generators("ransac_pose_with_rotations", 50) {
        // Seven true ones and twenty-one false.
        let (truth, mut observations) = observations_with_outliers(&mut rng, 42);
        observations.truncate(28);
        // The true rotation to within half a degree, and others.
        let mut rotations: Vec<_> = (0..7).map(|_| support::pose(&mut rng, 3.1, 1.0).rotation).collect();
        rotations.push(truth.retract(&uniform(&mut rng, 0.005)).rotation);
        let config = RansacConfig { max_iterations: 300, ..RansacConfig::default() };
        let is_found = |pose: &Pose| (truth.center() - pose.center()).norm() < 0.1;
        let mut draw = ChaCha8Rng::seed_from_u64(seed);
        let found = ransac_pose_with_rotations(&observations, &rotations, &config, &mut draw);
        n_found += usize::from(found.is_some_and(|report| is_found(&report.model)));
        let found = ransac_pose(&observations, &config, &mut draw);
        n_found_without += usize::from(found.is_some_and(|report| is_found(&report.model)));
        assert!(ransac_pose_with_rotations(&observations, &[], &config, &mut draw).is_none());
        assert!(ransac_pose_with_rotations(&observations[..3], &rotations, &config, &mut draw).is_none());
    }
    println!("7 of 28 observations true: {n_found} of 50 poses found, {n_found_without} by three points");
    assert!(n_found >= 45 && n_found > n_found_without, "{n_found} of 50, {n_found_without} by three points");
}

#[test]
fn refined_pose_is_exact_without_noise() {
    for (seed, mut rng) in generators("refine_pose", 50) {
        let truth = support::pose(&mut rng, 3.1, 5.0);
        let observations: Vec<_> = (0..10)
            .map(|_| {
                let seen = point_in_view(&mut rng);
                let point = truth.inverse().transform(&seen);
                PoseObservation { bearing: seen.normalize(), point, sigma_rad: 0.002 }
            })
            .collect();
        let start = truth.retract(&uniform(&mut rng, 0.03));
        let found = refine_pose(&start, observations.iter()).unwrap();
        assert!(pose_error(&found, &truth) < 1e-9, "seed {seed}");
        assert_eq!(refine_pose(&start, observations[..3].iter()), None);
    }
}

/// A line `y = m x + c` through points of the plane.
struct LineFit(Vec<Vector2<f64>>);

impl Estimator for LineFit {
    type Model = (f64, f64);

    fn sample_size(&self) -> usize {
        2
    }

    fn n_data(&self) -> usize {
        self.0.len()
    }

    fn fit_sample(&self, sample: &[usize], models: &mut Vec<(f64, f64)>) {
        let (p, q) = (self.0[sample[0]], self.0[sample[1]]);
        assert_ne!(sample[0], sample[1]);
        let slope = (q.y - p.y) / (q.x - p.x);
        models.push((slope, p.y - slope * p.x));
    }

    fn squared_residual(&self, model: &(f64, f64), datum: usize) -> f64 {
        let p = self.0[datum];
        (p.y - model.0 * p.x - model.1).powi(2)
    }
}

#[test]
fn ransac_stops_when_sure_and_reports_what_it_did() {
    let on_line = |i: u32| Vector2::new(f64::from(i), 2.0 * f64::from(i) + 1.0);
    let config = RansacConfig { max_squared_residual: 1e-6, ..RansacConfig::default() };
    let clean = LineFit((0..20).map(on_line).collect());
    let report = ransac(&clean, &config, &mut ChaCha8Rng::seed_from_u64(1)).unwrap();
    assert_eq!((report.n_inliers, report.iterations), (20, config.min_iterations));
    assert!((report.score - 20.0).abs() < 1e-9);

    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mixed = (0..40).map(|i| if i % 2 == 0 { on_line(i) } else { uniform(&mut rng, 50.0) }).collect();
    let report = ransac(&LineFit(mixed), &config, &mut ChaCha8Rng::seed_from_u64(3)).unwrap();
    assert!((report.model.0 - 2.0).abs() < 1e-9 && (report.model.1 - 1.0).abs() < 1e-9);
    assert_eq!(report.inliers.iter().step_by(2).filter(|inlier| **inlier).count(), 20);
    assert!(report.iterations < config.max_iterations);

    let broken = LineFit(vec![Vector2::repeat(f64::NAN); 10]);
    assert_eq!(ransac(&broken, &config, &mut ChaCha8Rng::seed_from_u64(4)), None);
    assert_eq!(ransac(&LineFit(vec![on_line(1)]), &config, &mut ChaCha8Rng::seed_from_u64(5)), None);
}
