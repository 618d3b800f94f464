//! Where everything lies: the order of variables, the sparsity of the normal equations, their layout.
//!
//! Built once per set of variables and factors, in an order fixed by that in which they were added, so that
//! the same problem always sums in the same order and gives the same bytes.

use std::ops::Range;

use super::group::{FactorPairs, Group};
use crate::normal::TRANSPOSED;
use crate::variables::{NO_SLOT, Role, Stores, VariableRef, VariableSlot};

/// A free variable of the reduced system.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReducedVariable {
    pub dim: usize,
    /// Offset in the gradient.
    pub gradient: usize,
    /// Offset of the diagonal block, `dim x dim`.
    pub diagonal: usize,
}

/// A free landmark, to be eliminated.
#[derive(Clone, Debug)]
pub(crate) struct Landmark {
    /// Offset in the gradient.
    pub gradient: usize,
    /// Offset of the diagonal block.
    pub diagonal: usize,
    /// Range in [`Structure::members`].
    pub members: Range<usize>,
    /// Start in [`Structure::pairs`] of the blocks of member pairs `(a, b)`, `a < b`, `b` running fastest.
    pub pairs: usize,
}

/// A reduced variable that a landmark is tied to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Member {
    /// Index in [`Structure::reduced`].
    pub reduced: u32,
    /// Offset of the block (reduced x landmark).
    pub cross: u32,
}

/// Order, sparsity and layout of the normal equations; offsets are into `NormalEquations`.
#[derive(Default)]
pub(crate) struct Structure {
    pub reduced: Vec<ReducedVariable>,
    pub landmarks: Vec<Landmark>,
    /// Range of `landmarks` per store.
    pub spans: Vec<Range<usize>>,
    pub members: Vec<Member>,
    pub pairs: Vec<u32>,
    /// Blocks strictly below the diagonal, by block columns: rows and offsets of column `c` are at
    /// `column_starts[c]..column_starts[c + 1]`; a block is `dim(row) x dim(column)`.
    pub column_starts: Vec<usize>,
    pub rows: Vec<u32>,
    pub offsets: Vec<u32>,
    /// Scalar dimension of the reduced system.
    pub n_reduced_dims: usize,
    /// Length of the part of the blocks that belongs to the reduced system.
    pub n_reduced_blocks: usize,
    pub n_blocks: usize,
    pub n_gradient: usize,
    /// The most members any landmark has.
    pub max_members: usize,
    pub max_reduced_dim: usize,
    pub max_landmark_dim: usize,
}

/// What a variable is in the linear system.
#[derive(Clone, Copy)]
enum Place {
    Fixed,
    Reduced(u32),
    Landmark(u32),
}

impl Structure {
    /// Orders the variables, tells them their slots, and tells the factors their blocks.
    pub(crate) fn build(stores: &mut Stores, groups: &mut [Box<dyn Group>]) -> Self {
        let mut structure = Self::default();
        let places = structure.place_variables(stores);
        let edges = structure.collect_members(stores, groups, &places);
        structure.lay_out_reduced(&edges);
        structure.lay_out_landmarks(stores);
        structure.publish(stores, groups, &places);
        structure
    }

    /// Gives every free variable its ordinal and its place in the gradient: reduced ones first.
    fn place_variables(&mut self, stores: &Stores) -> Vec<Vec<Place>> {
        let mut places: Vec<Vec<Place>> =
            stores.iter().map(|store| vec![Place::Fixed; store.len()]).collect();
        for (store, places) in stores.iter().zip(&mut places) {
            for (index, place) in places.iter_mut().enumerate() {
                if store.role(index) == Role::Reduced && !store.is_fixed(index) {
                    *place = Place::Reduced(self.reduced.len() as u32);
                    let gradient = self.n_gradient;
                    self.reduced.push(ReducedVariable { dim: store.dim(), gradient, diagonal: 0 });
                    self.n_gradient += store.dim();
                    self.max_reduced_dim = self.max_reduced_dim.max(store.dim());
                }
            }
        }
        self.n_reduced_dims = self.n_gradient;
        for (store, places) in stores.iter().zip(&mut places) {
            let first = self.landmarks.len();
            for (index, place) in places.iter_mut().enumerate() {
                if store.role(index) == Role::Landmark && !store.is_fixed(index) {
                    *place = Place::Landmark(self.landmarks.len() as u32);
                    let gradient = self.n_gradient;
                    self.landmarks.push(Landmark { gradient, diagonal: 0, members: 0..0, pairs: 0 });
                    self.n_gradient += store.dim();
                    self.max_landmark_dim = self.max_landmark_dim.max(store.dim());
                }
            }
            self.spans.push(first..self.landmarks.len());
        }
        places
    }

