//! Robust kernels: how much a residual of a given size may pull.

/// A robust kernel `ρ(s)` of the squared norm `s` of a whitened residual; the cost is `½ Σ ρ(s)`.
///
/// Thresholds are in standard deviations of the residual's norm, so for a residual of `n` degrees of
/// freedom the square root of the 95 % point of χ²(n) is customary: see [`Kernel::huber_95`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kernel {
    /// Plain least squares, `ρ(s) = s`.
    None,
    /// Quadratic up to `delta`, linear beyond: `ρ(s) = 2δ√s − δ²`.
    Huber {
        /// Where the kernel turns linear.
        delta: f64,
    },
    /// `ρ(s) = c² ln(1 + s/c²)`: gross outliers hardly pull.
    Cauchy {
        /// The scale; 2.385 keeps 95 % efficiency on Gaussian noise.
        scale: f64,
    },
    /// Tukey's biweight, `ρ(s) = c²/3 (1 − (1 − s/c²)³)`: beyond `scale` an observation has no pull at all.
    Tukey {
        /// Where the influence ends; 4.685 keeps 95 % efficiency on Gaussian noise.
        scale: f64,
    },
}

impl Kernel {
    /// Huber's kernel at the 95 % point of χ² with `dof` degrees of freedom (1 to 4).
    ///
    /// More degrees of freedom fall back on the Wilson-Hilferty approximation of the same point.
    #[must_use]
    pub fn huber_95(dof: usize) -> Self {
        Kernel::Huber { delta: chi2_95(dof).sqrt() }
    }

    /// Cauchy's kernel at 95 % efficiency on Gaussian noise.
    #[must_use]
    pub fn cauchy_95() -> Self {
        Kernel::Cauchy { scale: 2.385 }
    }

    /// `ρ(s)` for a squared norm `s`.
    #[inline]
    #[must_use]
    pub fn loss(self, s: f64) -> f64 {
        match self {
            Kernel::None => s,
            Kernel::Huber { delta } => {
                if s <= delta * delta {
                    s
                } else {
                    2.0 * delta * s.sqrt() - delta * delta
                }
            }
            Kernel::Cauchy { scale } => scale * scale * (s / (scale * scale)).ln_1p(),
            Kernel::Tukey { scale } => {
                let outside = (1.0 - s / (scale * scale)).max(0.0);
                scale * scale / 3.0 * (1.0 - outside * outside * outside)
            }
        }
    }

    /// `ρ'(s)`, the weight of the residual in the normal equations; between 0 and 1.
    #[inline]
    #[must_use]
    pub fn weight(self, s: f64) -> f64 {
        match self {
            Kernel::None => 1.0,
            Kernel::Huber { delta } => {
                if s <= delta * delta {
                    1.0
                } else {
                    delta / s.sqrt()
                }
            }
            Kernel::Cauchy { scale } => 1.0 / (1.0 + s / (scale * scale)),
            Kernel::Tukey { scale } => {
                let outside = (1.0 - s / (scale * scale)).max(0.0);
                outside * outside
            }
        }
    }
}

/// The 95 % point of χ² with `dof` degrees of freedom, the customary gate for outliers.
///
/// Tabulated to four digits up to 4, beyond that by Wilson and Hilferty's approximation (within 0.2 %).
#[must_use]
pub fn chi2_95(dof: usize) -> f64 {
    const TABLE: [f64; 5] = [0.0, 3.841, 5.991, 7.815, 9.488];
    /// 95 % point of the standard normal distribution.
    const NORMAL_95: f64 = 1.644_854;
    TABLE.get(dof).copied().unwrap_or_else(|| {
        let k = dof as f64;
        let spread = 2.0 / (9.0 * k);
        k * (1.0 - spread + NORMAL_95 * spread.sqrt()).powi(3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Kernel; 4] = [
        Kernel::None,
        Kernel::Huber { delta: 1.5 },
        Kernel::Cauchy { scale: 2.0 },
        Kernel::Tukey { scale: 4.0 },
    ];

    #[test]
    fn weight_is_the_derivative_of_the_loss() {
        let step = 1e-6;
        for kernel in ALL {
            for s in [0.1, 1.0, 2.2, 2.3, 9.0, 30.0, 1e4] {
                let numeric = (kernel.loss(s + step) - kernel.loss(s - step)) / (2.0 * step);
                assert!((numeric - kernel.weight(s)).abs() < 1e-4, "{kernel:?} at {s}: {numeric}");
            }
        }
    }

    #[test]
    fn small_residuals_are_left_alone() {
        for kernel in ALL {
            assert!((kernel.loss(1e-8) - 1e-8).abs() < 1e-15, "{kernel:?}");
            assert!((kernel.weight(0.0) - 1.0).abs() < 1e-15, "{kernel:?}");
        }
    }

    #[test]
    fn chi2_points_match_published_tables() {
        for (dof, expected) in [(1, 3.841), (2, 5.991), (6, 12.592), (7, 14.067)] {
            let got = chi2_95(dof);
            assert!((got / expected - 1.0).abs() < 2e-3, "dof {dof}: {got} instead of {expected}");
        }
    }
}
