//! Pose graphs: no landmarks, sparse factorization, far from the minimum.

mod common;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use common::rng;
use flate2::read::GzDecoder;
use geometry::{Pose, Similarity, so3};
use nalgebra::{Matrix3, Quaternion, SMatrix, SVector, UnitQuaternion, Vector3};
use optim::testing::assert_jacobians_match;
use optim::{Factor, Kernel, Linearized, Problem, SolverOptions};

/// The chordal distance of a relative pose, `r = [√κ vec(R_j − R_i R_ij), √τ (t_j − t_i − R_i t_ij)]` with
/// the `world_from_body` poses `i` and `j`: `‖r‖²` is the cost of SE-Sync [Rosen et al. 2019].
#[derive(Clone, Debug)]
struct ChordalEdge {
    i_from_j: Pose,
    sqrt_kappa: f64,
    sqrt_tau: f64,
}

type Vector12 = SVector<f64, 12>;

impl Factor for ChordalEdge {
    type Residual = Vector12;
    type Variables = (Pose, Pose);

    fn residual(&self, (i, j): (&Pose, &Pose)) -> Option<Vector12> {
        let predicted = *i * self.i_from_j;
        let turn = (j.rotation_matrix() - predicted.rotation_matrix()) * self.sqrt_kappa;
        let shift = (j.translation - predicted.translation) * self.sqrt_tau;
        Some(Vector12::from_iterator(turn.iter().chain(shift.iter()).copied()))
    }

    fn linearize(&self, (i, j): (&Pose, &Pose)) -> Option<Linearized<Self>> {
        let by_left = |pose: &Pose| {
            let rotation = pose.rotation_matrix();
            let mut jacobian = SMatrix::<f64, 12, 6>::zeros();
            for k in 0..3 {
                let turned = -so3::skew(&rotation.column(k).into_owned()) * self.sqrt_kappa;
                jacobian.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(&turned);
            }
            jacobian.fixed_view_mut::<3, 3>(9, 0).copy_from(&(-so3::skew(&pose.translation) * self.sqrt_tau));
            jacobian.fixed_view_mut::<3, 3>(9, 3).copy_from(&(Matrix3::identity() * self.sqrt_tau));
            jacobian
        };
        Some((self.residual((i, j))?, (-by_left(&(*i * self.i_from_j)), by_left(j))))
    }
}

/// An edge with the poses it joins.
type Edge = (usize, usize, ChordalEdge);

/// Reads the vertices' number and the edges of a packed g2o file.
fn read_g2o(name: &str) -> (usize, Vec<Edge>) {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/pose_graphs"));
    let file = File::open(folder.join(format!("{name}.g2o.gz"))).expect("the pose graph is in the tree");
    let mut text = String::new();
    GzDecoder::new(file).read_to_string(&mut text).expect("the pose graph is text");
    let mut n_poses = 0;
    let mut edges = Vec::new();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("VERTEX_SE3:QUAT") => n_poses += 1,
            Some("EDGE_SE3:QUAT") => edges.push(parse_edge(words)),
            _ => {}
        }
    }
    (n_poses, edges)
}

fn parse_edge<'a>(words: impl Iterator<Item = &'a str>) -> Edge {
    let numbers: Vec<f64> = words.map(|word| word.parse().expect("g2o holds numbers")).collect();
    let [i, j, x, y, z, qx, qy, qz, qw] = numbers[..9] else { unreachable!("the slice has nine entries") };
    let mut upper = numbers[9..30].iter().copied();
    let mut information = SMatrix::<f64, 6, 6>::zeros();
    for row in 0..6 {
        for column in row..6 {
            information[(row, column)] = upper.next().expect("21 entries");
            information[(column, row)] = information[(row, column)];
        }
    }
    let spread = |at: usize| {
        let block: Matrix3<f64> = information.fixed_view::<3, 3>(at, at).into_owned();
        block.try_inverse().expect("the information is regular").trace()
    };
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(qw, qx, qy, qz));
    let i_from_j = Pose::new(rotation, Vector3::new(x, y, z));
    let (sqrt_tau, sqrt_kappa) = ((3.0 / spread(0)).sqrt(), (3.0 / (2.0 * spread(3))).sqrt());
    (i as usize, j as usize, ChordalEdge { i_from_j, sqrt_kappa, sqrt_tau })
}

