//! Infinite lines of space in Plücker coordinates, and their manifold.

use std::ops::Mul;

use nalgebra::{
    Matrix2, Matrix3, Matrix3x6, Matrix4, SMatrix, SymmetricEigen, UnitQuaternion, Vector2, Vector3, Vector4,
};

use crate::{Direction, Pinhole, Pose, Similarity, so3};

/// Planes whose normals are closer to parallel than this, in radians, do not define a line.
const MIN_PLANE_ANGLE_RAD: f64 = 1e-9;

/// How far, relative to its size, a stored line may be off unit length and orthogonality: many
/// transformations may have passed over it since it was normalized, each adding some rounding.
const MAX_STORED_ERROR: f64 = 1e-6;

/// An infinite line: a unit direction `v` and a moment `n = X × v`, the same for every point `X` on it.
///
/// `(n, v)` and `(-n, -v)` are the same line. The moment is orthogonal to the direction and as long as the
/// distance of the line from the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line3 {
    moment: Vector3<f64>,
    direction: Vector3<f64>,
}

impl Line3 {
    /// The line through `point` along `direction`, of any length. `None` if that is zero or anything is not
    /// finite.
    pub fn from_point_direction(point: &Vector3<f64>, direction: &Vector3<f64>) -> Option<Self> {
        let direction = direction.try_normalize(0.0)?;
        let line = Self { moment: point.cross(&direction), direction };
        line.is_finite().then_some(line)
    }

    /// The line from `a` to `b`. `None` if they coincide or are not finite.
    pub fn from_points(a: &Vector3<f64>, b: &Vector3<f64>) -> Option<Self> {
        Self::from_point_direction(a, &(b - a))
    }

    /// The line of Plücker coordinates of any scale. A part of the moment along the direction, which no line
    /// has, is removed. `None` if the direction is zero (a line at infinity) or anything is not finite.
    pub fn from_pluecker(moment: &Vector3<f64>, direction: &Vector3<f64>) -> Option<Self> {
        let length = direction.norm();
        let direction = direction.try_normalize(0.0)?;
        let moment = moment / length;
        let line = Self { moment: moment - direction * direction.dot(&moment), direction };
        line.is_finite().then_some(line)
    }

    /// A line that was one before, taken over bit for bit: for what was stored. `None` if the direction is
    /// not of unit length, the moment not orthogonal to it, or anything not finite.
    pub fn from_stored(moment: Vector3<f64>, direction: Vector3<f64>) -> Option<Self> {
        let is_unit = (direction.norm() - 1.0).abs() <= MAX_STORED_ERROR;
        let is_orthogonal = direction.dot(&moment).abs() <= MAX_STORED_ERROR * moment.norm().max(1.0);
        (is_unit && is_orthogonal && moment.iter().all(|x| x.is_finite()))
            .then_some(Self { moment, direction })
    }

    /// The line in which two planes `a·X + a₄ = 0` meet. `None` if they are parallel.
    pub fn from_planes(a: &Vector4<f64>, b: &Vector4<f64>) -> Option<Self> {
        let (normal_a, normal_b) = (a.xyz(), b.xyz());
        let direction = normal_a.cross(&normal_b);
        let sine = direction.norm() / (normal_a.norm() * normal_b.norm());
        if sine.is_nan() || sine < MIN_PLANE_ANGLE_RAD {
            return None;
        }
        Self::from_pluecker(&(normal_b * a.w - normal_a * b.w), &direction)
    }

    /// `n`.
    #[inline]
    pub fn moment(&self) -> &Vector3<f64> {
        &self.moment
    }

    /// `v`, of unit length.
    #[inline]
    pub fn direction(&self) -> &Vector3<f64> {
        &self.direction
    }

    /// The point of the line nearest to the origin, `v × n`.
    #[inline]
    pub fn origin(&self) -> Vector3<f64> {
        self.direction.cross(&self.moment)
    }

    /// The point `origin + parameter v`.
    #[inline]
    pub fn at(&self, parameter: f64) -> Vector3<f64> {
        self.origin() + self.direction * parameter
    }

    /// The parameter of the point of the line nearest to `point`.
    #[inline]
    pub fn parameter_of(&self, point: &Vector3<f64>) -> f64 {
        self.direction.dot(point)
    }

    /// The distance of `point` from the line.
    #[inline]
    pub fn distance(&self, point: &Vector3<f64>) -> f64 {
        (point.cross(&self.direction) - self.moment).norm()
    }

