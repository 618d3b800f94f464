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
        let mut normalised = |p: Vector2<f64>| {
            let noise = Vector2::new(self.gaussian(), self.gaussian()) * self.noise_px;
            (p + noise - Vector2::new(WIDTH_PX, HEIGHT_PX) / 2.0) / FOCAL_PX
        };
        let (from, to) = (normalised(from), normalised(to));
        self.segments.extend(SegmentPlane::from_normalised(&from, &to, self.noise_px / FOCAL_PX));
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
fn survey() {
    for (per, lengths) in [(40, (40.0, 150.0)), (15, (40.0, 150.0)), (40, (25.0, 60.0)), (15, (25.0, 60.0))] {
        let mut tally = Tally::default();
        for seed in 0..100 {
            let (truth, scene) = manhattan(seed, per, lengths);
            tally.add(&truth, &estimator(seed).cluster(&scene.segments, &[]));
        }
        tally.print(&format!("{per} of {lengths:?}"));
    }
    let mut n = 0;
    for seed in 0..100 {
        let scene = Scene::new(seed).clutter(100);
        n += estimator(seed).cluster(&scene.segments, &[]).points.len();
    }
    println!("clutter: {n} in 100 scenes");
}
