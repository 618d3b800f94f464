//! Factors and seeded worlds shared by tests, the bench and the example.
#![allow(dead_code, reason = "each user of this module needs a part of it")]

use geometry::line::d_moment_d_pluecker;
use geometry::{Direction, Line3, OrthonormalLine, Pose, so3};
use nalgebra::{
    Matrix1x2, Matrix1x6, Matrix2x3, Matrix2x4, Matrix2x6, Matrix3, Matrix3x2, Matrix3x4, Matrix3x6, Vector1,
    Vector2, Vector3, Vector6,
};
use optim::{Factor, GroupId, Kernel, Linearized, Problem, VariableId};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Focal length of all cameras here, in pixels; the principal point is the origin.
pub const FOCAL_PX: f64 = 450.0;

/// Pixel of a point: `r = (f [x/z, y/z] − pixel) / sigma`, `[x, y, z] = camera_from_world * point`.
#[derive(Clone, Debug)]
pub struct PointReprojection {
    pub pixel: Vector2<f64>,
    pub sigma_px: f64,
}

impl Factor for PointReprojection {
    type Residual = Vector2<f64>;
    type Variables = (Pose, Vector3<f64>);

    #[inline]
    fn residual(&self, (camera_from_world, point): (&Pose, &Vector3<f64>)) -> Option<Vector2<f64>> {
        let p = camera_from_world.transform(point);
        (p.z > 1e-3).then(|| (p.xy() * (FOCAL_PX / p.z) - self.pixel) / self.sigma_px)
    }

    #[inline]
    fn linearize(&self, (camera_from_world, point): (&Pose, &Vector3<f64>)) -> Option<Linearized<Self>> {
        let rotation = camera_from_world.rotation_matrix();
        let p = rotation * point + camera_from_world.translation;
        if p.z <= 1e-3 {
            return None;
        }
        let (inverse_z, scale) = (1.0 / p.z, FOCAL_PX / self.sigma_px);
        let (x, y, a) = (p.x * inverse_z, p.y * inverse_z, scale * inverse_z);
        let residual = Vector2::new(scale * x, scale * y) - self.pixel / self.sigma_px;
        let d_residual_d_p = Matrix2x3::new(a, 0.0, -a * x, 0.0, a, -a * y);
        #[rustfmt::skip]
        let d_residual_d_pose = Matrix2x6::new(
            -scale * x * y, scale * (1.0 + x * x), -scale * y, a, 0.0, -a * x,
            -scale * (1.0 + y * y), scale * x * y, scale * x, 0.0, a, -a * y,
        );
        Some((residual, (d_residual_d_pose, d_residual_d_p * rotation)))
    }
}

/// Distance of a segment's endpoints to a projected line: `r = f [l·p, l·q] / (‖l₁₂‖ sigma)`, `l` the moment
/// of the line in the camera, `p`, `q` the endpoints on the plane `z = 1`.
#[derive(Clone, Debug)]
pub struct LineReprojection {
    pub endpoints: [Vector3<f64>; 2],
    pub sigma_px: f64,
}

impl Factor for LineReprojection {
    type Residual = Vector2<f64>;
    type Variables = (Pose, OrthonormalLine);

    fn residual(&self, values: (&Pose, &OrthonormalLine)) -> Option<Vector2<f64>> {
        self.linearize(values).map(|(residual, _)| residual)
    }

    fn linearize(&self, (camera_from_world, line): (&Pose, &OrthonormalLine)) -> Option<Linearized<Self>> {
        let (n, v) = line.pluecker();
        let moment_by_pluecker = d_moment_d_pluecker(camera_from_world);
        let v_in_camera = camera_from_world.rotation * v;
        let l = camera_from_world.rotation * n + camera_from_world.translation.cross(&v_in_camera);
        let s = l.xy().norm();
        if s < 1e-9 {
            return None;
        }
        let scale = FOCAL_PX / self.sigma_px;
        let rows = self.endpoints.map(|p| {
            let d = p.dot(&l);
            (d / s, Vector3::new(p.x / s - l.x * d / s.powi(3), p.y / s - l.y * d / s.powi(3), p.z / s))
        });
        let residual = Vector2::new(rows[0].0, rows[1].0) * scale;
        let d_residual_d_moment = Matrix2x3::from_rows(&rows.map(|(_, row)| row.transpose() * scale));
        let mut d_moment_d_pose = Matrix3x6::zeros();
        d_moment_d_pose.fixed_columns_mut::<3>(0).copy_from(&-so3::skew(&l));
        d_moment_d_pose.fixed_columns_mut::<3>(3).copy_from(&-so3::skew(&v_in_camera));
        let d_residual_d_line: Matrix2x4<f64> = d_residual_d_moment * moment_by_pluecker * line.jacobian();
        Some((residual, (d_residual_d_moment * d_moment_d_pose, d_residual_d_line)))
    }
}

