//! The camera that explains all views best: bundle adjustment of its numbers and of the board's poses.

use crate::config::CalibrationConfig;
use crate::factor::{CameraKind, CameraVector, CornerFactor, NumbersPriorFactor};
use crate::pose::board_pose;
use crate::report::{Calibrated, ViewErrors, judge, rms};
use crate::{Board, View};
use geometry::nalgebra::{Vector2, Vector3};
use geometry::{Camera, CameraError, CameraModel, Pose};
use optim::{Factor, GroupId, Kernel, Problem, SolverOptions, VariableId};

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Too few views hold a board.
    #[error(
        "the board was found whole in {found} of the pictures; at least {required} are needed, better 15"
    )]
    TooFewViews {
        /// Views with a board.
        found: usize,
        /// Views needed at least.
        required: usize,
    },
    /// No focal length explains the views.
    #[error(
        "no camera explains the views: are they of one camera, with the same zoom, and is the board's size right?"
    )]
    NoCamera,
    /// What was found is no camera.
    #[error("what explains the views best is no usable camera: {0}")]
    Unusable(#[from] CameraError),
}

/// Views without which nothing can be said.
const MIN_VIEWS: usize = 3;
/// Focal lengths that are tried, in shares of the image's longer side: the first, and the ratio of the next.
const FIRST_FOCAL_SHARE: f64 = 0.2;
const FOCAL_RATIO: f64 = 1.25;
const N_FOCALS: usize = 15;
/// Of these the best are adjusted.
const N_BEST: usize = 3;
/// Views by which focal lengths are compared.
const N_COMPARED: usize = 8;
/// Numbers that a model does not have are held this tightly.
const HELD_SIGMA: f64 = 1e-9;
/// A corner cannot be located better than this, pixels.
const MIN_SIGMA_PX: f64 = 0.01;

/// The camera of the views, which are all of one camera and board.
///
/// # Errors
/// If there is none.
pub fn calibrate(
    board: &Board,
    views: &[View],
    size: (u32, u32),
    config: &CalibrationConfig,
) -> Result<Calibrated, CalibrationError> {
    if views.len() < MIN_VIEWS {
        return Err(CalibrationError::TooFewViews { found: views.len(), required: MIN_VIEWS });
    }
    let n_coefficients = match config.model {
        CameraModel::Radtan if config.with_k3 => 5,
        model => model.coefficient_counts()[0],
    };
    let kind = CameraKind::new(config.model, n_coefficients, size);
    let mut adjustment = Adjustment { board, kind, config, sigma_px: 1.0 };
    let all: Vec<usize> = (0..views.len()).collect();
    let mut numbers = adjustment.begin(views).ok_or(CalibrationError::NoCamera)?;
    let mut used = all.clone();
    let mut solution = adjustment.solve(&numbers, views, &used, true).ok_or(CalibrationError::NoCamera)?;
    // Twice: errors say how far they are to be believed, and which views are to be left out.
    for _ in 0..2 {
        let errors: Vec<f64> = solution.residuals.iter().map(|view| rms(view)).collect();
        let mut sorted = errors.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted[sorted.len() / 2];
        let is_good =
            |position: &usize| errors[*position] <= config.max_view_ratio * median.max(MIN_SIGMA_PX);
        let good: Vec<usize> = (0..solution.used.len()).filter(is_good).map(|at| solution.used[at]).collect();
        if good.len() >= MIN_VIEWS {
            used = good;
        }
        // Each coordinate.
        adjustment.sigma_px = (median / 2f64.sqrt()).max(MIN_SIGMA_PX);
        numbers = solution.numbers;
        solution = adjustment.solve(&numbers, views, &used, true).ok_or(CalibrationError::NoCamera)?;
    }
    let camera = kind.parameters(&solution.numbers);
    Camera::new(camera.clone())?;
    let views = adjustment.errors_of_all(&solution, views);
    let sigmas = solution.sigmas.as_slice()[..kind.n_numbers()].to_vec();
    Ok(judge(camera, sigmas, views, config))
}

