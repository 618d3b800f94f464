//! The pose of a camera that sees known points.

use nalgebra::{Matrix2x3, Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
use rand::Rng;

use crate::ransac::{Estimator, RansacConfig, RansacReport, ransac};
use crate::{Direction, Pose, polynomial, so3};

/// A solution must reproduce the squared distances between the points to this, relative to their mean.
const MAX_RELATIVE_DISTANCE_ERROR: f64 = 1e-9;

/// Triangles whose sine of an angle is below this have no area to speak of: their pose is not determined.
const MIN_TRIANGLE_SINE: f64 = 1e-7;

/// The poses (`camera_from_world`, up to four) from which three world points are seen along three unit
/// bearings.
///
/// The depths `d` of the points satisfy three quadratic equations, one per side of the triangle. Two
/// combinations of them are homogeneous, that is, two conics in the ratios of the depths; their pencil
/// contains a pair of lines, each of which meets the conics in at most two points [Persson & Nordberg 2018,
/// section 3; Ding et al. 2023]. Depths are then polished by Newton's method on the three equations.
///
/// Empty if the points lie on a line, two bearings coincide, or anything is not finite.
pub fn p3p(bearings: &[Vector3<f64>; 3], points: &[Vector3<f64>; 3]) -> Vec<Pose> {
    let sides = [points[0] - points[1], points[0] - points[2], points[1] - points[2]];
    let mean_squared_side = sides.iter().map(Vector3::norm_squared).sum::<f64>() / 3.0;
    let area = sides[0].cross(&sides[1]).norm();
    let has_area = area > MIN_TRIANGLE_SINE * mean_squared_side;
    if !has_area || !bearings.iter().all(|b| b.norm_squared().is_finite()) {
        return Vec::new();
    }
    let problem = DepthProblem {
        cosines: [
            bearings[0].dot(&bearings[1]),
            bearings[0].dot(&bearings[2]),
            bearings[1].dot(&bearings[2]),
        ],
        squared_sides: sides.map(|side| side.norm_squared() / mean_squared_side),
    };
    let scale = mean_squared_side.sqrt();
    let mut poses: Vec<Pose> = Vec::with_capacity(4);
    for depths in problem.solve() {
        let seen: [Vector3<f64>; 3] = std::array::from_fn(|i| bearings[i] * (depths[i] * scale));
        let Some(pose) = pose_of_triangle(&seen, points) else { continue };
        if !poses.iter().any(|other| other.local(&pose).norm() < 1e-9) {
            poses.push(pose);
        }
    }
    poses
}

/// Pairs of points: sides of the triangle in the order used throughout.
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// `dᵢ² + dⱼ² - 2 cosᵢⱼ dᵢ dⱼ = sideᵢⱼ²` for each of [`PAIRS`].
struct DepthProblem {
    cosines: [f64; 3],
    squared_sides: [f64; 3],
}

impl DepthProblem {
    /// All positive solutions.
    fn solve(&self) -> Vec<Vector3<f64>> {
        let quadrics: [Matrix3<f64>; 3] = std::array::from_fn(|k| {
            let (i, j) = PAIRS[k];
            let mut m = Matrix3::zeros();
            m[(i, i)] = 1.0;
            m[(j, j)] = 1.0;
            m[(i, j)] = -self.cosines[k];
            m[(j, i)] = -self.cosines[k];
            m
        });
        let first = quadrics[0] * self.squared_sides[2] - quadrics[2] * self.squared_sides[0];
        let second = quadrics[1] * self.squared_sides[2] - quadrics[2] * self.squared_sides[1];
        let Some((lines, conic)) = lines_of_pencil(&first, &second) else { return Vec::new() };
        let mut solutions = Vec::with_capacity(4);
        for line in lines {
            for ratio in meet(&line, &conic) {
                solutions.extend(self.scaled(&ratio).and_then(|depths| self.polished(depths)));
            }
        }
        solutions
    }

    /// Gives the depth ratios their sign and size.
    fn scaled(&self, ratio: &Vector3<f64>) -> Option<Vector3<f64>> {
        let ratio = if ratio.sum() < 0.0 { -ratio } else { *ratio };
        // The sum over all three sides is better conditioned than any one of them.
        let squared: f64 = (0..3).map(|k| self.squared_distance(&ratio, k)).sum();
        let scale = (self.squared_sides.iter().sum::<f64>() / squared).sqrt();
        scale.is_finite().then_some(ratio * scale)
    }

    #[inline]
    fn squared_distance(&self, d: &Vector3<f64>, k: usize) -> f64 {
        let (i, j) = PAIRS[k];
        d[i] * d[i] + d[j] * d[j] - 2.0 * self.cosines[k] * d[i] * d[j]
    }

    /// Newton's method on the three equations; `None` if that does not end at a positive solution.
    fn polished(&self, mut depths: Vector3<f64>) -> Option<Vector3<f64>> {
        const MAX_ROUNDS: usize = 8;
        let mut error = f64::INFINITY;
        for _ in 0..MAX_ROUNDS {
            let residual = Vector3::from_fn(|k, _| self.squared_distance(&depths, k) - self.squared_sides[k]);
            error = residual.amax();
            if error < 1e-15 {
                break;
            }
            let mut jacobian = Matrix3::zeros();
            for (k, (i, j)) in PAIRS.into_iter().enumerate() {
                jacobian[(k, i)] = 2.0 * (depths[i] - self.cosines[k] * depths[j]);
                jacobian[(k, j)] = 2.0 * (depths[j] - self.cosines[k] * depths[i]);
            }
            let Some(inverse) = jacobian.try_inverse() else { break };
            depths -= inverse * residual;
        }
        (error < MAX_RELATIVE_DISTANCE_ERROR && depths.iter().all(|d| *d > 0.0)).then_some(depths)
    }
}

/// The two real lines of the degenerate conic `first + γ second`, and a conic of the pencil that is not it.
fn lines_of_pencil(first: &Matrix3<f64>, second: &Matrix3<f64>) -> Option<([Vector3<f64>; 2], Matrix3<f64>)> {
    let mut best: Option<(f64, Matrix3<f64>, f64)> = None;
    for gamma in polynomial::real_roots(&determinant_of_pencil(first, second)) {
        // The same conic in a form that stays finite as γ grows.
        let degenerate = if gamma.abs() > 1.0 { first / gamma + second } else { first + second * gamma };
        // The lines are real where the negative adjugate has a positive diagonal; the more so the better.
        let negative_adjugate = -adjugate(&degenerate);
        let quality = negative_adjugate.diagonal().max() / degenerate.norm_squared();
        if best.as_ref().is_none_or(|(best_quality, ..)| quality > *best_quality) {
            best = Some((quality, degenerate, gamma));
        }
    }
    let (quality, degenerate, gamma) = best?;
    if quality.is_nan() || quality <= 0.0 {
        return None;
    }
    let other = if gamma.abs() > 1.0 { *first } else { *second };
    Some((split_into_lines(&degenerate), other))
}

/// Splits a symmetric matrix `g hᵀ + h gᵀ` into `g` and `h` [Richter-Gebert 2011, section 11.1].
fn split_into_lines(degenerate: &Matrix3<f64>) -> [Vector3<f64>; 2] {
    let negative_adjugate = -adjugate(degenerate);
    let i = negative_adjugate.diagonal().imax();
    let crossing = negative_adjugate.column(i) / negative_adjugate[(i, i)].sqrt();
    let rank_one = degenerate + so3::skew(&crossing.into_owned());
    let (row, column) = rank_one.iamax_full();
    [rank_one.row(row).transpose(), rank_one.column(column).into_owned()]
}

/// The points, up to two, where a line meets a conic.
fn meet(line: &Vector3<f64>, conic: &Matrix3<f64>) -> Vec<Vector3<f64>> {
    /// Discriminants this far below zero are taken for tangents: the polish that follows decides.
    const MIN_RELATIVE_DISCRIMINANT: f64 = -1e-9;
    let Some(line) = Direction::new(*line) else { return Vec::new() };
    let basis = line.basis();
    let (u, v) = (basis.column(0).into_owned(), basis.column(1).into_owned());
    // α² a + 2 α β b + β² c = 0 for the point α u + β v.
    let (a, b, c) = (u.dot(&(conic * u)), u.dot(&(conic * v)), v.dot(&(conic * v)));
    let size = a * a + b * b + c * c;
    let discriminant = b * b - a * c;
    if discriminant.is_nan() || discriminant < MIN_RELATIVE_DISCRIMINANT * size {
        return Vec::new();
    }
    // Without cancellation: the two roots are (-q : a) and (c : -q).
    let q = b + discriminant.max(0.0).sqrt().copysign(b);
    [u * -q + v * a, u * c - v * q].into_iter().filter(|point| point.norm_squared() > 0.0).collect()
}

/// Coefficients of `det(first + γ second)`, ascending.
fn determinant_of_pencil(first: &Matrix3<f64>, second: &Matrix3<f64>) -> [f64; 4] {
    [
        first.determinant(),
        (adjugate(first) * second).trace(),
        (first * adjugate(second)).trace(),
        second.determinant(),
    ]
}

/// The adjugate of a symmetric matrix.
#[inline]
fn adjugate(m: &Matrix3<f64>) -> Matrix3<f64> {
    let columns: [Vector3<f64>; 3] = std::array::from_fn(|i| m.column(i).into_owned());
    Matrix3::from_columns(&[
        columns[1].cross(&columns[2]),
        columns[2].cross(&columns[0]),
        columns[0].cross(&columns[1]),
    ])
}

/// The pose that brings one triangle onto a congruent one.
fn pose_of_triangle(seen: &[Vector3<f64>; 3], points: &[Vector3<f64>; 3]) -> Option<Pose> {
    let frame = |t: &[Vector3<f64>; 3]| {
        let x = (t[1] - t[0]).normalize();
        let z = x.cross(&(t[2] - t[0])).normalize();
        Matrix3::from_columns(&[x, z.cross(&x), z])
    };
    let rotation = frame(seen) * frame(points).transpose();
    let mut pose = Pose::from_rotation_matrix(&rotation, &Vector3::zeros());
    pose.rotation.renormalize();
    let centroid = |t: &[Vector3<f64>; 3]| (t[0] + t[1] + t[2]) / 3.0;
    pose.translation = centroid(seen) - pose.rotation * centroid(points);
    pose.is_finite().then_some(pose)
}

/// One known point and where it is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseObservation {
    /// The unit vector towards the point in the camera frame.
    pub bearing: Vector3<f64>,
    /// The point in the world.
    pub point: Vector3<f64>,
    /// Standard deviation of the bearing across its direction, in radians: pixels of noise over the focal
    /// length.
    pub sigma_rad: f64,
}

