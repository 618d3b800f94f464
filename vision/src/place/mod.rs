//! Place recognition: which stored images show what this image shows. (Image retrieval for loop closure and
//! relocalization; what a bag of words, DBoW2, does elsewhere.)
//!
//! Instead of a vocabulary trained beforehand and loaded from a file, the stored descriptors index
//! themselves: a few binary search trees that ask one bit of a descriptor after the other, growing as images
//! come [Schlegel & Grisetti, "HBST: a Hamming distance embedding binary search tree for feature-based visual
//! place recognition", RA-L 2018]. A queried descriptor is compared with those it shares a leaf with, and
//! votes for the images of those that are near.

mod tree;

use std::collections::BTreeMap;

use crate::Descriptor;
use crate::matching::DescriptorMatch;
use tree::{Owner, Tree};

/// A stored image that may show the queried place.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceCandidate {
    /// The id the image was inserted with.
    pub image_id: u64,
    /// Similarity, the higher the better; comparable between candidates of one query.
    pub score: f32,
    /// Number of query descriptors that voted for this image.
    pub n_votes: u32,
    /// The votes: `first_idx` into the queried descriptors, `second_idx` into the stored image's. One for
    /// each query descriptor, not mutual; a start for geometric verification, not all matches there are.
    pub matches: Vec<DescriptorMatch>,
}

/// How places are indexed.
///
/// Measured on 7-Scenes RedKitchen, 250 images of 1000 features stored: of 132 queries with a true neighbor
/// (within 0.3 m and 20 degrees, but over 2 s apart) 85 % had one among the first five, in 1.6 ms a query.
/// One to four trees, leaves of 50 to 200 and distances of 35 to 55 gave 80 to 85 %, differences the sample
/// can hardly tell from chance: the defaults were chosen for their time. On the 12 queries also matched all
/// against all, that found 11, the trees 10.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlaceConfig {
    /// Trees, at least 1. Each finds matches that others miss and costs its own time and memory. Default 2.
    pub n_trees: usize,
    /// A leaf is divided when it holds more entries, at least 2. Larger leaves take longer and hardly find
    /// more. Default 50.
    pub max_leaf_size: usize,
    /// Descriptors vote for one another up to this distance, bits. Default 45.
    pub max_distance: u32,
}

impl Default for PlaceConfig {
    fn default() -> Self {
        Self { n_trees: 2, max_leaf_size: 50, max_distance: 45 }
    }
}

/// An index of images by their binary descriptors, growing and shrinking as images come and go.
///
/// Takes about 40 bytes per descriptor and tree. The same calls in the same order give the same answers.
#[derive(Clone, Debug)]
pub struct PlaceIndex {
    config: PlaceConfig,
    trees: Vec<Tree>,
    slots: Vec<Slot>,
    slot_of_image: BTreeMap<u64, u32>,
    /// Slots no entry refers to any more.
    free_slots: Vec<u32>,
    n_live_entries: usize,
    n_dead_entries: usize,
}

/// What is known of an image whose descriptors are in the trees.
#[derive(Clone, Copy, Debug)]
struct Slot {
    image_id: u64,
    n_descriptors: usize,
    /// Whether the image is still wanted. Entries of dead images are passed over, and swept out from time to
    /// time.
    is_alive: bool,
}

impl Default for PlaceIndex {
    fn default() -> Self {
        Self::with_config(PlaceConfig::default())
    }
}

impl PlaceIndex {
    /// An empty index with default settings.
    pub fn new() -> Self {
        Self::default()
    }

    /// An empty index. Numbers below their minimum are raised to it; there are at most 16 trees.
    pub fn with_config(config: PlaceConfig) -> Self {
        let n_trees = config.n_trees.clamp(1, 16);
        let max_leaf_size = config.max_leaf_size.max(2);
        Self {
            config: PlaceConfig { n_trees, max_leaf_size, ..config },
            trees: (0..n_trees as u32).map(|tree| Tree::new(tree, n_trees as u32, max_leaf_size)).collect(),
            slots: Vec::new(),
            slot_of_image: BTreeMap::new(),
            free_slots: Vec::new(),
            n_live_entries: 0,
            n_dead_entries: 0,
        }
    }

    /// Number of images held.
    pub fn len(&self) -> usize {
        self.slot_of_image.len()
    }

    /// Whether no image is held.
    pub fn is_empty(&self) -> bool {
        self.slot_of_image.is_empty()
    }

    /// Whether an image of this id is held.
    pub fn contains(&self, image_id: u64) -> bool {
        self.slot_of_image.contains_key(&image_id)
    }

