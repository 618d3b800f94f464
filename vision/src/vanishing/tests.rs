//! Vanishing points of made-up scenes, whose directions are known.

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

/// The camera of EuRoC, pixels.
const FOCAL_PX: f64 = 458.0;
const WIDTH_PX: f64 = 752.0;
const HEIGHT_PX: f64 = 480.0;

/// Draws scenes of segments.
struct Scene {
    rng: ChaCha8Rng,
    noise_px: f64,
    min_length_px: f64,
    max_length_px: f64,
    segments: Vec<SegmentPlane>,
}

impl Scene {
    fn new(seed: u64) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(seed),
            noise_px: 1.0,
            min_length_px: 40.0,
            max_length_px: 150.0,
            segments: Vec::new(),
        }
    }

    fn lengths(self, min_length_px: f64, max_length_px: f64) -> Self {
        Self { min_length_px, max_length_px, ..self }
    }

    fn rotation(&mut self) -> UnitQuaternion<f64> {
        let mut gaussian = || self.gaussian();
        let quaternion = nalgebra::Quaternion::new(gaussian(), gaussian(), gaussian(), gaussian());
        UnitQuaternion::from_quaternion(quaternion)
    }

    fn gaussian(&mut self) -> f64 {
        let (u, v): (f64, f64) = (self.rng.random::<f64>().max(1e-300), self.rng.random());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    fn pixel(&mut self) -> Vector2<f64> {
        Vector2::new(self.rng.random_range(0.0..WIDTH_PX), self.rng.random_range(0.0..HEIGHT_PX))
    }

    /// Adds the segment if it is within the image, with noise at its endpoints.
    fn push(&mut self, from: Vector2<f64>, to: Vector2<f64>) -> bool {
        let is_inside = |p: &Vector2<f64>| (0.0..WIDTH_PX).contains(&p.x) && (0.0..HEIGHT_PX).contains(&p.y);
        if !is_inside(&from) || !is_inside(&to) {
            return false;
        }
        let mut normalized = |p: Vector2<f64>| {
            let noise = Vector2::new(self.gaussian(), self.gaussian()) * self.noise_px;
            (p + noise - Vector2::new(WIDTH_PX, HEIGHT_PX) / 2.0) / FOCAL_PX
        };
        let (from, to) = (normalized(from), normalized(to));
        self.segments.extend(SegmentPlane::from_normalized(&from, &to, self.noise_px / FOCAL_PX));
        true
    }

    /// `n` segments of lines along `direction` (camera frame).
    fn bundle(mut self, direction: &Vector3<f64>, n: usize) -> Self {
        let end = self.segments.len() + n;
        while self.segments.len() < end {
            let middle = self.pixel();
            let ray = ((middle - Vector2::new(WIDTH_PX, HEIGHT_PX) / 2.0) / FOCAL_PX).push(1.0);
            // The image of a step along the line: d (x, y) / z.
            let step = direction.xy() - ray.xy() * direction.z;
            let half = self.rng.random_range(self.min_length_px..self.max_length_px) / 2.0;
            // Not over the vanishing point.
            let distance = step.norm() * FOCAL_PX / direction.z.abs();
            if distance > half * 1.05 {
                let half = step.normalize() * half;
                self.push(middle - half, middle + half);
            }
        }
        self
    }

    fn clutter(mut self, n: usize) -> Self {
        let end = self.segments.len() + n;
        while self.segments.len() < end {
            let (middle, angle) = (self.pixel(), self.rng.random_range(0.0..std::f64::consts::PI));
            let half = self.rng.random_range(self.min_length_px..self.max_length_px) / 2.0;
            let half = Vector2::new(angle.cos(), angle.sin()) * half;
            self.push(middle - half, middle + half);
        }
        self
    }
}

/// Three orthogonal directions at an attitude drawn from the seed, and their scene.
fn manhattan(seed: u64, per_direction: usize, lengths: (f64, f64)) -> (Vec<Vector3<f64>>, Scene) {
    let mut scene = Scene::new(seed).lengths(lengths.0, lengths.1);
    let camera_from_world = scene.rotation();
    let directions: Vec<_> =
        [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| camera_from_world * axis).to_vec();
    let scene = directions.iter().fold(scene, |scene, d| scene.bundle(d, per_direction)).clutter(30);
    (directions, scene)
}

