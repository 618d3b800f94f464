//! How many features each pyramid level gives.

use super::OrbConfig;

/// Features to take from each level, of those `available`: in proportion to the level's side, and what one
/// level cannot give is asked of the others. Sums to `n_features`, or to all there are.
pub(super) fn per_level(config: &OrbConfig, available: impl Iterator<Item = usize>) -> Vec<usize> {
    let available: Vec<usize> = available.collect();
    let share = |level: usize| f64::from(config.scale_factor).powi(-(level as i32));
    let mut quotas = vec![0; available.len()];
    let mut open: Vec<usize> = (0..available.len()).collect();
    let mut left = config.n_features;
    // Levels that cannot fill their part give all they have; the rest is shared anew among the others.
    loop {
        let total: f64 = open.iter().map(|&level| share(level)).sum();
        let part = |level: usize| left as f64 * share(level) / total;
        let (short, rest): (Vec<usize>, Vec<usize>) =
            open.iter().partition(|&&level| available[level] as f64 <= part(level));
        if short.is_empty() {
            divide(left, &rest, part, &mut quotas);
            return quotas;
        }
        for level in short {
            quotas[level] = available[level];
            left -= available[level];
        }
        open = rest;
    }
}

/// Rounds parts so that they sum to `left`.
fn divide(left: usize, levels: &[usize], part: impl Fn(usize) -> f64, quotas: &mut [usize]) {
    let (mut wanted, mut given) = (0.0, 0);
    for (i, &level) in levels.iter().enumerate() {
        wanted += part(level);
        let upto = if i + 1 == levels.len() { left } else { (wanted.round() as usize).min(left) };
        quotas[level] = upto - given;
        given = upto;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quotas(n_features: usize, available: &[usize]) -> Vec<usize> {
        let config = OrbConfig { n_features, n_levels: available.len(), ..OrbConfig::default() };
        per_level(&config, available.iter().copied())
    }

    #[test]
    fn plenty_is_shared_in_proportion_to_the_side() {
        let shares = quotas(1000, &[9999; 8]);
        assert_eq!(shares.iter().sum::<usize>(), 1000);
        assert!(shares.windows(2).all(|w| (w[0] as f64 / w[1] as f64 - 1.2).abs() < 0.05), "{shares:?}");
    }

    #[test]
    fn what_one_level_lacks_others_give() {
        assert_eq!(quotas(1000, &[0, 10, 2000, 2000]).iter().sum::<usize>(), 1000);
        assert_eq!(quotas(1000, &[0, 10, 2000, 2000])[..2], [0, 10]);
        assert_eq!(quotas(1000, &[5, 10, 20]), [5, 10, 20]);
        assert_eq!(quotas(0, &[5, 10]), [0, 0]);
        assert_eq!(quotas(7, &[0, 0, 0]), [0, 0, 0]);
    }
}
