//! Alignment in one resolution, by inverse composition: derivatives are taken in the first image, once.

use super::pyramid::{GRADIENT_REACH_PX, gradient, gray_level};
use crate::config::AlignmentConfig;
use geometry::nalgebra::{SMatrix, SVector, Vector2, Vector3};
use geometry::{Camera, Pose};
use vision::GrayImage;

/// Pixels of a patch, from its middle.
const OFFSETS: [f64; 4] = [-1.5, -0.5, 0.5, 1.5];
const N_PIXELS: usize = OFFSETS.len() * OFFSETS.len();
/// The motion, then contrast and brightness.
const N_UNKNOWNS: usize = 8;
/// Steps smaller than this end the iterations: radians, and shares of the scene's depth.
const MIN_STEP: f64 = 1e-5;
/// Share of the patches that must be visible for a motion to be compared with others.
const MIN_VISIBLE_SHARE: f64 = 0.4;
/// Standard deviation of the contrast between two images about 1: keeps it where it belongs when patches are
/// nearly plain.
const CONTRAST_SIGMA: f64 = 0.2;
/// Contrasts between two images of one camera, a moment apart, that are believed.
const CONTRASTS: std::ops::Range<f64> = 0.4..2.5;
/// Least variance of the gray levels compared: below there is nothing but noise.
const MIN_VARIANCE: f64 = 1.0;

type Unknowns = SVector<f64, N_UNKNOWNS>;
type Information = SMatrix<f64, N_UNKNOWNS, N_UNKNOWNS>;

/// How the second image comes from the first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub second_from_first: Pose,
    /// Gray levels of the second image per gray level of the first.
    pub contrast: f64,
    /// What is added, gray levels.
    pub brightness: f64,
}

impl Motion {
    pub fn new(second_from_first: Pose) -> Self {
        Self { second_from_first, contrast: 1.0, brightness: 0.0 }
    }
}

/// A patch of the first image with its derivatives.
struct Prepared {
    position: Vector3<f64>,
    gray_levels: [f64; N_PIXELS],
    /// By a twist of the first camera's frame.
    derivatives: [SVector<f64, 6>; N_PIXELS],
}

/// The patches of one resolution of the first image.
pub(super) struct LevelPatches(Vec<Prepared>);

impl LevelPatches {
    /// Of the patches that are not too near to the edge at most so many, spread evenly over the order they
    /// come in.
    pub fn prepare(
        (image, camera): (&GrayImage, &Camera),
        positions: &[Vector3<f64>],
        max_patches: usize,
    ) -> Self {
        let inside: Vec<_> = positions.iter().filter(|position| is_inside(image, camera, position)).collect();
        let thinned = inside.iter().step_by(inside.len().div_ceil(max_patches.max(1)).max(1));
        Self(thinned.filter_map(|position| prepare(image, camera, position)).collect())
    }

    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Mean robust cost of a pixel, if enough patches are visible.
    pub fn cost(
        &self,
        onto: (&GrayImage, &Camera),
        motion: &Motion,
        config: &AlignmentConfig,
    ) -> Option<f64> {
        let (mut sum, mut n_visible) = (0.0, 0);
        for residuals in self.0.iter().filter_map(|patch| patch.residuals(onto, motion)) {
            sum +=
                residuals.iter().map(|residual| huber_cost(*residual, config.huber_gray_levels)).sum::<f64>();
            n_visible += 1;
        }
        self.is_comparable(n_visible).then(|| sum / (n_visible * N_PIXELS) as f64)
    }

    fn is_comparable(&self, n_visible: usize) -> bool {
        n_visible > 0 && n_visible as f64 >= MIN_VISIBLE_SHARE * self.len() as f64
    }

    /// How alike the patches are under a motion, -1 to 1 whatever the contrast and the brightness, and the
    /// motion with those that fit best. `None` if too few are visible.
    pub fn correlate(&self, onto: (&GrayImage, &Camera), motion: &Motion) -> Option<(f64, Motion)> {
        let (mut sums, mut squares, mut product, mut n_visible) = ([0.0; 2], [0.0; 2], 0.0, 0);
        let unchanged = Motion::new(motion.second_from_first);
        for patch in &self.0 {
            let Some(residuals) = patch.residuals(onto, &unchanged) else { continue };
            n_visible += 1;
            for (first, second) in
                patch.gray_levels.iter().zip(&residuals).map(|(first, residual)| (first, first + residual))
            {
                sums = [sums[0] + first, sums[1] + second];
                squares = [squares[0] + first * first, squares[1] + second * second];
                product += first * second;
            }
        }
        if !self.is_comparable(n_visible) {
            return None;
        }
        let n = (n_visible * N_PIXELS) as f64;
        let means = sums.map(|sum| sum / n);
        let variance = |i: usize| (squares[i] / n - means[i] * means[i]).max(MIN_VARIANCE);
        let covariance = product / n - means[0] * means[1];
        let contrast = (covariance / variance(0)).clamp(CONTRASTS.start, CONTRASTS.end);
        let brightness = means[1] - contrast * means[0];
        let fitted = Motion { contrast, brightness, ..unchanged };
        Some((covariance / (variance(0) * variance(1)).sqrt(), fitted))
    }