impl PoseObservation {
    /// Squared distance between seen and predicted unit bearings, in standard deviations: for small errors
    /// that of the reprojection.
    #[inline]
    pub fn squared_residual(&self, camera_from_world: &Pose) -> f64 {
        let predicted = camera_from_world.transform(&self.point).normalize();
        (predicted - self.bearing).norm_squared() / (self.sigma_rad * self.sigma_rad)
    }
}

/// The pose that explains most observations, by [`p3p`] on random samples and [`refine_pose`] on the inliers.
///
/// The threshold of `config` is in squared standard deviations of the observations. `None` with fewer than
/// four observations, since three fit anything, or if no pose explains four.
pub fn ransac_pose(
    observations: &[PoseObservation],
    config: &RansacConfig,
    rng: &mut impl Rng,
) -> Option<RansacReport<Pose>> {
    search_pose(&PoseEstimator { observations, rotations: None }, config, rng)
}

/// As [`ransac_pose`], where the rotation is known to be one of a few: two observations then give the
/// position, so that a good sample is found among fewer and worse observations.
///
/// The rotation is refined with the rest in the end. `None` with fewer than four observations, or if no pose
/// explains four.
pub fn ransac_pose_with_rotations(
    observations: &[PoseObservation],
    rotations: &[UnitQuaternion<f64>],
    config: &RansacConfig,
    rng: &mut impl Rng,
) -> Option<RansacReport<Pose>> {
    search_pose(&PoseEstimator { observations, rotations: Some(rotations) }, config, rng)
}