/// Angle of a vanishing direction out of a segment's plane: `r = m · (R d) / sigma`, `m` the plane's normal
/// in the camera.
#[derive(Clone, Debug)]
pub struct SegmentDirection {
    pub normal: Vector3<f64>,
    pub sigma_rad: f64,
}

impl Factor for SegmentDirection {
    type Residual = Vector1<f64>;
    type Variables = (Pose, Direction);

    fn residual(&self, (pose, direction): (&Pose, &Direction)) -> Option<Vector1<f64>> {
        Some(Vector1::new(self.normal.dot(&(pose.rotation * direction.as_vector())) / self.sigma_rad))
    }

    fn linearize(&self, (pose, direction): (&Pose, &Direction)) -> Option<Linearized<Self>> {
        let d = pose.rotation * direction.as_vector();
        let turn = d.cross(&self.normal) / self.sigma_rad;
        let d_pose = Matrix1x6::new(turn.x, turn.y, turn.z, 0.0, 0.0, 0.0);
        let d_direction: Matrix1x2<f64> =
            self.normal.transpose() * pose.rotation_matrix() * direction.basis() / self.sigma_rad;
        Some((self.residual((pose, direction))?, (d_pose, d_direction)))
    }
}

/// A line is parallel to a vanishing direction: `r = (u × d) / sigma`.
#[derive(Clone, Debug)]
pub struct LineDirection {
    pub sigma_rad: f64,
}

impl Factor for LineDirection {
    type Residual = Vector3<f64>;
    type Variables = (OrthonormalLine, Direction);

    fn residual(&self, (line, direction): (&OrthonormalLine, &Direction)) -> Option<Vector3<f64>> {
        let u = line.pluecker().1.try_normalize(1e-9)?;
        Some(u.cross(direction.as_vector()) / self.sigma_rad)
    }

    fn linearize(&self, (line, direction): (&OrthonormalLine, &Direction)) -> Option<Linearized<Self>> {
        let v = line.pluecker().1;
        let u = v.try_normalize(1e-9)?;
        let across = (Matrix3::identity() - u * u.transpose()) / v.norm();
        let d_u_d_line: Matrix3x4<f64> = across * line.jacobian().fixed_rows::<3>(3);
        let d_line = -so3::skew(direction.as_vector()) * d_u_d_line / self.sigma_rad;
        let d_direction: Matrix3x2<f64> = so3::skew(&u) * direction.basis() / self.sigma_rad;
        Some((self.residual((line, direction))?, (d_line, d_direction)))
    }
}

/// Two frames and a point: `r = (T_a p − T_b p − offset) / sigma`. A factor of three variables.
#[derive(Clone, Debug)]
pub struct PointOffset {
    pub offset: Vector3<f64>,
    pub sigma: f64,
}

impl Factor for PointOffset {
    type Residual = Vector3<f64>;
    type Variables = (Vector3<f64>, Pose, Pose);

    fn residual(&self, (p, a, b): (&Vector3<f64>, &Pose, &Pose)) -> Option<Vector3<f64>> {
        Some((a.transform(p) - b.transform(p) - self.offset) / self.sigma)
    }

    fn linearize(&self, (p, a, b): (&Vector3<f64>, &Pose, &Pose)) -> Option<Linearized<Self>> {
        let by_pose = |pose: &Pose| {
            let mut jacobian = Matrix3x6::zeros();
            jacobian.fixed_columns_mut::<3>(0).copy_from(&-so3::skew(&pose.transform(p)));
            jacobian.fixed_columns_mut::<3>(3).copy_from(&Matrix3::identity());
            jacobian / self.sigma
        };
        let by_point = (a.rotation_matrix() - b.rotation_matrix()) / self.sigma;
        Some((self.residual((p, a, b))?, (by_point, by_pose(a), -by_pose(b))))
    }
}

pub fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A standard normal number [Box & Muller 1958].
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random_range(1e-300..1.0), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

pub fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

/// A pose moved at random by about `rotation` radians and `translation` map units per axis.
pub fn jolted(pose: &Pose, rotation: f64, translation: f64, rng: &mut ChaCha8Rng) -> Pose {
    let (w, t) = (normal3(rng) * rotation, normal3(rng) * translation);
    pose.retract(&Vector6::new(w.x, w.y, w.z, t.x, t.y, t.z))
}

/// A camera passing along a scene of points: each point is seen by consecutive cameras.
#[derive(Clone, Debug)]
pub struct World {
    pub poses: Vec<Pose>,
    pub points: Vec<Vector3<f64>>,
    /// `(camera, point, pixel)`, by points.
    pub observations: Vec<(usize, usize, Vector2<f64>)>,
}

/// What to build.
#[derive(Clone, Copy, Debug)]
pub struct WorldSize {
    pub n_cameras: usize,
    pub n_points: usize,
    pub n_observations: usize,
}