    /// The motion that makes the images most alike, near the one given.
    pub fn align(&self, onto: (&GrayImage, &Camera), start: Motion, config: &AlignmentConfig) -> Motion {
        let Some(mut cost) = self.cost(onto, &start, config) else { return start };
        let mut best = start;
        for _ in 0..config.max_iterations {
            let Some((next, step)) = self.step(onto, &best, config) else { break };
            let Some(next_cost) = self.cost(onto, &next, config).filter(|next| *next < cost) else { break };
            (best, cost) = (next, next_cost);
            if step < MIN_STEP {
                break;
            }
        }
        best
    }

    /// One Gauss-Newton step, and its length.
    fn step(
        &self,
        onto: (&GrayImage, &Camera),
        motion: &Motion,
        config: &AlignmentConfig,
    ) -> Option<(Motion, f64)> {
        let (mut information, mut gradient) = (Information::zeros(), Unknowns::zeros());
        let mut depth = 0.0;
        for patch in &self.0 {
            let Some(residuals) = patch.residuals(onto, motion) else { continue };
            depth += patch.position.z;
            for ((residual, derivative), gray) in
                residuals.iter().zip(&patch.derivatives).zip(&patch.gray_levels)
            {
                let weight = (config.huber_gray_levels / residual.abs().max(1e-9)).min(1.0);
                let mut row = Unknowns::zeros();
                row.fixed_rows_mut::<6>(0).copy_from(&(derivative * -motion.contrast));
                (row[6], row[7]) = (-gray, -1.0);
                information += row * row.transpose() * weight;
                gradient += row * (weight * residual);
            }
        }
        let prior = (config.huber_gray_levels / CONTRAST_SIGMA).powi(2);
        information[(6, 6)] += prior;
        gradient[6] += prior * (motion.contrast - 1.0);
        let step = -information.cholesky()?.solve(&gradient);
        let twist = step.fixed_rows::<6>(0).into_owned();
        if !step.iter().all(|value| value.is_finite()) || !CONTRASTS.contains(&(motion.contrast + step[6])) {
            return None;
        }
        let next = Motion {
            second_from_first: motion.second_from_first * Pose::exp(&twist).inverse(),
            contrast: motion.contrast + step[6],
            brightness: motion.brightness + step[7],
        };
        let depth = depth / self.len() as f64;
        let length = twist.fixed_rows::<3>(0).norm() + twist.fixed_rows::<3>(3).norm() / depth.max(1e-9);
        Some((next, length))
    }

    /// Share of the patches that look the same in the second image. `None` if too few are visible.
    pub fn found_share(
        &self,
        onto: (&GrayImage, &Camera),
        motion: &Motion,
        config: &AlignmentConfig,
    ) -> Option<f64> {
        let visible: Vec<_> = self.0.iter().filter_map(|patch| patch.residuals(onto, motion)).collect();
        let is_found = |residuals: &&[f64; N_PIXELS]| {
            let mean = residuals.iter().map(|residual| residual.abs()).sum::<f64>() / N_PIXELS as f64;
            mean <= config.max_patch_difference
        };
        let n_found = visible.iter().filter(is_found).count();
        (visible.len() >= config.min_patches).then(|| n_found as f64 / visible.len() as f64)
    }
}

impl Prepared {
    /// Gray levels of the second image less those expected. `None` if the patch is not in the image.
    fn residuals(&self, (image, camera): (&GrayImage, &Camera), motion: &Motion) -> Option<[f64; N_PIXELS]> {
        let middle = camera.project(&motion.second_from_first.transform(&self.position))?;
        let mut residuals = [0.0; N_PIXELS];
        for ((residual, offset), gray) in residuals.iter_mut().zip(offsets()).zip(&self.gray_levels) {
            let seen = gray_level(image, &(middle + offset))?;
            *residual = seen - (motion.contrast * gray + motion.brightness);
        }
        Some(residuals)
    }
}

/// Whether gray levels and gradients of all pixels of the patch can be had.
fn is_inside(image: &GrayImage, camera: &Camera, position: &Vector3<f64>) -> bool {
    let reach = Vector2::repeat(OFFSETS[OFFSETS.len() - 1] + GRADIENT_REACH_PX);
    camera.project(position).is_some_and(|middle| {
        [middle - reach, middle + reach].iter().all(|corner| gray_level(image, corner).is_some())
    })
}

fn prepare(image: &GrayImage, camera: &Camera, position: &Vector3<f64>) -> Option<Prepared> {
    let (middle, pixel_by_point) = camera.project_with_jacobian(position)?;
    // A point moved by the twist (turn, shift): shift + turn x position.
    let mut point_by_twist = SMatrix::<f64, 3, 6>::zeros();
    point_by_twist.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-position.cross_matrix()));
    point_by_twist.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
    let pixel_by_twist = pixel_by_point * point_by_twist;
    let (mut gray_levels, mut derivatives) = ([0.0; N_PIXELS], [SVector::zeros(); N_PIXELS]);
    for ((gray, derivative), offset) in gray_levels.iter_mut().zip(&mut derivatives).zip(offsets()) {
        *gray = gray_level(image, &(middle + offset))?;
        *derivative = pixel_by_twist.transpose() * gradient(image, &(middle + offset))?;
    }
    Some(Prepared { position: *position, gray_levels, derivatives })
}

fn offsets() -> impl Iterator<Item = Vector2<f64>> {
    OFFSETS.iter().flat_map(|y| OFFSETS.iter().map(|x| Vector2::new(*x, *y)))
}

fn huber_cost(residual: f64, delta: f64) -> f64 {
    let size = residual.abs();
    if size <= delta { 0.5 * size * size } else { delta * (size - 0.5 * delta) }
}
