//! Real roots of small polynomials. Coefficients are in ascending order of power.

/// Largest degree [`real_roots`] handles.
pub(crate) const MAX_DEGREE: usize = 10;

/// Value and derivative.
#[inline]
fn evaluate(coefficients: &[f64], x: f64) -> (f64, f64) {
    let (mut value, mut slope) = (0.0, 0.0);
    for c in coefficients.iter().rev() {
        slope = slope * x + value;
        value = value * x + c;
    }
    (value, slope)
}

/// Roots up to this size are sought directly. A little more than one, so that no root of a well-made problem,
/// where ±1 is not rare, falls on the seam.
const SEAM: f64 = 1.0625;

/// The simple real roots, not ordered. Roots are sought in `[-SEAM, SEAM]`, and those outside as the inverses
/// of the roots of the reversed polynomial, so that nothing overflows and no bound on their size is needed.
///
/// Double roots may be missed: between two roots of the derivative the sign does not change there.
pub(crate) fn real_roots(coefficients: &[f64]) -> Vec<f64> {
    debug_assert!(coefficients.len() <= MAX_DEGREE + 1);
    if !coefficients.iter().all(|c| c.is_finite()) {
        return Vec::new();
    }
    let mut roots = Vec::with_capacity(coefficients.len());
    roots_within_seam(coefficients, &mut roots);
    let mut reversed = [0.0; MAX_DEGREE + 1];
    let reversed = &mut reversed[..coefficients.len()];
    for (to, from) in reversed.iter_mut().zip(coefficients.iter().rev()) {
        *to = *from;
    }
    let mut inverses = Vec::with_capacity(coefficients.len());
    roots_within_seam(reversed, &mut inverses);
    // Zero would be a root at infinity; those beyond 1 / SEAM were found already.
    roots.extend(inverses.iter().filter(|x| **x != 0.0 && x.abs() < 1.0 / SEAM).map(|x| 1.0 / x));
    roots
}

/// Roots in `[-SEAM, SEAM)`, ascending. Between neighboring roots of the derivative a polynomial is
/// monotone, so it has at most one root there; and so down to the derivative that is a line.
fn roots_within_seam(coefficients: &[f64], roots: &mut Vec<f64>) {
    let degree = coefficients.len().saturating_sub(1);
    let mut derivatives = [[0.0; MAX_DEGREE + 1]; MAX_DEGREE + 1];
    derivatives[0][..=degree].copy_from_slice(coefficients);
    for order in 1..=degree {
        for power in 0..=(degree - order) {
            derivatives[order][power] = derivatives[order - 1][power + 1] * (power + 1) as f64;
        }
    }
    let mut breaks = [0.0; MAX_DEGREE + 2];
    let mut n_roots = 0;
    let mut found = [0.0; MAX_DEGREE + 1];
    for order in (0..degree).rev() {
        let polynomial = &derivatives[order][..=(degree - order)];
        breaks[0] = -SEAM;
        breaks[1..=n_roots].copy_from_slice(&found[..n_roots]);
        breaks[n_roots + 1] = SEAM;
        let n_intervals = n_roots + 1;
        n_roots = 0;
        for i in 0..n_intervals {
            if let Some(root) = root_between(polynomial, breaks[i], breaks[i + 1]) {
                found[n_roots] = root;
                n_roots += 1;
            }
        }
    }
    roots.extend_from_slice(&found[..n_roots]);
}

/// The root in `[low, high)` of a function monotone there, by Newton's method kept inside the bracket by
/// bisection.
fn root_between(polynomial: &[f64], mut low: f64, mut high: f64) -> Option<f64> {
    let (value_low, _) = evaluate(polynomial, low);
    let (value_high, _) = evaluate(polynomial, high);
    if value_low == 0.0 && low < high {
        return Some(low);
    }
    if value_high == 0.0 || value_low.signum() == value_high.signum() || low >= high {
        return None;
    }
    let rises = value_high > 0.0;
    let mut x = 0.5 * (low + high);
    for _ in 0..80 {
        let (value, slope) = evaluate(polynomial, x);
        if value == 0.0 {
            return Some(x);
        }
        if (value > 0.0) == rises {
            high = x
        } else {
            low = x
        }
        let newton = x - value / slope;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        let step = (next - x).abs();
        x = next;
        if step <= 1e-16 + 4.0 * f64::EPSILON * x.abs() {
            break;
        }
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expand(roots: &[f64]) -> Vec<f64> {
        roots.iter().fold(vec![1.0], |p, root| {
            let mut product = vec![0.0; p.len() + 1];
            for (i, c) in p.iter().enumerate() {
                product[i + 1] += c;
                product[i] -= root * c;
            }
            product
        })
    }

    #[test]
    fn all_simple_roots_are_found() {
        for truth in [
            vec![-0.5, 0.25, 0.75],
            vec![-20.0, -0.9, 0.001, 3.0, 400.0],
            vec![-3.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0, 5.0, 9.0],
            vec![0.0, 2.0],
        ] {
            let mut roots = real_roots(&expand(&truth));
            roots.sort_by(f64::total_cmp);
            assert_eq!(roots.len(), truth.len(), "{roots:?} should be {truth:?}");
            for (root, expected) in roots.iter().zip(&truth) {
                assert!((root - expected).abs() < 1e-8 * (1.0 + expected.abs()), "{root} is not {expected}");
            }
        }
    }

    #[test]
    fn complex_roots_are_not_reported() {
        assert!(real_roots(&[1.0, 0.0, 1.0]).is_empty());
        assert_eq!(real_roots(&[-1.0, 1.0, -1.0, 1.0]).len(), 1);
        assert!(real_roots(&[f64::NAN, 1.0]).is_empty());
    }
}