    /// The parameter of the point of the line nearest to the ray from `center` along the unit vector `ray`:
    /// where an observed endpoint lies on the line. `None` if they are parallel.
    #[inline]
    pub fn parameter_nearest_to_ray(&self, center: &Vector3<f64>, ray: &Vector3<f64>) -> Option<f64> {
        let w = center - self.origin();
        let b = self.direction.dot(ray);
        let parameter = (self.direction.dot(&w) - b * ray.dot(&w)) / (1.0 - b * b);
        parameter.is_finite().then_some(parameter)
    }

    /// The line in the target frame of `target_from_source`: `n' = R n + t × R v`, `v' = R v`.
    #[inline]
    pub fn transformed(&self, target_from_source: &Pose) -> Self {
        let direction = target_from_source.rotation * self.direction;
        let moment =
            target_from_source.rotation * self.moment + target_from_source.translation.cross(&direction);
        Self { moment, direction }
    }

    /// The line in the target frame of a similarity: `n' = s R n + t × R v`, `v' = R v`.
    #[inline]
    pub fn scaled(&self, target_from_source: &Similarity) -> Self {
        let direction = target_from_source.rotation * self.direction;
        let moment = (target_from_source.rotation * self.moment) * target_from_source.scale
            + target_from_source.translation.cross(&direction);
        Self { moment, direction }
    }

    /// The image line `l`, with `l · (u, v, 1) = 0` for its pixels, of this line in the frame of `camera`.
    /// Not normalized; zero if the line passes the camera center.
    #[inline]
    pub fn image_line(&self, camera: &Pinhole) -> Vector3<f64> {
        let n = &self.moment;
        let x = camera.fy * n.x;
        let y = camera.fx * n.y;
        Vector3::new(x, y, camera.fx * camera.fy * n.z - camera.cx * x - camera.cy * y)
    }

    /// Whether every number in it is finite.
    #[inline]
    pub fn is_finite(&self) -> bool {
        self.moment.iter().chain(self.direction.iter()).all(|x| x.is_finite())
    }
}

impl Mul<Line3> for Pose {
    type Output = Line3;

    #[inline]
    fn mul(self, line: Line3) -> Line3 {
        line.transformed(&self)
    }
}

impl Mul<Line3> for Similarity {
    type Output = Line3;

    #[inline]
    fn mul(self, line: Line3) -> Line3 {
        line.scaled(&self)
    }
}

/// The plane `(a, a₄)` in the world, `a · X + a₄ = 0`, that a camera's center and an observed segment span;
/// `normal` is the unit normal in the camera frame.
#[inline]
pub fn interpretation_plane(camera_from_world: &Pose, normal: &Vector3<f64>) -> Vector4<f64> {
    let a = camera_from_world.rotation.inverse() * normal;
    Vector4::new(a.x, a.y, a.z, normal.dot(&camera_from_world.translation))
}

/// The world line whose interpretation planes in two cameras have the unit normals `normal_a` and `normal_b`
/// (camera frames). `None` if the planes are parallel or coincide.
pub fn triangulate(
    camera_a_from_world: &Pose,
    normal_a: &Vector3<f64>,
    camera_b_from_world: &Pose,
    normal_b: &Vector3<f64>,
) -> Option<Line3> {
    Line3::from_planes(
        &interpretation_plane(camera_a_from_world, normal_a),
        &interpretation_plane(camera_b_from_world, normal_b),
    )
}

/// A line from many views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineEstimate {
    /// The line, in the world.
    pub line: Line3,
    /// How much better a line explains the planes than less than a line does: the second smallest singular
    /// value of the stacked planes over the third, in `[0, 1]`. Small is good; near one the planes have no
    /// line in common, or are all the same plane.
    pub rank_ratio: f64,
}