/// Three observations fit anything: no pose is found from fewer than four, or explained by fewer.
fn search_pose(
    estimator: &PoseEstimator<'_>,
    config: &RansacConfig,
    rng: &mut impl Rng,
) -> Option<RansacReport<Pose>> {
    const MIN_OBSERVATIONS: usize = 4;
    if estimator.n_data() < MIN_OBSERVATIONS {
        return None;
    }
    ransac(estimator, config, rng).filter(|report| report.n_inliers >= MIN_OBSERVATIONS)
}

/// The position from which two points are nearest to the rays they are seen along, both in front of the
/// camera.
fn pose_with_rotation(rotation: &UnitQuaternion<f64>, sample: [&PoseObservation; 2]) -> Option<Pose> {
    // What is left of the point in the camera frame across the ray is to vanish: (I - b b^T) (R X + t) = 0.
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for observation in sample {
        let across = Matrix3::identity() - observation.bearing * observation.bearing.transpose();
        normal += across;
        right -= across * (rotation * observation.point);
    }
    let pose = Pose { rotation: *rotation, translation: normal.try_inverse()? * right };
    let is_in_front = |seen: &&PoseObservation| pose.transform(&seen.point).dot(&seen.bearing) > 0.0;
    (pose.is_finite() && sample.iter().all(is_in_front)).then_some(pose)
}