/// Chains the odometry edges, optimizes, and returns SE-Sync's cost.
fn optimized_cost(n_poses: usize, edges: Vec<Edge>) -> f64 {
    let mut world_from_body = vec![Pose::identity(); n_poses];
    for (i, j, edge) in edges.iter().filter(|(i, j, _)| *j == i + 1) {
        world_from_body[*j] = world_from_body[*i] * edge.i_from_j;
    }
    let mut problem = Problem::new();
    let ids: Vec<_> = world_from_body.iter().map(|pose| problem.add_variable(*pose)).collect();
    problem.set_fixed(ids[0], true);
    problem.add_factors(Kernel::None, edges.into_iter().map(|(i, j, edge)| ((ids[i], ids[j]), edge)));
    let options = SolverOptions { max_iterations: 150, min_relative_decrease: 1e-7, ..Default::default() };
    let report = problem.solve(&options, || false);
    println!("{report:?}");
    report.last.chi2
}

/// Converges to within one percent of the certified optimum of SE-Sync.
#[track_caller]
fn assert_optimum(name: &str, certified: f64) {
    let (n_poses, edges) = read_g2o(name);
    let cost = optimized_cost(n_poses, edges);
    assert!((cost / certified - 1.0).abs() < 0.01, "{name}: {cost} instead of {certified}");
}

#[test]
fn small_grid_reaches_the_certified_optimum() {
    assert_optimum("smallGrid3D", 1025.4);
}

#[test]
fn sphere2500_reaches_the_certified_optimum() {
    assert_optimum("sphere2500", 1687.0);
}

#[test]
fn parking_garage_reaches_the_certified_optimum() {
    assert_optimum("parking-garage", 1.263);
}

#[test]
fn chordal_edges_have_the_right_derivatives() {
    let pose = |k: f64| Pose::exp(&SVector::from_fn(|i, _| (k + i as f64).sin()));
    let edge = ChordalEdge { i_from_j: pose(0.3), sqrt_kappa: 3.0, sqrt_tau: 2.0 };
    assert_jacobians_match(&edge, &(pose(1.0), pose(2.0)), 1e-6, 1e-5);
}

/// `r = (S p − measured) / sigma`
struct SimilarPoint {
    measured: Vector3<f64>,
    sigma: f64,
}

impl Factor for SimilarPoint {
    type Residual = Vector3<f64>;
    type Variables = (Similarity, Vector3<f64>);

    fn residual(&self, (similarity, p): (&Similarity, &Vector3<f64>)) -> Option<Vector3<f64>> {
        Some((similarity.transform(p) - self.measured) / self.sigma)
    }

    fn linearize(&self, (similarity, p): (&Similarity, &Vector3<f64>)) -> Option<Linearized<Self>> {
        let moved = similarity.transform(p);
        let mut by_similarity = SMatrix::<f64, 3, 7>::zeros();
        by_similarity.fixed_columns_mut::<3>(0).copy_from(&-so3::skew(&moved));
        by_similarity.fixed_columns_mut::<3>(3).copy_from(&Matrix3::identity());
        by_similarity.column_mut(6).copy_from(&moved);
        let by_point = similarity.rotation.to_rotation_matrix().into_inner() * similarity.scale;
        Some((self.residual((similarity, p))?, (by_similarity / self.sigma, by_point / self.sigma)))
    }
}

#[test]
fn similarities_and_points_are_recovered_together() {
    let mut rng = rng(1);
    let points: Vec<Vector3<f64>> = (0..30).map(|_| common::normal3(&mut rng)).collect();
    let truth: Vec<Similarity> = (0..5)
        .map(|k| Similarity::exp(&SVector::from_fn(|i, _| 0.5 * (f64::from(k) * (1.0 + i as f64)).sin())))
        .collect();
    let mut problem = Problem::new();
    let ids: Vec<_> = (0..5).map(|_| problem.add_variable(Similarity::identity())).collect();
    let point_ids: Vec<_> =
        points.iter().map(|p| problem.add_landmark(p + common::normal3(&mut rng) * 0.05)).collect();
    problem.set_value(ids[0], truth[0]);
    problem.set_fixed(ids[0], true);
    let mut factors = Vec::new();
    for (p, p_id) in points.iter().zip(&point_ids) {
        for (similarity, id) in truth.iter().zip(&ids) {
            let factor = SimilarPoint { measured: similarity.transform(p), sigma: 0.01 };
            assert_jacobians_match(&factor, &(Similarity::identity(), *p), 1e-6, 1e-5);
            factors.push(((*id, *p_id), factor));
        }
    }
    problem.add_factors(Kernel::None, factors);
    let report = problem.solve(&SolverOptions { max_iterations: 50, ..Default::default() }, || false);
    assert!(report.last.chi2 < 1e-8, "{report:?}");
    for (id, similarity) in ids.iter().zip(&truth) {
        assert!((problem.value(*id).scale - similarity.scale).abs() < 1e-6);
    }
}