fn estimator(seed: u64) -> VanishingEstimator {
    VanishingEstimator::new(VanishingConfig::default(), seed).unwrap()
}

fn angle_deg(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b).abs()).to_degrees()
}

/// What became of many scenes.
#[derive(Debug, Default)]
struct Tally {
    /// Of the nearest point to each true direction, degrees; those over 3 degrees count as missed.
    errors_deg: Vec<f64>,
    n_missed: usize,
    /// Points that are nobody's nearest: duplicates (within 5 degrees of a true one) and wrong ones.
    n_duplicates: usize,
    n_wrong: usize,
    n_scenes: usize,
    /// Squared errors over their covariance, 2 degrees of freedom each.
    mahalanobis: Vec<f64>,
}

impl Tally {
    fn add(&mut self, truth: &[Vector3<f64>], found: &VanishingPoints) {
        self.n_scenes += 1;
        let mut is_used = vec![false; found.points.len()];
        for direction in truth {
            let error = |idx: &usize| angle_deg(&found.points[*idx].direction, direction);
            let nearest = (0..found.points.len())
                .min_by(|a, b| error(a).total_cmp(&error(b)))
                .filter(|idx| error(idx) < 3.0);
            match nearest {
                Some(idx) => {
                    is_used[idx] = true;
                    self.errors_deg.push(error(&idx));
                    self.mahalanobis.push(mahalanobis(&found.points[idx], direction));
                }
                None => self.n_missed += 1,
            }
        }
        for (point, _) in found.points.iter().zip(is_used).filter(|(_, is_used)| !is_used) {
            let nearest = truth.iter().map(|d| angle_deg(d, &point.direction)).fold(90.0, f64::min);
            if nearest < 5.0 { self.n_duplicates += 1 } else { self.n_wrong += 1 }
        }
    }

    fn quantile(&self, share: f64) -> f64 {
        let mut sorted = self.errors_deg.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[((sorted.len() - 1) as f64 * share) as usize]
    }

    fn mean_mahalanobis(&self) -> f64 {
        self.mahalanobis.iter().sum::<f64>() / self.mahalanobis.len() as f64
    }

    fn print(&self, name: &str) {
        let per_scene = |n: usize| n as f64 / self.n_scenes as f64;
        println!(
            "{name}: error {:.2} ({:.2}) max {:.2} deg, missed {}/{}, per scene {:.2} duplicates {:.2} wrong, chi2 {:.2}",
            self.quantile(0.5),
            self.quantile(0.95),
            self.quantile(1.0),
            self.n_missed,
            self.n_missed + self.errors_deg.len(),
            per_scene(self.n_duplicates),
            per_scene(self.n_wrong),
            self.mean_mahalanobis(),
        );
    }
}

/// The squared error of a point in units of its covariance.
fn mahalanobis(point: &VanishingPoint, truth: &Vector3<f64>) -> f64 {
    let sign = truth.dot(&point.direction).signum();
    let difference = truth * sign - point.direction;
    let inverse = point.covariance.pseudo_inverse(1e-12).unwrap();
    difference.dot(&(inverse * difference))
}

#[test]
fn orthogonal_directions_are_found_among_clutter() {
    let mut tally = Tally::default();
    for seed in 0..40 {
        let (truth, scene) = manhattan(seed, 40, (40.0, 150.0));
        tally.add(&truth, &estimator(seed).cluster(&scene.segments, &[]));
    }
    tally.print("40 of 40 to 150 px");
    assert_eq!(tally.n_missed, 0);
    assert!(tally.quantile(0.5) <= 0.3 && tally.quantile(1.0) < 1.5);
    assert!(tally.n_wrong + tally.n_duplicates <= tally.n_scenes / 2);
    // Two degrees of freedom; strangers that happen to fit add to it.
    assert!((1.4..3.0).contains(&tally.mean_mahalanobis()));
}