/// What is being solved.
struct Adjustment<'a> {
    board: &'a Board,
    kind: CameraKind,
    config: &'a CalibrationConfig,
    /// Standard deviation of a corner's coordinates, pixels.
    sigma_px: f64,
}

/// What came of it.
struct Solution {
    numbers: CameraVector,
    sigmas: CameraVector,
    /// The views it is of.
    used: Vec<usize>,
    /// Their poses.
    poses: Vec<Pose>,
    /// Observed minus projected, corner by corner, pixels, for each of them.
    residuals: Vec<Vec<Vector2<f64>>>,
    cost: f64,
}

impl Adjustment<'_> {
    /// A camera with this focal length and a lens of the middle of its kind.
    fn numbers_of(&self, focal: f64) -> CameraVector {
        let (width, height) = self.kind.size;
        let mut numbers = CameraVector::zeros();
        (numbers[0], numbers[1]) = (focal, focal);
        (numbers[2], numbers[3]) = (0.5 * (f64::from(width) - 1.0), 0.5 * (f64::from(height) - 1.0));
        match self.kind.model {
            CameraModel::Fov => numbers[4] = 0.5,
            CameraModel::ExtendedUnified => (numbers[4], numbers[5]) = (0.5, 1.0),
            CameraModel::DoubleSphere => (numbers[4], numbers[5]) = (0.0, 0.5),
            _ => {}
        }
        numbers
    }

    /// The best camera from which to begin: of several focal lengths those with the least errors, adjusted.
    fn begin(&mut self, views: &[View]) -> Option<CameraVector> {
        let longer = f64::from(self.kind.size.0.max(self.kind.size.1));
        let every = views.len().div_ceil(N_COMPARED);
        let compared: Vec<usize> = (0..views.len()).step_by(every).collect();
        let focals = (0..N_FOCALS).map(|i| longer * FIRST_FOCAL_SHARE * FOCAL_RATIO.powi(i as i32));
        let mut tried: Vec<Solution> =
            focals.filter_map(|focal| self.solve(&self.numbers_of(focal), views, &compared, false)).collect();
        tried.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        tried.truncate(N_BEST);
        let adjusted =
            tried.iter().filter_map(|solution| self.solve(&solution.numbers, views, &compared, true));
        adjusted.min_by(|a, b| a.cost.total_cmp(&b.cost)).map(|solution| solution.numbers)
    }

    /// Adjusts the poses of some views and, if it is free, the camera. `None` if too few have a pose.
    fn solve(
        &self,
        numbers: &CameraVector,
        views: &[View],
        used: &[usize],
        is_free: bool,
    ) -> Option<Solution> {
        let camera = self.kind.camera(numbers)?;
        let posed: Vec<(usize, Pose)> = used
            .iter()
            .filter_map(|idx| Some((*idx, board_pose(&camera, self.board, &views[*idx])?)))
            .collect();
        if posed.len() < MIN_VIEWS.min(used.len()) || 2 * posed.len() < used.len() {
            return None;
        }
        let mut problem = Problem::new();
        let variable = problem.add_variable(*numbers);
        problem.set_fixed(variable, !is_free);
        let prior = self.prior(numbers);
        problem.add_factors(Kernel::None, [((variable,), prior)]);
        let poses: Vec<VariableId<Pose>> =
            posed.iter().map(|(_, pose)| problem.add_variable(*pose)).collect();
        let mut factors = Vec::new();
        for ((idx, _), pose) in posed.iter().zip(&poses) {
            for (corner, observed) in self.board.corners().zip(&views[*idx].corners) {
                factors.push(((variable, *pose), self.factor(corner, *observed)));
            }
        }
        let corners = problem.add_factors(Kernel::huber_95(2), factors);
        let max_iterations = if is_free { self.config.max_iterations } else { 10 };
        problem.solve(&SolverOptions { max_iterations, ..SolverOptions::default() }, || false);
        Some(self.solution(problem, variable, &poses, corners, posed.iter().map(|(idx, _)| *idx).collect()))
    }

    fn factor(&self, corner: Vector3<f64>, observed_px: Vector2<f64>) -> CornerFactor {
        CornerFactor { kind: self.kind, corner, observed_px, inverse_sigma: 1.0 / self.sigma_px }
    }

    fn solution(
        &self,
        mut problem: Problem,
        variable: VariableId<CameraVector>,
        poses: &[VariableId<Pose>],
        corners: GroupId<CornerFactor>,
        used: Vec<usize>,
    ) -> Solution {
        let numbers = *problem.value(variable);
        let poses: Vec<Pose> = poses.iter().map(|pose| *problem.value(*pose)).collect();
        let n = self.board.n_corners();
        let residuals = problem.factors(corners).chunks(n).zip(&poses).map(|(factors, pose)| {
            let residual = |factor: &CornerFactor| {
                let whitened = factor.residual((&numbers, pose))?;
                Some(whitened * self.sigma_px)
            };
            // Where the model sees nothing, as far off as the image is wide.
            let nowhere = Vector2::new(f64::from(self.kind.size.0), 0.0);
            factors.iter().map(|factor| residual(factor).unwrap_or(nowhere)).collect()
        });
        let residuals: Vec<Vec<Vector2<f64>>> = residuals.collect();
        let cost = problem.cost_of(corners).robust / used.len().max(1) as f64;
        let sigmas =
            problem.marginal_covariance(variable).map_or(CameraVector::repeat(f64::INFINITY), |covariance| {
                CameraVector::from_fn(|axis, _| covariance[(axis, axis)].max(0.0).sqrt())
            });
        Solution { numbers, sigmas, used, poses, residuals, cost }
    }

    /// What is known of the numbers: the principal point is near the middle, coefficients are small.
    fn prior(&self, numbers: &CameraVector) -> NumbersPriorFactor {
        let (mut mean, mut sigmas) = (self.numbers_of(numbers[0]), CameraVector::repeat(f64::INFINITY));
        let center = self.config.center_sigma * f64::from(self.kind.size.0);
        (sigmas[2], sigmas[3]) = (center, center);
        for idx in 4..sigmas.len() {
            let is_tangential = self.kind.model == CameraModel::Radtan && (idx == 6 || idx == 7);
            sigmas[idx] = match idx {
                _ if idx >= self.kind.n_numbers() => HELD_SIGMA,
                _ if is_tangential => self.config.tangential_sigma,
                _ => self.config.radial_sigma,
            };
        }
        mean[0] = numbers[0];
        NumbersPriorFactor { mean, inverse_sigmas: sigmas.map(|sigma| 1.0 / sigma) }
    }

    /// The errors of every view with a pose, also of those that were left out.
    fn errors_of_all(&self, solution: &Solution, views: &[View]) -> Vec<ViewErrors> {
        let camera = self.kind.camera(&solution.numbers);
        let of_view = |idx: usize| {
            let pixels = views[idx].corners.clone();
            if let Some(at) = solution.used.iter().position(|used| *used == idx) {
                let residuals = solution.residuals[at].clone();
                return Some(ViewErrors { idx, is_used: true, pose: solution.poses[at], pixels, residuals });
            }
            let alone = self.solve(&solution.numbers, views, &[idx], false);
            let rough = board_pose(camera.as_ref()?, self.board, &views[idx]);
            let (pose, residuals) = match alone {
                Some(alone) => (alone.poses[0], alone.residuals[0].clone()),
                None => (rough?, Vec::new()),
            };
            Some(ViewErrors { idx, is_used: false, pose, pixels, residuals })
        };
        (0..views.len()).filter_map(of_view).collect()
    }
}