    /// Adds an image, replacing one of the same id.
    pub fn insert(&mut self, image_id: u64, descriptors: &[Descriptor]) {
        self.remove(image_id);
        let record = Slot { image_id, n_descriptors: descriptors.len(), is_alive: true };
        let slot = match self.free_slots.pop() {
            Some(slot) => {
                self.slots[slot as usize] = record;
                slot
            }
            None => {
                self.slots.push(record);
                (self.slots.len() - 1) as u32
            }
        };
        self.slot_of_image.insert(image_id, slot);
        let slots = &self.slots;
        let is_alive = |slot: u32| slots[slot as usize].is_alive;
        for tree in &mut self.trees {
            for (feature_idx, descriptor) in descriptors.iter().enumerate() {
                tree.insert(*descriptor, Owner { slot, feature_idx: feature_idx as u32 }, &is_alive);
            }
        }
        self.n_live_entries += descriptors.len();
    }

    /// Takes an image out; `false` if it was not there. Its descriptors are swept out later, together with
    /// others.
    pub fn remove(&mut self, image_id: u64) -> bool {
        let Some(slot) = self.slot_of_image.remove(&image_id) else { return false };
        let record = &mut self.slots[slot as usize];
        record.is_alive = false;
        self.n_live_entries -= record.n_descriptors;
        self.n_dead_entries += record.n_descriptors;
        // Sweeping when a third of all entries is dead costs each removal a few of its own entries' time, and
        // bounds memory by one and a half times what is needed.
        if 2 * self.n_dead_entries > self.n_live_entries {
            self.sweep();
        }
        true
    }

    fn sweep(&mut self) {
        let slots = &self.slots;
        for tree in &mut self.trees {
            tree.compact(&|slot| slots[slot as usize].is_alive);
        }
        self.n_dead_entries = 0;
        // Popped from the end: the lowest first.
        self.free_slots =
            (0..self.slots.len() as u32).rev().filter(|&s| !slots[s as usize].is_alive).collect();
    }

    /// The `max_results` stored images most like the queried one, best first.
    pub fn query(&self, descriptors: &[Descriptor], max_results: usize) -> Vec<PlaceCandidate> {
        self.query_where(descriptors, max_results, |_| true)
    }

    /// As [`PlaceIndex::query`], among the images whose id satisfies `is_wanted` only, for example those that
    /// do not see the same points anyway.
    pub fn query_where(
        &self,
        descriptors: &[Descriptor],
        max_results: usize,
        is_wanted: impl Fn(u64) -> bool,
    ) -> Vec<PlaceCandidate> {
        let is_open: Vec<bool> = self.slots.iter().map(|s| s.is_alive && is_wanted(s.image_id)).collect();
        let votes = self.collect_votes(descriptors, &is_open);
        let mut tallies = vec![Tally::default(); self.slots.len()];
        for vote in &votes {
            let tally = &mut tallies[vote.slot as usize];
            tally.score += vote.weight;
            tally.n_votes += 1;
        }
        let mut ranked: Vec<(u32, Tally)> =
            (0..).zip(tallies).filter(|(_, tally)| tally.n_votes > 0).collect();
        ranked.sort_by(|(a_slot, a), (b_slot, b)| {
            let id = |slot: u32| self.slots[slot as usize].image_id;
            b.score.total_cmp(&a.score).then_with(|| id(*a_slot).cmp(&id(*b_slot)))
        });
        ranked.truncate(max_results);
        let candidate = |(slot, tally): (u32, Tally)| PlaceCandidate {
            image_id: self.slots[slot as usize].image_id,
            score: tally.score,
            n_votes: tally.n_votes,
            matches: votes.iter().filter(|vote| vote.slot == slot).map(|vote| vote.matched).collect(),
        };
        ranked.into_iter().map(candidate).collect()
    }

    /// For each query descriptor and each open image it meets near enough in any tree: its nearest there.
    fn collect_votes(&self, descriptors: &[Descriptor], is_open: &[bool]) -> Vec<Vote> {
        let n_images = self.len() as f32;
        let mut votes: Vec<Vote> = Vec::new();
        // The vote of the current descriptor for each image, if it is at or after `start` in `votes`.
        let mut vote_of_slot = vec![0usize; self.slots.len()];
        for (first_idx, descriptor) in (0..).zip(descriptors) {
            let start = votes.len();
            for tree in &self.trees {
                let leaf = tree.leaf(descriptor);
                for (stored, owner) in leaf.descriptors.iter().zip(&leaf.owners) {
                    let distance = descriptor.distance(stored);
                    if distance > self.config.max_distance || !is_open[owner.slot as usize] {
                        continue;
                    }
                    let matched = DescriptorMatch { first_idx, second_idx: owner.feature_idx, distance };
                    let at = vote_of_slot[owner.slot as usize];
                    match votes.get_mut(at) {
                        Some(vote) if at >= start && vote.slot == owner.slot => {
                            if distance < vote.matched.distance {
                                vote.matched = matched;
                            }
                        }
                        _ => {
                            vote_of_slot[owner.slot as usize] = votes.len();
                            votes.push(Vote { slot: owner.slot, weight: 0.0, matched });
                        }
                    }
                }
            }
            // A descriptor seen in every image tells nothing about the place: inverse document frequency.
            let n_met = (votes.len() - start) as f32;
            let weight = (1.0 + n_images / n_met.max(1.0)).ln();
            votes[start..].iter_mut().for_each(|vote| vote.weight = weight);
        }
        votes
    }
}