#[test]
fn few_or_short_segments_are_enough() {
    for (per_direction, lengths, max_missed) in [(15, (40.0, 150.0), 2), (40, (25.0, 60.0), 3)] {
        let mut tally = Tally::default();
        for seed in 0..40 {
            let (truth, scene) = manhattan(seed, per_direction, lengths);
            tally.add(&truth, &estimator(seed).cluster(&scene.segments, &[]));
        }
        tally.print(&format!("{per_direction} of {lengths:?} px"));
        assert!(tally.n_missed <= max_missed);
        assert!(tally.quantile(0.5) <= 0.6);
        assert!(tally.n_wrong + tally.n_duplicates <= tally.n_scenes);
        assert!((1.0..4.0).contains(&tally.mean_mahalanobis()));
    }
}

#[test]
fn without_clutter_the_covariance_is_that_of_the_error() {
    let mut tally = Tally::default();
    for seed in 0..60 {
        let mut scene = Scene::new(seed);
        let direction = scene.rotation() * Vector3::x();
        let scene = scene.bundle(&direction, 30);
        tally.add(&[direction], &estimator(seed).cluster(&scene.segments, &[]));
    }
    tally.print("one bundle alone");
    assert_eq!((tally.n_missed, tally.n_wrong), (0, 0));
    assert!((1.3..3.0).contains(&tally.mean_mahalanobis()));
}

#[test]
fn directions_need_not_be_orthogonal() {
    let mut tally = Tally::default();
    for seed in 0..20 {
        let mut scene = Scene::new(seed);
        let rotation = scene.rotation();
        let horizontal = |angle_deg: f64| {
            let angle = angle_deg.to_radians();
            rotation * Vector3::new(angle.cos(), 0.0, angle.sin())
        };
        let truth = [rotation * Vector3::y(), horizontal(0.0), horizontal(35.0), horizontal(80.0)];
        let scene = truth.iter().fold(scene, |scene, d| scene.bundle(d, 30)).clutter(20);
        tally.add(&truth, &estimator(seed).cluster(&scene.segments, &[]));
    }
    tally.print("four directions");
    assert!(tally.n_missed <= 2 && tally.quantile(0.5) <= 0.4);
}

#[test]
fn a_vanishing_point_at_infinity_is_one_like_any_other() {
    for direction in [Vector3::x(), Vector3::y(), Vector3::new(0.6, 0.8, 0.0)] {
        let scene = Scene::new(3).bundle(&direction, 30).clutter(20);
        let found = estimator(0).cluster(&scene.segments, &[]);
        assert_eq!(found.points.len(), 1);
        assert!(angle_deg(&found.points[0].direction, &direction) < 1.0);
        assert!(found.points[0].segments.iter().filter(|idx| **idx < 30).count() >= 26);
    }
}

#[test]
fn what_has_no_order_shows_no_vanishing_point() {
    let n_found: usize = (0..40)
        .map(|seed| estimator(seed).cluster(&Scene::new(seed).clutter(100).segments, &[]).points.len())
        .sum();
    assert!(n_found <= 4, "{n_found} in 40 scenes");
}

#[test]
fn the_result_is_well_formed() {
    let (_, scene) = manhattan(5, 40, (40.0, 150.0));
    let found = estimator(0).cluster(&scene.segments, &[]);
    let mut n_seen = vec![0; scene.segments.len()];
    for point in &found.points {
        assert!((point.direction.norm() - 1.0).abs() < 1e-12 && point.direction.z >= 0.0);
        assert!((point.covariance * point.direction).norm() < 1e-12);
        assert!((point.covariance - point.covariance.transpose()).norm() < 1e-12);
        assert!(point.segments.is_sorted());
        assert!(point.log10_false_alarms < VanishingConfig::default().max_log10_false_alarms);
        point.segments.iter().for_each(|idx| n_seen[*idx as usize] += 1);
    }
    assert!(n_seen.iter().all(|n| *n <= 1));
    assert!(found.explained > 0.6 && found.explained <= 1.0);
    assert!(found.points.is_sorted_by_key(|point| std::cmp::Reverse(point.segments.len())));
}

#[test]
fn the_same_seed_gives_the_same_result_whatever_came_before() {
    let (_, scene) = manhattan(1, 20, (40.0, 150.0));
    let (_, other) = manhattan(2, 40, (40.0, 150.0));
    let first = estimator(9).cluster(&scene.segments, &[]);
    let mut used = estimator(9);
    used.cluster(&other.segments, &[Vector3::x()]);
    used.refit(&other.segments, &[Vector3::y()]);
    assert_eq!(used.cluster(&scene.segments, &[]), first);
}