    /// Finds each landmark's reduced variables, sorted; returns the pairs `(lower, higher)` of reduced
    /// variables that share a factor, sorted.
    fn collect_members(
        &mut self,
        stores: &Stores,
        groups: &[Box<dyn Group>],
        places: &[Vec<Place>],
    ) -> Vec<(u32, u32)> {
        let mut edges = Vec::new();
        let mut ties: Vec<(u32, u32)> = Vec::new();
        let mut counts = vec![0usize; self.landmarks.len() + 1];
        for group in groups {
            for index in 0..group.len() {
                let members = resolve(group.variables(index, stores), places);
                for (&a, &b) in PAIRS.iter().map(|(a, b)| (&members[*a], &members[*b])) {
                    match (a, b) {
                        (Place::Reduced(a), Place::Reduced(b)) => edges.push((a.min(b), a.max(b))),
                        (Place::Reduced(reduced), Place::Landmark(landmark))
                        | (Place::Landmark(landmark), Place::Reduced(reduced)) => {
                            counts[landmark as usize + 1] += 1;
                            ties.push((landmark, reduced));
                        }
                        _ => {}
                    }
                }
            }
        }
        edges.sort_unstable();
        edges.dedup();
        self.sort_members(&ties, counts);
        edges
    }

    /// Counting sort of `(landmark, reduced)` by landmark, then sorts and deduplicates each list.
    fn sort_members(&mut self, ties: &[(u32, u32)], mut starts: Vec<usize>) {
        for landmark in 1..starts.len() {
            starts[landmark] += starts[landmark - 1];
        }
        let mut next = starts.clone();
        let mut sorted = vec![0u32; ties.len()];
        for &(landmark, reduced) in ties {
            sorted[next[landmark as usize]] = reduced;
            next[landmark as usize] += 1;
        }
        self.members.reserve(ties.len());
        for (index, landmark) in self.landmarks.iter_mut().enumerate() {
            let list = &mut sorted[starts[index]..starts[index + 1]];
            list.sort_unstable();
            let first = self.members.len();
            for &reduced in list.iter() {
                let known = self.members[first..].last().is_some_and(|last| last.reduced == reduced);
                if !known {
                    self.members.push(Member { reduced, cross: 0 });
                }
            }
            landmark.members = first..self.members.len();
            self.max_members = self.max_members.max(landmark.members.len());
        }
    }

    /// Lays out the blocks of the reduced system column by column: the diagonal block, then those below it,
    /// and notes for each landmark where the products of its members go.
    fn lay_out_reduced(&mut self, edges: &[(u32, u32)]) {
        for landmark in 0..self.landmarks.len() {
            let n = self.landmarks[landmark].members.len();
            self.landmarks[landmark].pairs = self.pairs.len();
            self.pairs.resize(self.pairs.len() + n * n.saturating_sub(1) / 2, NO_SLOT);
        }
        let (occurrences, starts) = self.occurrences();
        let mut edges = edges.iter().peekable();
        let mut seen_in = vec![NO_SLOT; self.reduced.len()];
        let mut offset_of = vec![NO_SLOT; self.reduced.len()];
        let mut rows = Vec::new();
        self.column_starts.push(0);
        for column in 0..self.reduced.len() {
            rows.clear();
            let mut see = |row: u32| {
                if seen_in[row as usize] != column as u32 {
                    seen_in[row as usize] = column as u32;
                    rows.push(row);
                }
            };
            let here = &occurrences[starts[column]..starts[column + 1]];
            for &(landmark, position) in here {
                let range = &self.landmarks[landmark as usize].members;
                self.members[range.start + position as usize + 1..range.end]
                    .iter()
                    .for_each(|m| see(m.reduced));
            }
            while let Some((_, row)) = edges.next_if(|edge| edge.0 as usize == column) {
                see(*row);
            }
            rows.sort_unstable();
            let dim = self.reduced[column].dim;
            self.reduced[column].diagonal = self.n_blocks;
            self.n_blocks += dim * dim;
            for &row in &rows {
                offset_of[row as usize] = block_offset(self.n_blocks);
                self.rows.push(row);
                self.offsets.push(offset_of[row as usize]);
                self.n_blocks += dim * self.reduced[row as usize].dim;
            }
            self.column_starts.push(self.rows.len());
            for &(landmark, position) in here {
                let Landmark { members, pairs, .. } = &self.landmarks[landmark as usize];
                let (n, a) = (members.len(), position as usize);
                let first = pairs + a * (2 * n - a - 1) / 2;
                let later = &self.members[members.start + a + 1..members.end];
                for (pair, member) in self.pairs[first..].iter_mut().zip(later) {
                    *pair = offset_of[member.reduced as usize];
                }
            }
        }
        self.n_reduced_blocks = self.n_blocks;
    }

