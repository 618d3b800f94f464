//! Whether as many segments would meet by chance: the a-contrario argument [Desolneux, Moisan & Morel, "From
//! Gestalt Theory to Image Analysis", 2008].

/// The probability that at least `k` of independent events happen, of which each has its own `probability`.
/// Exact, in `O(n k)`; `tail` is a buffer.
pub(super) fn probability_of_at_least(
    k: usize,
    probabilities: impl Iterator<Item = f64>,
    tail: &mut Vec<f64>,
) -> f64 {
    if k == 0 {
        return 1.0;
    }
    // tail[j]: exactly j so far, for j < k; what reaches k stays there.
    tail.clear();
    tail.resize(k, 0.0);
    tail[0] = 1.0;
    let mut reached = 0.0;
    for p in probabilities {
        reached += tail[k - 1] * p;
        for j in (1..k).rev() {
            tail[j] = tail[j] * (1.0 - p) + tail[j - 1] * p;
        }
        tail[0] *= 1.0 - p;
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_binomial_distribution() {
        let mut buffer = Vec::new();
        let at_least = |k, buffer: &mut Vec<f64>| probability_of_at_least(k, [0.25; 4].into_iter(), buffer);
        // (1/4)^4, and 1 - (3/4)^4.
        assert!((at_least(4, &mut buffer) - 1.0 / 256.0).abs() < 1e-15);
        assert!((at_least(1, &mut buffer) - 175.0 / 256.0).abs() < 1e-15);
        assert_eq!(at_least(0, &mut buffer), 1.0);
        assert_eq!(at_least(5, &mut buffer), 0.0);
    }

    #[test]
    fn events_may_differ() {
        // 0.5 * 0.1 for both of two.
        let both = probability_of_at_least(2, [0.5, 0.1].into_iter(), &mut Vec::new());
        assert!((both - 0.05).abs() < 1e-15);
    }
}
