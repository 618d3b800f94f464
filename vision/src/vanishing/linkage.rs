//! J-Linkage: clusters of segments that agree about which directions they accept [Toldo & Fusiello, "Robust
//! multiple structures estimation with J-linkage", ECCV 2008; for vanishing points Tardif, ICCV 2009].

use nalgebra::Vector3;

use super::plane::SegmentPlane;

/// Hypotheses in one word of a preference set.
const WORD_BITS: usize = 64;

/// Segments linked together, and a direction all of them accept.
#[derive(Clone, Debug)]
pub(super) struct Cluster {
    /// The accepted direction of lowest index.
    pub direction: Vector3<f64>,
    /// Positions in the segments linked, ascending.
    pub members: Vec<u32>,
}

/// Buffers of the linkage, kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Linkage {
    /// Words per preference set.
    n_words: usize,
    /// Bit `h` of set `i`: whether cluster `i` (at first segment `i`) accepts hypothesis `h`.
    bits: Vec<u64>,
    /// Bits set in each set.
    counts: Vec<u32>,
    /// Bits common to each two sets, `n * n`, both triangles.
    common: Vec<u32>,
    /// For each cluster, the nearest of those after it that are alive.
    nearest: Vec<Option<Neighbor>>,
    /// Clusters not yet merged into another, ascending.
    alive: Vec<u32>,
    /// The cluster each segment is in.
    label: Vec<u32>,
}

/// Another cluster and how near it is.
#[derive(Clone, Copy, Debug)]
struct Neighbor {
    idx: u32,
    n_common: u32,
    n_union: u32,
}

impl Neighbor {
    /// Whether the Jaccard distance `1 - common / union` is smaller than the other's. Exact.
    #[inline]
    fn is_nearer_than(&self, other: &Self) -> bool {
        u64::from(self.n_common) * u64::from(other.n_union)
            > u64::from(other.n_common) * u64::from(self.n_union)
    }
}

impl Linkage {
    /// Merges the nearest two clusters, ties by lower index, until no two share a hypothesis; returns those
    /// of at least `min_size` segments. `gate2`: see [`SegmentPlane::excess`].
    pub fn link(
        &mut self,
        planes: &[SegmentPlane],
        hypotheses: &[Vector3<f64>],
        gate2: f64,
        min_size: usize,
    ) -> Vec<Cluster> {
        self.fill_preferences(planes, hypotheses, gate2);
        self.fill_common(planes.len());
        self.alive.clear();
        self.alive.extend(0..planes.len() as u32);
        self.label.clear();
        self.label.extend(0..planes.len() as u32);
        self.nearest.clear();
        for position in 0..self.alive.len() {
            let neighbor = self.nearest_after(position);
            self.nearest.push(neighbor);
        }
        while let Some((into, from)) = self.closest_pair() {
            self.merge(into, from);
        }
        self.clusters(hypotheses, min_size)
    }

    fn fill_preferences(&mut self, planes: &[SegmentPlane], hypotheses: &[Vector3<f64>], gate2: f64) {
        self.n_words = hypotheses.len().div_ceil(WORD_BITS);
        self.bits.clear();
        self.counts.clear();
        let mut excess = [0.0; WORD_BITS];
        for plane in planes {
            let mut count = 0;
            for chunk in hypotheses.chunks(WORD_BITS) {
                // In two steps, the first of which is arithmetic alone and done several at a time.
                for (excess, direction) in excess.iter_mut().zip(chunk) {
                    *excess = plane.excess(direction, gate2);
                }
                let word = excess[..chunk.len()]
                    .iter()
                    .enumerate()
                    .fold(0, |word, (bit, &excess)| word | u64::from(excess <= 0.0) << bit);
                count += word.count_ones();
                self.bits.push(word);
            }
            self.counts.push(count);
        }
    }

    fn fill_common(&mut self, n: usize) {
        self.common.clear();
        self.common.resize(n * n, 0);
        for i in 0..n {
            for j in i + 1..n {
                let n_common = self.count_common(i, j);
                self.common[i * n + j] = n_common;
                self.common[j * n + i] = n_common;
            }
        }
    }

    #[inline]
    fn words(&self, cluster: usize) -> &[u64] {
        &self.bits[cluster * self.n_words..][..self.n_words]
    }

    #[inline]
    fn count_common(&self, a: usize, b: usize) -> u32 {
        self.words(a).iter().zip(self.words(b)).map(|(a, b)| (a & b).count_ones()).sum()
    }

    #[inline]
    fn neighbor(&self, of: u32, idx: u32) -> Option<Neighbor> {
        let n_common = self.common[of as usize * self.label.len() + idx as usize];
        let n_union = self.counts[of as usize] + self.counts[idx as usize] - n_common;
        (n_common > 0).then_some(Neighbor { idx, n_common, n_union })
    }

    /// The nearest of the live clusters after the one at `position`, the first of several; `None` if they
    /// share nothing with it.
    fn nearest_after(&self, position: usize) -> Option<Neighbor> {
        let of = self.alive[position];
        let mut best: Option<Neighbor> = None;
        for &idx in &self.alive[position + 1..] {
            if let Some(found) = self.neighbor(of, idx)
                && best.is_none_or(|best| found.is_nearer_than(&best))
            {
                best = Some(found);
            }
        }
        best
    }