/// The world line closest, in the linear sense, to the interpretation planes of two or more views, given as
/// `camera_from_world` and unit normal in that camera. `None` if the planes are parallel or coincide.
///
/// `scene_depth` is a typical distance of the line from the cameras, which balances offsets of the planes
/// against their directions.
pub fn triangulate_many(views: &[(Pose, Vector3<f64>)], scene_depth: f64) -> Option<LineEstimate> {
    /// Singular values are measured with rounding errors of about this relative size.
    const MIN_RELATIVE_SINGULAR_VALUE: f64 = 1e-7;
    if views.len() < 2 || !(scene_depth.is_finite() && scene_depth > 0.0) {
        return None;
    }
    let mean_center = views.iter().map(|(pose, _)| pose.center()).sum::<Vector3<f64>>() / views.len() as f64;
    let mut normal_matrix = Matrix4::zeros();
    for (pose, normal) in views {
        let mut plane = interpretation_plane(pose, normal);
        plane.w = (plane.w + plane.xyz().dot(&mean_center)) / scene_depth;
        normal_matrix += plane * plane.transpose();
    }
    if !normal_matrix.iter().all(|x| x.is_finite()) {
        return None;
    }
    let eigen = SymmetricEigen::new(normal_matrix);
    let mut order = [0, 1, 2, 3];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let singular = order.map(|i| eigen.eigenvalues[i].max(0.0).sqrt());
    if singular[2] <= MIN_RELATIVE_SINGULAR_VALUE * singular[3] {
        return None;
    }
    // The two homogeneous points that all planes contain: (a, a₄), (b, b₄) give v = a₄ b - b₄ a, n = a × b.
    let a = eigen.eigenvectors.column(order[0]).into_owned();
    let b = eigen.eigenvectors.column(order[1]).into_owned();
    let direction = b.xyz() * a.w - a.xyz() * b.w;
    let moment = a.xyz().cross(&b.xyz());
    let local = Line3::from_pluecker(&moment, &direction)?;
    let line = Line3::from_point_direction(&(local.origin() * scene_depth + mean_center), local.direction())?;
    Some(LineEstimate { line, rank_ratio: singular[1] / singular[2] })
}

/// The world line of the known `direction` closest to the interpretation planes of two or more views, given
/// as `camera_from_world` and unit normal in that camera. `None` if they do not determine it.
pub fn triangulate_with_direction(views: &[(Pose, Vector3<f64>)], direction: &Direction) -> Option<Line3> {
    /// Smallest reciprocal condition of the 2 x 2 normal equations.
    const MIN_RECIPROCAL_CONDITION: f64 = 1e-12;
    if views.len() < 2 {
        return None;
    }
    // The line crosses the plane through the origin orthogonal to it at B y.
    let basis = direction.basis();
    let mut normal_matrix = Matrix2::zeros();
    let mut right = Vector2::zeros();
    for (pose, normal) in views {
        let plane = interpretation_plane(pose, normal);
        let row = basis.transpose() * plane.xyz();
        normal_matrix += row * row.transpose();
        right -= row * plane.w;
    }
    let half_trace = 0.5 * normal_matrix.trace();
    let reciprocal_condition = normal_matrix.determinant() / (half_trace * half_trace);
    if reciprocal_condition.is_nan() || reciprocal_condition < MIN_RECIPROCAL_CONDITION {
        return None;
    }
    let y = normal_matrix.try_inverse()? * right;
    Line3::from_point_direction(&(basis * y), direction.as_vector())
}

/// A line in the four-parameter form used for optimization [Bartoli & Sturm 2005].
///
/// `U = [u₁ u₂ u₃] = [n/|n|, v/|v|, u₁ × u₂]` is a rotation, and the angle `φ` of `(w₁, w₂) = (cos φ, sin φ)`
/// weighs the two: `n = w₁ u₁`, `v = w₂ u₂`. Tangent vectors are `[θ(3), δφ]`, with `U ← U exp(θ)`.
///
/// The form breaks down for a line through the origin, and `φ` is hardly determined for one far away: use it
/// about an origin near the line but not on it, in units of the scene's depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrthonormalLine {
    rotation: UnitQuaternion<f64>,
    angle: f64,
    /// `(w₁, w₂)`, the cosine and sine of `angle`: asked for by every observation.
    weights: (f64, f64),
}

impl OrthonormalLine {
    #[inline]
    fn new(rotation: UnitQuaternion<f64>, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { rotation, angle, weights: (cos, sin) }
    }

    /// `None` if the line passes through the origin.
    pub fn from_line(line: &Line3) -> Option<Self> {
        let distance = line.moment.norm();
        let u1 = line.moment.try_normalize(0.0)?;
        let u = Matrix3::from_columns(&[u1, line.direction, u1.cross(&line.direction)]);
        let mut rotation = Pose::from_rotation_matrix(&u, &Vector3::zeros()).rotation;
        rotation.renormalize();
        // The unit direction has weight one.
        Some(Self::new(rotation, 1.0_f64.atan2(distance)))
    }

