//! Points, cameras and noisy observations without images, for tests of the back end.

use geometry::{Camera, Pose, so3};
use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::random::{normal, stream, unit_vector};

/// What a [`PointCloudWorld`] is made from.
#[derive(Clone, Debug, PartialEq)]
pub struct PointCloudConfig {
    /// Number of points, uniform in a cube about the origin.
    pub n_points: usize,
    /// Half the side of that cube.
    pub half_extent: f64,
    /// Number of cameras, evenly spread over an arc around the cube, looking at its middle.
    pub n_cameras: usize,
    /// Distance of the cameras from the origin.
    pub camera_distance: f64,
    /// Length of the arc; 360 closes the circle.
    pub arc_deg: f64,
    /// Standard deviation of observations along each image axis.
    pub noise_px: f64,
    /// Share of observations that are replaced by a random place in the image.
    pub outlier_share: f64,
    /// Share of possible observations that are made.
    pub detection_share: f64,
    /// Seed of everything.
    pub seed: u64,
}

impl Default for PointCloudConfig {
    fn default() -> Self {
        Self {
            n_points: 300,
            half_extent: 2.0,
            n_cameras: 12,
            camera_distance: 6.0,
            arc_deg: 90.0,
            noise_px: 0.5,
            outlier_share: 0.0,
            detection_share: 1.0,
            seed: 0,
        }
    }
}

/// A camera's sight of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index into [`PointCloudWorld::cameras_from_world`].
    pub camera: usize,
    /// Index into [`PointCloudWorld::points`].
    pub point: usize,
    /// Where it was seen, with noise, in the camera's (distorted) image.
    pub pixel: Vector2<f64>,
    /// Whether `pixel` has nothing to do with the point.
    pub is_outlier: bool,
}

/// True points and poses, and noisy observations between them.
#[derive(Clone, Debug)]
pub struct PointCloudWorld {
    /// True points, in the world.
    pub points: Vec<Vector3<f64>>,
    /// True poses, `camera_from_world`.
    pub cameras_from_world: Vec<Pose>,
    /// Sorted by camera, then by point.
    pub observations: Vec<Observation>,
}

impl PointCloudWorld {
    /// Draws a world and observes it through `camera`.
    pub fn new(config: &PointCloudConfig, camera: &Camera) -> Self {
        let mut rng = stream(config.seed, "point cloud");
        let half = config.half_extent;
        let points: Vec<Vector3<f64>> =
            (0..config.n_points).map(|_| Vector3::from_fn(|_, _| rng.random_range(-half..=half))).collect();
        let cameras_from_world = (0..config.n_cameras)
            .map(|i| {
                let angle = config.arc_deg.to_radians() * i as f64 / config.n_cameras.max(1) as f64;
                let around = Vector3::new(angle.cos(), angle.sin(), 0.15 * (3.0 * angle).sin());
                let position = around * config.camera_distance + 0.1 * unit_vector(&mut rng);
                let target = 0.15 * half * unit_vector(&mut rng);
                look_at(&position, &target)
            })
            .collect();
        let mut world = Self { points, cameras_from_world, observations: Vec::new() };
        world.observe(config, camera, &mut rng);
        world
    }

    /// `camera_from_world` moved by random rotations and displacements with the given standard deviations: a
    /// start for optimization.
    pub fn disturbed_cameras(&self, rotation_rad: f64, translation: f64, seed: u64) -> Vec<Pose> {
        let mut rng = stream(seed, "disturbed cameras");
        let mut noise = |sigma: f64| Vector3::from_fn(|_, _| sigma * normal(&mut rng));
        self.cameras_from_world
            .iter()
            .map(|pose| {
                let turn = so3::exp(&noise(rotation_rad));
                Pose::new(turn * pose.rotation, pose.translation + noise(translation))
            })
            .collect()
    }

    /// Points moved by normal noise of standard deviation `sigma` along each axis.
    pub fn disturbed_points(&self, sigma: f64, seed: u64) -> Vec<Vector3<f64>> {
        let mut rng = stream(seed, "disturbed points");
        self.points.iter().map(|point| point + Vector3::from_fn(|_, _| sigma * normal(&mut rng))).collect()
    }

    fn observe(&mut self, config: &PointCloudConfig, camera: &Camera, rng: &mut ChaCha8Rng) {
        for (camera_idx, pose) in self.cameras_from_world.iter().enumerate() {
            for (point_idx, point) in self.points.iter().enumerate() {
                let Some(pixel) = camera.project(&pose.transform(point)) else { continue };
                if !camera.contains(&pixel) || !rng.random_bool(config.detection_share) {
                    continue;
                }
                let is_outlier = rng.random_bool(config.outlier_share);
                let pixel = if is_outlier {
                    let (width, height) = (f64::from(camera.width()), f64::from(camera.height()));
                    Vector2::new(rng.random_range(-0.5..width - 0.5), rng.random_range(-0.5..height - 0.5))
                } else {
                    pixel + Vector2::new(normal(rng), normal(rng)) * config.noise_px
                };
                self.observations.push(Observation {
                    camera: camera_idx,
                    point: point_idx,
                    pixel,
                    is_outlier,
                });
            }
        }
    }
}

/// `camera_from_world` of an upright camera at `position` that looks at `target`.
fn look_at(position: &Vector3<f64>, target: &Vector3<f64>) -> Pose {
    let forward = (target - position).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let down = forward.cross(&right);
    let rotation = UnitQuaternion::from_matrix(&Matrix3::from_columns(&[right, down, forward]));
    Pose::new(rotation, *position).inverse()
}
