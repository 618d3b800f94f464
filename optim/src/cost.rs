//! The cost: what is minimized, and what went into it.

/// The squared norm at which a factor that cannot be evaluated is counted.
///
/// A hundred standard deviations: so much that no step gains by pushing an observation out of its domain
/// (a point behind its camera), so little that one such observation does not drown the others.
pub const INVALID_CHI2: f64 = 1e4;

/// The cost of a set of factors and what went into it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// `½ Σ ρ(‖r‖²)` over the enabled factors, those that cannot be evaluated counted at [`INVALID_CHI2`].
    pub robust: f64,
    /// `Σ ‖r‖²` over the enabled factors that can be evaluated, without kernel.
    pub chi2: f64,
    /// Number of residuals (not of factors) in `chi2`.
    pub n_residuals: usize,
    /// Number of enabled factors that could not be evaluated.
    pub n_invalid: usize,
}

impl Cost {
    pub(crate) fn add(&mut self, other: Cost) {
        self.robust += other.robust;
        self.chi2 += other.chi2;
        self.n_residuals += other.n_residuals;
        self.n_invalid += other.n_invalid;
    }
}