    /// `None` if the line has been moved to infinity.
    pub fn to_line(&self) -> Option<Line3> {
        let u = self.columns();
        let (w1, w2) = self.weights;
        Line3::from_pluecker(&(u[0] * w1), &(u[1] * w2))
    }

    #[inline]
    fn columns(&self) -> [Vector3<f64>; 3] {
        let u = self.rotation.to_rotation_matrix();
        std::array::from_fn(|i| u.matrix().column(i).into_owned())
    }

    /// Turns `U` by the first three entries of `delta` on the right and adds the last to `φ`.
    #[inline]
    pub fn retract(&self, delta: &Vector4<f64>) -> Self {
        let mut rotation = self.rotation * so3::exp(&delta.xyz());
        rotation.renormalize();
        Self::new(rotation, self.angle + delta.w)
    }

    /// The `delta` with `self.retract(delta)` the same line as `other`, the shorter one of the two that the
    /// sign of Plücker coordinates allows.
    pub fn local(&self, other: &Self) -> Vector4<f64> {
        let relative = self.rotation.inverse() * other.rotation;
        // (-n, -v) turns u₁ and u₂ around: half a turn about u₃.
        let half_turn = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(0.0, 0.0, 0.0, 1.0));
        let candidates = [so3::log(&relative), so3::log(&(relative * half_turn))];
        let theta = if candidates[0].norm_squared() <= candidates[1].norm_squared() {
            candidates[0]
        } else {
            candidates[1]
        };
        let turn = other.angle - self.angle;
        let turn = turn - std::f64::consts::TAU * (turn / std::f64::consts::TAU).round();
        Vector4::new(theta.x, theta.y, theta.z, turn)
    }

    /// The moment `w₁ u₁` and direction `w₂ u₂`, of which [`jacobian`](Self::jacobian) is the derivative.
    /// Unlike those of [`Line3`] they are scaled to `|n|² + |v|² = 1`.
    #[inline]
    pub fn pluecker(&self) -> (Vector3<f64>, Vector3<f64>) {
        let u = self.columns();
        let (w1, w2) = self.weights;
        (u[0] * w1, u[1] * w2)
    }

    /// The derivative of `moment · n + direction · v`, with `n` and `v` as of [`pluecker`](Self::pluecker),
    /// by the tangent vector: a row of a matrix times [`jacobian`](Self::jacobian), without its zeros.
    #[inline]
    pub fn derivative(&self, by_moment: &Vector3<f64>, by_direction: &Vector3<f64>) -> Vector4<f64> {
        let [u1, u2, u3] = self.columns();
        let (w1, w2) = self.weights;
        Vector4::new(
            w2 * by_direction.dot(&u3),
            -w1 * by_moment.dot(&u3),
            w1 * by_moment.dot(&u2) - w2 * by_direction.dot(&u1),
            w1 * by_direction.dot(&u2) - w2 * by_moment.dot(&u1),
        )
    }

    /// The derivative of [`pluecker`](Self::pluecker), moment first, by the tangent vector.
    #[inline]
    pub fn jacobian(&self) -> SMatrix<f64, 6, 4> {
        let [u1, u2, u3] = self.columns();
        let (w1, w2) = self.weights;
        let mut jacobian = SMatrix::<f64, 6, 4>::zeros();
        jacobian.fixed_view_mut::<3, 1>(0, 1).copy_from(&(u3 * -w1));
        jacobian.fixed_view_mut::<3, 1>(0, 2).copy_from(&(u2 * w1));
        jacobian.fixed_view_mut::<3, 1>(0, 3).copy_from(&(u1 * -w2));
        jacobian.fixed_view_mut::<3, 1>(3, 0).copy_from(&(u3 * w2));
        jacobian.fixed_view_mut::<3, 1>(3, 2).copy_from(&(u1 * -w2));
        jacobian.fixed_view_mut::<3, 1>(3, 3).copy_from(&(u2 * w1));
        jacobian
    }
}

/// The derivative `[R, [t]× R]` of the moment in the camera by Plücker coordinates in the world, moment
/// first.
#[inline]
pub fn d_moment_d_pluecker(camera_from_world: &Pose) -> Matrix3x6<f64> {
    let r = camera_from_world.rotation_matrix();
    let mut jacobian = Matrix3x6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(so3::skew(&camera_from_world.translation) * r));
    jacobian
}
