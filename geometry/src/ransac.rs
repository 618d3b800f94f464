//! Models from data of which a part is plain wrong [Fischler & Bolles 1981], scored by MSAC [Torr & Zisserman
//! 2000] with local refinement of each new best model [Chum et al. 2003].
//!
//! The random generator comes from the caller: the same data, configuration and seed give the same result.

use rand::Rng;

/// What RANSAC needs to know about a model.
pub trait Estimator {
    /// What is estimated.
    type Model: Clone;

    /// How many data a minimal sample has.
    fn sample_size(&self) -> usize;

    /// How many data there are.
    fn n_data(&self) -> usize;

    /// Appends every model that fits the data with the indices `sample` to `models`.
    fn fit_sample(&self, sample: &[usize], models: &mut Vec<Self::Model>);

    /// How badly `model` explains one datum, in units the threshold is in. Numbers that are not finite count
    /// as infinitely bad.
    fn squared_residual(&self, model: &Self::Model, datum: usize) -> f64;

    /// A better model from all data it explains, or `None` to keep it as it is.
    fn refine(&self, _model: &Self::Model, _inliers: &[usize]) -> Option<Self::Model> {
        None
    }
}

/// How long to search and what counts as explained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacConfig {
    /// A datum is an inlier if its squared residual is below this. Default 5.991, the 95 % bound of a
    /// residual of two dimensions in units of its standard deviation.
    pub max_squared_residual: f64,
    /// Samples drawn at least, so that an early lucky one is not the only one. Default 10.
    pub min_iterations: usize,
    /// Samples drawn at most. Default 300.
    pub max_iterations: usize,
    /// The search stops when, given the inlier share so far, a sample free of outliers was drawn with this
    /// probability. Default 0.99.
    pub confidence: f64,
}

impl Default for RansacConfig {
    fn default() -> Self {
        Self { max_squared_residual: 5.991, min_iterations: 10, max_iterations: 300, confidence: 0.99 }
    }
}

/// The best model found.
#[derive(Clone, Debug, PartialEq)]
pub struct RansacReport<M> {
    /// The model, refined if the estimator can.
    pub model: M,
    /// For each datum whether the model explains it.
    pub inliers: Vec<bool>,
    /// How many it explains.
    pub n_inliers: usize,
    /// Samples drawn.
    pub iterations: usize,
    /// `Σ (1 - r²/threshold)` over the inliers: as their number, each weighted by how well it fits.
    pub score: f64,
}

/// Searches for the model that explains most data best.
///
/// `None` if there are fewer data than a sample needs, or no sample gave a model that explains at least as
/// many data as a sample has.
pub fn ransac<E: Estimator>(
    estimator: &E,
    config: &RansacConfig,
    rng: &mut impl Rng,
) -> Option<RansacReport<E::Model>> {
    let (n_data, sample_size) = (estimator.n_data(), estimator.sample_size());
    if n_data < sample_size || sample_size == 0 {
        return None;
    }
    let search = Search { estimator, max_squared_residual: config.max_squared_residual };
    let mut best: Option<(E::Model, f64)> = None;
    let mut sample = Vec::with_capacity(sample_size);
    let mut models = Vec::new();
    let mut iterations = 0;
    let mut needed = config.max_iterations;
    while iterations < needed.max(config.min_iterations).min(config.max_iterations) {
        iterations += 1;
        draw_distinct(n_data, sample_size, &mut sample, rng);
        models.clear();
        estimator.fit_sample(&sample, &mut models);
        for model in models.drain(..) {
            let best_cost = best.as_ref().map_or(f64::INFINITY, |(_, cost)| *cost);
            let Some(cost) = search.cost_below(&model, best_cost) else { continue };
            let (model, cost) = search.refined(model, cost);
            let inlier_share = search.inliers(&model, 1.0).len() as f64 / n_data as f64;
            needed = iterations_needed(inlier_share, sample_size, config);
            best = Some((model, cost));
        }
    }
    let (model, cost) = best?;
    search.report(model, cost, iterations)
}

struct Search<'a, E> {
    estimator: &'a E,
    max_squared_residual: f64,
}

impl<E: Estimator> Search<'_, E> {
    /// One for an outlier, less for an inlier.
    #[inline]
    fn cost_of(&self, model: &E::Model, datum: usize) -> f64 {
        let relative = self.estimator.squared_residual(model, datum) / self.max_squared_residual;
        if relative < 1.0 { relative } else { 1.0 }
    }

    /// The cost over all data, given up as soon as it reaches `bound`.
    fn cost_below(&self, model: &E::Model, bound: f64) -> Option<f64> {
        let mut cost = 0.0;
        for datum in 0..self.estimator.n_data() {
            cost += self.cost_of(model, datum);
            if cost >= bound {
                return None;
            }
        }
        Some(cost)
    }

    /// The data whose squared residual is below `widening` times the threshold.
    fn inliers(&self, model: &E::Model, widening: f64) -> Vec<usize> {
        let bound = widening * self.max_squared_residual;
        (0..self.estimator.n_data())
            .filter(|datum| self.estimator.squared_residual(model, *datum) < bound)
            .collect()
    }

    /// Refines while that lowers the cost, at most a few times: the set of inliers changes with the model. A
    /// model from a noisy minimal sample misses many true inliers, so wider sets are tried first.
    fn refined(&self, mut model: E::Model, mut cost: f64) -> (E::Model, f64) {
        const MAX_ROUNDS: usize = 3;
        const WIDENINGS: [f64; 3] = [9.0, 4.0, 1.0];
        for _ in 0..MAX_ROUNDS {
            let cost_before = cost;
            for widening in WIDENINGS {
                let candidate = self.estimator.refine(&model, &self.inliers(&model, widening));
                if let Some((candidate, lower)) =
                    candidate.and_then(|c| self.cost_below(&c, cost).map(|lower| (c, lower)))
                {
                    (model, cost) = (candidate, lower);
                }
            }
            if cost == cost_before {
                break;
            }
        }
        (model, cost)
    }

    fn report(&self, model: E::Model, cost: f64, iterations: usize) -> Option<RansacReport<E::Model>> {
        let n_data = self.estimator.n_data();
        let inliers: Vec<bool> = (0..n_data).map(|datum| self.cost_of(&model, datum) < 1.0).collect();
        let n_inliers = inliers.iter().filter(|inlier| **inlier).count();
        if n_inliers < self.estimator.sample_size() {
            return None;
        }
        Some(RansacReport { model, inliers, n_inliers, iterations, score: n_data as f64 - cost })
    }
}

/// Samples after which one was free of outliers with the wanted probability.
fn iterations_needed(inlier_share: f64, sample_size: usize, config: &RansacConfig) -> usize {
    let all_inliers = inlier_share.powi(sample_size as i32);
    if all_inliers >= 1.0 {
        return 1;
    }
    let needed = (1.0 - config.confidence).ln() / (1.0 - all_inliers).ln();
    // A share of zero gives an infinity of one sign or the other.
    if needed.is_finite() && needed >= 0.0 { needed.ceil() as usize } else { config.max_iterations }
}

/// Fills `sample` with `size` different indices below `n`, each set equally likely.
fn draw_distinct(n: usize, size: usize, sample: &mut Vec<usize>, rng: &mut impl Rng) {
    sample.clear();
    // Floyd's method: never rejects, so it takes the same number of draws each time.
    for upper in (n - size)..n {
        let candidate = rng.random_range(0..=upper);
        let choice = if sample.contains(&candidate) { upper } else { candidate };
        sample.push(choice);
    }
}