impl World {
    /// Cameras on a gently turning path, looking sideways at points 3 to 8 units away; `noise_px` on pixels.
    pub fn new(size: WorldSize, noise_px: f64, seed: u64) -> Self {
        let mut rng = rng(seed);
        let poses: Vec<Pose> = (0..size.n_cameras)
            .map(|i| {
                let s = i as f64;
                let turn =
                    Vector3::new(0.05 * (0.3 * s).sin(), 0.1 * (0.2 * s).sin(), 0.03 * (0.5 * s).cos());
                let center = Vector3::new(0.3 * s, 0.2 * (0.4 * s).sin(), 0.1 * (0.7 * s).cos());
                let mut pose = Pose::exp(&Vector6::new(turn.x, turn.y, turn.z, 0.0, 0.0, 0.0));
                pose.translation = -(pose.rotation * center);
                pose
            })
            .collect();
        let mean = size.n_observations as f64 / size.n_points as f64;
        let mut points = Vec::with_capacity(size.n_points);
        let mut observations = Vec::with_capacity(size.n_observations);
        for point_idx in 0..size.n_points {
            let spread: f64 = rng.random_range(-0.5..0.5) * (mean - 2.0);
            let n_views = ((mean + spread + rng.random::<f64>()) as usize).clamp(2, size.n_cameras);
            let first = rng.random_range(0..=size.n_cameras - n_views);
            let along = 0.3 * (first as f64 + 0.5 * (n_views - 1) as f64) + rng.random_range(-1.0..1.0);
            let point = Vector3::new(along, rng.random_range(-2.0..2.0), rng.random_range(3.0..8.0));
            for (camera_idx, pose) in poses.iter().enumerate().skip(first).take(n_views) {
                let p = pose.transform(&point);
                let noise = Vector2::new(normal(&mut rng), normal(&mut rng)) * noise_px;
                observations.push((camera_idx, point_idx, p.xy() * (FOCAL_PX / p.z) + noise));
            }
            points.push(point);
        }
        Self { poses, points, observations }
    }

    /// Moves every pose but the first two, and every point, by Gaussian noise.
    pub fn disturbed(&self, rotation: f64, translation: f64, point: f64, seed: u64) -> Self {
        let mut rng = rng(seed);
        let mut moved = self.clone();
        moved.poses.iter_mut().skip(2).for_each(|pose| *pose = jolted(pose, rotation, translation, &mut rng));
        moved.points.iter_mut().for_each(|p| *p += normal3(&mut rng) * point);
        moved
    }

    /// The same world, `scale` times as large.
    pub fn scaled(&self, scale: f64) -> Self {
        let mut world = self.clone();
        world.poses.iter_mut().for_each(|pose| pose.translation *= scale);
        world.points.iter_mut().for_each(|point| *point *= scale);
        world
    }
}

/// A bundle adjustment of a [`World`].
pub struct Bundle {
    pub problem: Problem,
    pub poses: Vec<VariableId<Pose>>,
    pub points: Vec<VariableId<Vector3<f64>>>,
    pub group: GroupId<PointReprojection>,
}

impl Bundle {
    /// With the first two cameras fixed.
    pub fn new(world: &World, kernel: Kernel) -> Self {
        let mut problem = Problem::new();
        let poses: Vec<_> = world.poses.iter().map(|pose| problem.add_variable(*pose)).collect();
        let points: Vec<_> = world.points.iter().map(|point| problem.add_landmark(*point)).collect();
        poses.iter().take(2).for_each(|id| problem.set_fixed(*id, true));
        let factors = world.observations.iter().map(|&(camera, point, pixel)| {
            ((poses[camera], points[point]), PointReprojection { pixel, sigma_px: 1.0 })
        });
        let group = problem.add_factors(kernel, factors);
        Self { problem, poses, points, group }
    }

    /// The bytes of every value.
    pub fn bits(&self) -> Vec<u64> {
        let poses = self.poses.iter().flat_map(|id| {
            let pose = self.problem.value(*id);
            pose.rotation.coords.iter().chain(pose.translation.iter()).copied().collect::<Vec<_>>()
        });
        let points =
            self.points.iter().flat_map(|id| self.problem.value(*id).iter().copied().collect::<Vec<_>>());
        poses.chain(points).map(f64::to_bits).collect()
    }
}

/// A camera's normalized image of a line's segment between two parameters, with noise.
pub fn observe_segment(
    pose: &Pose,
    ends: [Vector3<f64>; 2],
    noise_px: f64,
    rng: &mut ChaCha8Rng,
) -> [Vector3<f64>; 2] {
    ends.map(|end| {
        let p = pose.transform(&end);
        let noise = Vector3::new(normal(rng), normal(rng), 0.0) * (noise_px / FOCAL_PX);
        p / p.z + noise
    })
}

/// A line through two points as a variable.
pub fn line_through(ends: [Vector3<f64>; 2]) -> OrthonormalLine {
    let line = Line3::from_points(&ends[0], &ends[1]).expect("the points differ");
    OrthonormalLine::from_line(&line).expect("the line misses the origin")
}
