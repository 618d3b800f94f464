//! Gauge freedom: the seven dimensions that a single camera cannot know stay free, whatever factors there
//! are.

use super::anchored_line::AnchoredLine;
use super::factors::{
    LineReprojectionFactor, PointReprojectionFactor, StructuralConsistencyFactor, VanishingReprojectionFactor,
};
use crate::map::LinePlace;
use geometry::nalgebra::{Vector3, Vector6};
use geometry::{Direction, Line3, Pinhole, Pose};
use optim::{Kernel, Problem};

const PINHOLE: Pinhole = Pinhole { fx: 458.0, fy: 457.0, cx: 320.0, cy: 240.0 };
/// Three of attitude, three of position, one of scale.
const N_FREE: usize = 7;

fn poses() -> Vec<Pose> {
    let pose =
        |s: f64| Pose::exp(&Vector6::new(0.05 * s, -0.1 * s, 0.03 * s, 0.2 * s, 0.1 - 0.05 * s, 0.02 * s));
    (0..4).map(|idx| pose(f64::from(idx))).collect()
}

fn points() -> Vec<Vector3<f64>> {
    (0..12)
        .map(f64::from)
        .map(|s| Vector3::new((1.3 * s).sin(), (0.7 * s).cos(), 3.5 + (2.1 * s).sin()))
        .collect()
}

/// Lines of two directions.
fn places(directions: &[Vector3<f64>]) -> Vec<(usize, LinePlace)> {
    (0..8)
        .map(|i| {
            let (family, s) = (i % 2, f64::from(i as u32));
            let start = Vector3::new((0.9 * s).cos(), (1.1 * s).sin(), 3.0 + 0.2 * s);
            let end = start + directions[family] * 0.8;
            (family, LinePlace { line: Line3::from_points(&start, &end).unwrap(), endpoints: [start, end] })
        })
        .collect()
}

#[test]
fn points_lines_and_primitives_together_leave_exactly_seven_free_dimensions() {
    let directions = [Vector3::new(1.0, 0.1, 0.2).normalize(), Vector3::new(0.1, 1.0, -0.3).normalize()];
    let (poses, mut problem) = (poses(), Problem::new());
    let pose_ids: Vec<_> = poses.iter().map(|pose| problem.add_variable(*pose)).collect();
    let direction_ids = directions.map(|direction| problem.add_variable(Direction::new(direction).unwrap()));
    let project = |pose: &Pose, point: &Vector3<f64>| PINHOLE.project(&pose.transform(point));

    let mut point_factors = Vec::new();
    for point in points() {
        let variable = problem.add_landmark(point);
        for (pose, id) in poses.iter().zip(&pose_ids) {
            let observed_px = project(pose, &point);
            let factor = PointReprojectionFactor { pinhole: PINHOLE, observed_px, inverse_sigma: 1.0 };
            point_factors.push(((*id, variable), factor));
        }
    }
    let (mut line_factors, mut vanishing_factors, mut parallel_factors) =
        (Vec::new(), Vec::new(), Vec::new());
    for (family, place) in places(&directions) {
        let anchored = AnchoredLine::new(&place).unwrap();
        let variable = problem.add_landmark(anchored.line);
        for (pose, id) in poses.iter().zip(&pose_ids) {
            let [start_px, end_px] = place.endpoints.map(|end| project(pose, &end));
            let inverse_sigma = 1.0;
            line_factors.push((
                (*id, variable),
                LineReprojectionFactor {
                    pinhole: PINHOLE,
                    start_px,
                    end_px,
                    inverse_sigma,
                    origin: anchored.origin,
                },
            ));
            let factor = VanishingReprojectionFactor { pinhole: PINHOLE, start_px, end_px, inverse_sigma };
            vanishing_factors.push(((*id, direction_ids[family]), factor));
        }
        let factor = StructuralConsistencyFactor { inverse_sigma: 57.0 };
        parallel_factors.push(((direction_ids[family], variable), factor));
    }
    problem.add_factors(Kernel::None, point_factors);
    problem.add_factors(Kernel::None, line_factors);
    problem.add_factors(Kernel::None, vanishing_factors);
    problem.add_factors(Kernel::None, parallel_factors);

    assert!(problem.cost().chi2 < 1e-12, "the scene explains its own images");
    let (hessian, _) = problem.dense_normal_equations();
    let mut eigenvalues: Vec<f64> = hessian.symmetric_eigenvalues().iter().copied().collect();
    eigenvalues.sort_by(f64::total_cmp);
    let largest = eigenvalues[eigenvalues.len() - 1];
    let n_zero = eigenvalues.iter().filter(|value| value.abs() < 1e-12 * largest).count();
    assert_eq!(n_zero, N_FREE, "smallest eigenvalues {:?} of {largest:e}", &eigenvalues[..N_FREE + 3]);
}