    fn closest_pair(&self) -> Option<(u32, u32)> {
        let mut best: Option<(u32, Neighbor)> = None;
        for &idx in &self.alive {
            if let Some(found) = self.nearest[idx as usize]
                && best.is_none_or(|(_, best)| found.is_nearer_than(&best))
            {
                best = Some((idx, found));
            }
        }
        best.map(|(idx, neighbor)| (idx, neighbor.idx))
    }

    /// Merges cluster `from` into cluster `into`, which is before it, and brings distances and neighbors up
    /// to date.
    fn merge(&mut self, into: u32, from: u32) {
        let n = self.label.len();
        let (i, j) = (into as usize, from as usize);
        for word in 0..self.n_words {
            self.bits[i * self.n_words + word] &= self.bits[j * self.n_words + word];
        }
        self.counts[i] = self.words(i).iter().map(|word| word.count_ones()).sum();
        self.alive.retain(|&idx| idx != from);
        for label in self.label.iter_mut().filter(|label| **label == from) {
            *label = into;
        }
        for position in 0..self.alive.len() {
            let other = self.alive[position] as usize;
            // What had nothing in common cannot gain anything by an intersection.
            if other != i && self.common[i * n + other] > 0 {
                let n_common = self.count_common(i, other);
                self.common[i * n + other] = n_common;
                self.common[other * n + i] = n_common;
            }
        }
        for position in 0..self.alive.len() {
            let idx = self.alive[position];
            let stored = self.nearest[idx as usize];
            let has_lost_its_nearest = stored.is_some_and(|found| found.idx == into || found.idx == from);
            if idx == into || has_lost_its_nearest {
                self.nearest[idx as usize] = self.nearest_after(position);
            } else if idx < into
                && let Some(found) = self.neighbor(idx, into)
            {
                let replaces = stored.is_none_or(|stored| {
                    found.is_nearer_than(&stored) || (!stored.is_nearer_than(&found) && into < stored.idx)
                });
                if replaces {
                    self.nearest[idx as usize] = Some(found);
                }
            }
        }
    }

    fn clusters(&self, hypotheses: &[Vector3<f64>], min_size: usize) -> Vec<Cluster> {
        let members_of = |idx: u32| -> Vec<u32> {
            (0..self.label.len() as u32).filter(|&segment| self.label[segment as usize] == idx).collect()
        };
        let first_accepted = |idx: u32| {
            let words = self.words(idx as usize);
            let word = words.iter().position(|&word| word != 0)?;
            Some(hypotheses[word * WORD_BITS + words[word].trailing_zeros() as usize])
        };
        let cluster = |&idx: &u32| {
            let members = members_of(idx);
            let direction = first_accepted(idx)?;
            (members.len() >= min_size).then_some(Cluster { direction, members })
        };
        self.alive.iter().filter_map(cluster).collect()
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// The definition, without any of the bookkeeping.
    fn link_naively(planes: &[SegmentPlane], hypotheses: &[Vector3<f64>], gate2: f64) -> Vec<Vec<u32>> {
        let mut clusters: Vec<(Vec<u32>, Vec<bool>)> = (0..)
            .zip(planes)
            .map(|(idx, plane)| {
                (vec![idx], hypotheses.iter().map(|d| plane.excess(d, gate2) <= 0.0).collect())
            })
            .collect();
        loop {
            let mut best: Option<(u64, u64, usize, usize)> = None;
            for i in 0..clusters.len() {
                for j in i + 1..clusters.len() {
                    let pairs = || clusters[i].1.iter().zip(&clusters[j].1);
                    let common = pairs().filter(|(a, b)| **a && **b).count() as u64;
                    let union = pairs().filter(|(a, b)| **a || **b).count() as u64;
                    if common > 0 && best.is_none_or(|best| common * best.1 > best.0 * union) {
                        best = Some((common, union, i, j));
                    }
                }
            }
            let Some((_, _, i, j)) = best else { break };
            let (members, bits) = clusters.remove(j);
            clusters[i].0.extend(members);
            clusters[i].1.iter_mut().zip(bits).for_each(|(bit, other)| *bit &= other);
        }
        for (members, _) in &mut clusters {
            members.sort_unstable();
        }
        clusters.into_iter().map(|(members, _)| members).collect()
    }

    #[test]
    fn links_as_defined() {
        let mut linkage = Linkage::default();
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut ray = || Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let planes: Vec<_> = (0..25)
                .filter_map(|_| {
                    let from = ray();
                    SegmentPlane::from_rays(&from, &(from + ray() * 0.3), 0.02)
                })
                .collect();
            let hypotheses: Vec<_> = (0..100).map(|_| ray().normalize()).collect();
            let expected: Vec<_> =
                link_naively(&planes, &hypotheses, 4.0).into_iter().filter(|c| c.len() >= 2).collect();
            assert!(!expected.is_empty());
            let clusters = linkage.link(&planes, &hypotheses, 4.0, 2);
            let members: Vec<_> = clusters.iter().map(|cluster| cluster.members.clone()).collect();
            assert_eq!(members, expected, "seed {seed}");
            for cluster in clusters {
                for member in cluster.members {
                    assert!(planes[member as usize].excess(&cluster.direction, 4.0) <= 0.0);
                }
            }
        }
    }
}