#[test]
fn predictions_are_followed() {
    let mut tally = Tally::default();
    for seed in 0..20 {
        let (truth, scene) = manhattan(seed, 40, (40.0, 150.0));
        let off = UnitQuaternion::from_euler_angles(0.012, -0.015, 0.012);
        let not_there = Vector3::new(f64::NAN, 0.0, 1.0);
        let predicted = [not_there, off * truth[0] * -2.0, Vector3::zeros(), off * truth[1], off * truth[2]];
        let found = estimator(seed).refit(&scene.segments, &predicted);
        tally.add(&truth, &found);
        for point in &found.points {
            let idx = point.prediction.unwrap() as usize;
            assert!(angle_deg(&predicted[idx], &point.direction) <= 3.0);
        }
        assert!(found.explained > 0.6);
        // A single one of them leaves most unexplained.
        assert!(estimator(seed).refit(&scene.segments, &predicted[1..2]).explained < 0.6);
    }
    tally.print("followed");
    assert!(tally.n_missed <= 1 && tally.n_wrong == 0);
    assert!(tally.quantile(0.5) <= 0.3 && tally.quantile(1.0) < 1.5);
}

#[test]
fn nothing_is_followed_where_nothing_is() {
    for seed in 0..20 {
        let scene = Scene::new(seed).bundle(&Vector3::new(1.0, 0.1, 0.2).normalize(), 30);
        let found = estimator(0).refit(&scene.segments, &[Vector3::new(0.1, 1.0, 0.2)]);
        assert_eq!(found.points, []);
        assert_eq!(found.explained, 0.0);
    }
}

#[test]
fn what_is_known_needs_fewer_segments() {
    let direction = Vector3::new(0.2, 0.9, 0.3).normalize();
    let count = |known: &[Vector3<f64>]| {
        let found = |seed: u64| {
            let scene = Scene::new(seed).lengths(100.0, 200.0).bundle(&direction, 4).clutter(6);
            let found = estimator(seed).cluster(&scene.segments, known);
            found.points.iter().any(|point| angle_deg(&point.direction, &direction) < 2.0)
        };
        (0..40).filter(|seed| found(*seed)).count()
    };
    let (without, with) = (count(&[]), count(&[direction]));
    println!("found without {without}, with {with} of 40");
    assert!(with >= 20 && without <= with / 2);
}

#[test]
fn too_few_segments_show_nothing() {
    let segments = Scene::new(0).clutter(2).segments;
    for n in 0..=2 {
        for found in [
            estimator(0).cluster(&segments[..n], &[Vector3::x()]),
            estimator(0).refit(&segments[..n], &[Vector3::x()]),
        ] {
            assert_eq!(found.points, [], "{n} segments");
        }
    }
    assert_eq!(estimator(0).cluster(&[], &[]).explained, 1.0);
}

#[test]
fn segments_on_one_line_show_nothing() {
    let mut scene = Scene::new(4);
    let first = Scene::new(0).clutter(1).segments[0];
    assert_eq!(estimator(0).cluster(&[first; 50], &[*first.start()]).points, []);
    for i in 0..30 {
        let x = 20.0 + f64::from(i) * 20.0;
        scene.push(Vector2::new(x, 0.3 * x + 100.0), Vector2::new(x + 60.0, 0.3 * (x + 60.0) + 100.0));
    }
    let along = Vector3::new(1.0, 0.3, 0.0).normalize();
    assert_eq!(estimator(0).cluster(&scene.segments, &[along]).points, []);
    assert_eq!(estimator(0).refit(&scene.segments, &[along]).points, []);
}

#[test]
fn of_very_many_segments_the_longest_are_looked_at() {
    let direction = Vector3::new(0.3, 0.2, 0.9).normalize();
    let scene = Scene::new(6).lengths(100.0, 200.0).bundle(&direction, 150);
    let scene = scene.lengths(10.0, 90.0).clutter(9_850);
    assert_eq!(scene.segments.len(), 10_000);
    let found = estimator(0).cluster(&scene.segments, &[]);
    assert!(angle_deg(&found.points[0].direction, &direction) < 0.5);
    let n_supporting: usize = found.points.iter().map(|point| point.segments.len()).sum();
    assert!(n_supporting <= VanishingConfig::default().max_segments);
}