    /// The landmarks each reduced variable is tied to, with its position among their members.
    fn occurrences(&self) -> (Vec<(u32, u32)>, Vec<usize>) {
        let mut starts = vec![0usize; self.reduced.len() + 1];
        for member in &self.members {
            starts[member.reduced as usize + 1] += 1;
        }
        for reduced in 1..starts.len() {
            starts[reduced] += starts[reduced - 1];
        }
        let mut next = starts.clone();
        let mut occurrences = vec![(0, 0); self.members.len()];
        for (index, landmark) in self.landmarks.iter().enumerate() {
            for (position, member) in self.members[landmark.members.clone()].iter().enumerate() {
                let place = &mut next[member.reduced as usize];
                occurrences[*place] = (index as u32, position as u32);
                *place += 1;
            }
        }
        (occurrences, starts)
    }

    /// Places the landmarks' diagonal blocks and behind them their blocks with reduced variables.
    fn lay_out_landmarks(&mut self, stores: &Stores) {
        for (store, span) in stores.iter().zip(&self.spans) {
            for landmark in &mut self.landmarks[span.clone()] {
                landmark.diagonal = self.n_blocks;
                self.n_blocks += store.dim() * store.dim();
            }
        }
        for (store, span) in stores.iter().zip(&self.spans) {
            for landmark in &self.landmarks[span.clone()] {
                for member in &mut self.members[landmark.members.clone()] {
                    member.cross = block_offset(self.n_blocks);
                    self.n_blocks += store.dim() * self.reduced[member.reduced as usize].dim;
                }
            }
        }
        // The last offset fits, so every earlier one does.
        block_offset(self.n_blocks);
    }

    /// Tells variables and factors where their parts are.
    fn publish(&self, stores: &mut Stores, groups: &mut [Box<dyn Group>], places: &[Vec<Place>]) {
        for (store, places) in stores.iter_mut().zip(places) {
            for (index, place) in places.iter().enumerate() {
                let (gradient, diagonal) = match *place {
                    Place::Fixed => {
                        store.set_slot(index, VariableSlot::FIXED);
                        continue;
                    }
                    Place::Reduced(i) => {
                        (self.reduced[i as usize].gradient, self.reduced[i as usize].diagonal)
                    }
                    Place::Landmark(i) => {
                        (self.landmarks[i as usize].gradient, self.landmarks[i as usize].diagonal)
                    }
                };
                store.set_slot(
                    index,
                    VariableSlot { gradient: block_offset(gradient), diagonal: block_offset(diagonal) },
                );
            }
        }
        for group in groups {
            for index in 0..group.len() {
                let members = resolve(group.variables(index, stores), places);
                let pairs: FactorPairs = PAIRS.map(|(a, b)| self.pair_block(members[a], members[b]));
                group.set_pairs(index, pairs);
            }
        }
    }

    /// Where `J_aᵀ J_b` goes; marked when the block there is its transpose.
    fn pair_block(&self, a: Place, b: Place) -> u32 {
        match (a, b) {
            (Place::Reduced(a), Place::Reduced(b)) if a > b => self.reduced_block(a, b),
            (Place::Reduced(a), Place::Reduced(b)) => self.reduced_block(b, a) | TRANSPOSED,
            (Place::Reduced(reduced), Place::Landmark(landmark)) => self.cross_block(landmark, reduced),
            (Place::Landmark(landmark), Place::Reduced(reduced)) => {
                self.cross_block(landmark, reduced) | TRANSPOSED
            }
            _ => NO_SLOT,
        }
    }

    fn reduced_block(&self, row: u32, column: u32) -> u32 {
        let range = self.column_starts[column as usize]..self.column_starts[column as usize + 1];
        let rows = &self.rows[range.clone()];
        let position = rows.binary_search(&row).expect("every factor's pairs were laid out");
        self.offsets[range.start + position]
    }

    fn cross_block(&self, landmark: u32, reduced: u32) -> u32 {
        let members = &self.members[self.landmarks[landmark as usize].members.clone()];
        let position = members.binary_search_by_key(&reduced, |member| member.reduced);
        members[position.expect("every factor's landmark was tied")].cross
    }
}

const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

fn resolve(variables: [Option<VariableRef>; 3], places: &[Vec<Place>]) -> [Place; 3] {
    variables.map(|variable| match variable {
        Some(VariableRef { store, index }) => places[store as usize][index as usize],
        None => Place::Fixed,
    })
}

/// Offsets are kept in 31 bits: 16 GB of blocks, more than any problem solved on one thread.
fn block_offset(offset: usize) -> u32 {
    assert!(offset < TRANSPOSED as usize, "the normal equations exceed 16 GB");
    offset as u32
}