struct PoseEstimator<'a> {
    observations: &'a [PoseObservation],
    /// Those of which one is the camera's, if it is known to be so.
    rotations: Option<&'a [UnitQuaternion<f64>]>,
}

impl Estimator for PoseEstimator<'_> {
    type Model = Pose;

    fn sample_size(&self) -> usize {
        if self.rotations.is_some() { 2 } else { 3 }
    }

    fn n_data(&self) -> usize {
        self.observations.len()
    }

    fn fit_sample(&self, sample: &[usize], models: &mut Vec<Pose>) {
        if let Some(rotations) = self.rotations {
            let sample = [&self.observations[sample[0]], &self.observations[sample[1]]];
            models.extend(rotations.iter().filter_map(|rotation| pose_with_rotation(rotation, sample)));
        } else {
            let bearings = std::array::from_fn(|i| self.observations[sample[i]].bearing);
            let points = std::array::from_fn(|i| self.observations[sample[i]].point);
            models.extend(p3p(&bearings, &points));
        }
    }

    #[inline]
    fn squared_residual(&self, model: &Pose, datum: usize) -> f64 {
        self.observations[datum].squared_residual(model)
    }

    fn refine(&self, model: &Pose, inliers: &[usize]) -> Option<Pose> {
        refine_pose(model, inliers.iter().map(|datum| &self.observations[*datum]))
    }
}

/// Gauss-Newton from `start` to the least sum of squared residuals over `observations`.
///
/// `None` with fewer than four observations or if the pose is not determined by them.
pub fn refine_pose<'a>(
    start: &Pose,
    observations: impl Iterator<Item = &'a PoseObservation> + Clone,
) -> Option<Pose> {
    const MAX_ROUNDS: usize = 10;
    /// Steps shorter than this, in radians and map units relative to the depth of the scene, end the search.
    const MIN_STEP: f64 = 1e-10;
    if observations.clone().count() < 4 {
        return None;
    }
    let mut pose = *start;
    for _ in 0..MAX_ROUNDS {
        let mut hessian = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        for observation in observations.clone() {
            accumulate(&pose, observation, &mut hessian, &mut gradient);
        }
        let step = -hessian.cholesky()?.solve(&gradient);
        pose = pose.retract(&step);
        if !pose.is_finite() {
            return None;
        }
        if step.norm() < MIN_STEP * (1.0 + pose.translation.norm()) {
            break;
        }
    }
    Some(pose)
}

/// Adds one observation to the normal equations. Its residual is the difference of the bearings, along two
/// axes across the observed one.
#[inline]
fn accumulate(
    pose: &Pose,
    observation: &PoseObservation,
    hessian: &mut Matrix6<f64>,
    gradient: &mut Vector6<f64>,
) {
    let in_camera = pose.transform(&observation.point);
    let inverse_range = 1.0 / in_camera.norm();
    let predicted = in_camera * inverse_range;
    let Some(across) = Direction::new(observation.bearing).map(|direction| direction.basis()) else { return };
    let weight = 1.0 / observation.sigma_rad;
    let residual = across.transpose() * predicted * weight;
    let d_bearing_d_point: Matrix2x3<f64> = across.transpose()
        * (Matrix3::identity() - predicted * predicted.transpose())
        * (inverse_range * weight);
    // d(point)/dδ = [-[X]x, I].
    let d_rotation = -d_bearing_d_point * so3::skew(&in_camera);
    let mut jacobian = nalgebra::Matrix2x6::zeros();
    jacobian.fixed_view_mut::<2, 3>(0, 0).copy_from(&d_rotation);
    jacobian.fixed_view_mut::<2, 3>(0, 3).copy_from(&d_bearing_d_point);
    *hessian += jacobian.transpose() * jacobian;
    *gradient += jacobian.transpose() * residual;
}