#[derive(Clone, Copy, Debug)]
struct Vote {
    slot: u32,
    weight: f32,
    matched: DescriptorMatch,
}

#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    score: f32,
    n_votes: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::Random;

    fn random_image(random: &mut Random, n: usize) -> Vec<Descriptor> {
        let word = |random: &mut Random| u64::from(random.bits()) << 32 | u64::from(random.bits());
        (0..n).map(|_| Descriptor(std::array::from_fn(|_| word(random)))).collect()
    }

    /// The same features seen again: some bits flipped.
    fn seen_again(random: &mut Random, image: &[Descriptor], n_flipped: u32) -> Vec<Descriptor> {
        let mut again = image.to_vec();
        for descriptor in &mut again {
            for _ in 0..n_flipped {
                let bit = random.below(256);
                descriptor.0[(bit / 64) as usize] ^= 1 << (bit % 64);
            }
        }
        again
    }

    #[test]
    fn an_image_seen_again_is_found_first() {
        let mut random = Random::new(1);
        let images: Vec<_> = (0..40).map(|_| random_image(&mut random, 200)).collect();
        let mut index = PlaceIndex::new();
        for (id, image) in (100..).zip(&images) {
            index.insert(id, image);
        }
        assert_eq!(index.len(), 40);
        for (id, image) in (100..).zip(&images) {
            let query = seen_again(&mut random, image, 20);
            let found = index.query(&query, 3);
            assert_eq!(found[0].image_id, id);
            assert!(found[0].n_votes > 20, "{} votes", found[0].n_votes);
            assert_eq!(found[0].matches.len(), found[0].n_votes as usize);
            for m in &found[0].matches {
                let (a, b) = (&query[m.first_idx as usize], &image[m.second_idx as usize]);
                assert_eq!((a.distance(b), m.first_idx), (m.distance, m.second_idx));
            }
            assert!(index.query_where(&query, 3, |other| other != id).iter().all(|c| c.image_id != id));
        }
    }

    #[test]
    fn removed_images_are_not_found_and_leave_no_memory_behind() {
        let mut random = Random::new(2);
        let mut index = PlaceIndex::new();
        let images: Vec<_> = (0..30).map(|_| random_image(&mut random, 100)).collect();
        for round in 0..20 {
            for (id, image) in (0..).zip(&images) {
                index.insert(1000 * round + id, image);
            }
            for id in 5..30 {
                assert!(index.remove(1000 * round + id));
                assert!(!index.remove(1000 * round + id));
            }
            for id in 0..5 {
                assert!(round == 0 || index.remove(1000 * (round - 1) + id));
            }
            assert_eq!(index.len(), 5);
        }
        assert!(index.query(&images[7], 5).is_empty());
        assert_eq!(index.query(&images[3], 5)[0].image_id, 19_003);
        assert!(index.slots.len() < 60, "{} slots", index.slots.len());
        for tree in &index.trees {
            assert!(tree.n_entries() <= 750, "{} entries", tree.n_entries());
            assert!(tree.n_nodes() < 120, "{} nodes", tree.n_nodes());
        }
    }

    #[test]
    fn an_image_inserted_twice_is_held_once() {
        let mut random = Random::new(3);
        let (old, new) = (random_image(&mut random, 50), random_image(&mut random, 50));
        let mut index = PlaceIndex::new();
        index.insert(7, &old);
        index.insert(7, &new);
        assert_eq!(index.len(), 1);
        assert!(index.query(&old, 5).is_empty());
        assert_eq!(index.query(&new, 5)[0].n_votes, 50);
    }

    #[test]
    fn equal_descriptors_and_empty_images_do_no_harm() {
        let mut index = PlaceIndex::new();
        index.insert(1, &[Descriptor([5; 4]); 1000]);
        index.insert(2, &[]);
        assert_eq!(index.query(&[Descriptor([5; 4])], 5).len(), 1);
        assert!(index.query(&[], 5).is_empty());
        assert!(index.query(&[Descriptor([5; 4])], 0).is_empty());
        assert!(index.remove(1) && index.remove(2));
        assert!(index.is_empty() && index.query(&[Descriptor([5; 4])], 5).is_empty());
    }

    #[test]
    fn the_same_calls_give_the_same_answers() {
        let build = || {
            let mut random = Random::new(4);
            let mut index = PlaceIndex::new();
            let images: Vec<_> = (0..20).map(|_| random_image(&mut random, 150)).collect();
            (0..).zip(&images).for_each(|(id, image)| index.insert(id, image));
            (3..9).for_each(|id| assert!(index.remove(id)));
            index.query(&seen_again(&mut random, &images[12], 25), 10)
        };
        assert_eq!(build(), build());
    }
}
