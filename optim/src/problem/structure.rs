//! Builds the [`Layout`]: the order of the unknowns, the sparsity of the reduced system, and where each block
//! lies.
//!
//! 1. Free variables are numbered: reduced ones, then landmarks; their dimensions give the gradient's
//!    offsets.
//! 2. The factors are read once: those between a landmark and a reduced variable give the landmark's members,
//!    those between two reduced variables the edges of the reduced system.
//! 3. The reduced system is laid out column by column. Below the diagonal of a column stand the variables
//!    that share a factor with it, and those that share a landmark with it: eliminating the landmark fills
//!    them in.
//! 4. Behind it come the landmarks' diagonal blocks, then their blocks with their members.
//! 5. Variables and factors are told their offsets, so that the linearization looks nothing up.
//!
//! Unknowns are ordered by the type of variable, then by that in which they were added, so that
//! the same problem always sums in the same order and gives the same bytes.

use super::group::Group;
use crate::layout::{
    FactorPairs, Landmark, Layout, Member, NO_SLOT, ReducedVariable, TRANSPOSED, VariableSlot,
};
use crate::variables::{Role, Stores, VariableRef};

/// What a variable is in the linear system.
#[derive(Clone, Copy)]
enum Place {
    Fixed,
    Reduced(u32),
    Landmark(u32),
}

impl Layout {
    /// Orders the variables, tells them their slots, and tells the factors their blocks.
    pub(crate) fn build(stores: &mut Stores, groups: &mut [Box<dyn Group>]) -> Self {
        let mut layout = Self::default();
        let places = layout.place_variables(stores);
        let edges = layout.collect_members(stores, groups, &places);
        layout.lay_out_reduced(&edges);
        layout.lay_out_landmarks(stores);
        layout.publish(stores, groups, &places);
        layout
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
    fn sort_members(&mut self, ties: &[(u32, u32)], counts: Vec<usize>) {
        let starts = running_sums(counts);
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
            // A landmark may be tied to a variable by several factors: a point and its line, say.
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
        self.reserve_pairs();
        let occurrences = Occurrences::of(self);
        let mut edges = edges.iter().peekable();
        let mut pattern = ColumnPattern::new(self.reduced.len());
        let mut offset_of = vec![NO_SLOT; self.reduced.len()];
        self.column_starts.push(0);
        for column in 0..self.reduced.len() {
            let here = occurrences.of_column(column);
            pattern.begin(column);
            // Fill-in: what a landmark of this column is tied to besides. Members are sorted, so those behind
            // this one are those below the diagonal.
            for &(landmark, position) in here {
                let Landmark { members, .. } = &self.landmarks[landmark as usize];
                let later = &self.members[members.start + position as usize + 1..members.end];
                later.iter().for_each(|member| pattern.insert(member.reduced));
            }
            // Ties by a factor. The edges are sorted by their lower end, so each column takes a run of them.
            while let Some((_, row)) = edges.next_if(|edge| edge.0 as usize == column) {
                pattern.insert(*row);
            }
            self.place_column(column, pattern.sorted_rows());
            self.note_pairs(column, here, &mut offset_of);
        }
        self.n_reduced_blocks = self.n_blocks;
    }

    /// Makes room for every landmark's pairs.
    fn reserve_pairs(&mut self) {
        for landmark in &mut self.landmarks {
            landmark.pairs = self.pairs.len();
            self.pairs.resize(self.pairs.len() + Landmark::n_pairs(landmark.members.len()), NO_SLOT);
        }
    }

    /// Places a column's diagonal block and, behind it, one for each of `rows`.
    fn place_column(&mut self, column: usize, rows: &[u32]) {
        let dim = self.reduced[column].dim;
        self.reduced[column].diagonal = self.n_blocks;
        self.n_blocks += dim * dim;
        for &row in rows {
            self.rows.push(row);
            self.offsets.push(block_offset(self.n_blocks));
            self.n_blocks += dim * self.reduced[row as usize].dim;
        }
        self.column_starts.push(self.rows.len());
    }

    /// Notes where the products of `column` with each landmark's later members go. `offset_of` is scratch:
    /// the offset of each row of this column. Rows of other columns keep stale ones, which nobody asks for.
    fn note_pairs(&mut self, column: usize, here: &[(u32, u32)], offset_of: &mut [u32]) {
        for at in self.below(column) {
            offset_of[self.rows[at] as usize] = self.offsets[at];
        }
        for &(landmark, position) in here {
            let landmark = &self.landmarks[landmark as usize];
            let position = position as usize;
            let later = &self.members[landmark.members.start + position + 1..landmark.members.end];
            let first = landmark.pairs_of(position);
            for (pair, member) in self.pairs[first..].iter_mut().zip(later) {
                *pair = offset_of[member.reduced as usize];
            }
        }
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
                store.set_slot(index, self.slot(*place));
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

    fn slot(&self, place: Place) -> VariableSlot {
        let (gradient, diagonal) = match place {
            Place::Fixed => return VariableSlot::FIXED,
            Place::Reduced(i) => {
                let variable = &self.reduced[i as usize];
                (variable.gradient, variable.diagonal)
            }
            Place::Landmark(i) => {
                let landmark = &self.landmarks[i as usize];
                (landmark.gradient, landmark.diagonal)
            }
        };
        VariableSlot { gradient: block_offset(gradient), diagonal: block_offset(diagonal) }
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
        let range = self.below(column as usize);
        let position = self.rows[range.clone()].binary_search(&row);
        self.offsets[range.start + position.expect("every factor's pairs were laid out")]
    }

    fn cross_block(&self, landmark: u32, reduced: u32) -> u32 {
        let members = &self.members[self.landmarks[landmark as usize].members.clone()];
        let position = members.binary_search_by_key(&reduced, |member| member.reduced);
        members[position.expect("every factor's landmark was tied")].cross
    }
}

/// For each reduced variable the landmarks it is tied to, each with its position among their members: the
/// transpose of the landmarks' lists of members.
struct Occurrences {
    /// `(landmark, position)`, column by column.
    list: Vec<(u32, u32)>,
    starts: Vec<usize>,
}

impl Occurrences {
    fn of(layout: &Layout) -> Self {
        let mut counts = vec![0usize; layout.reduced.len() + 1];
        for member in &layout.members {
            counts[member.reduced as usize + 1] += 1;
        }
        let starts = running_sums(counts);
        let mut next = starts.clone();
        let mut list = vec![(0, 0); layout.members.len()];
        for (index, landmark) in layout.landmarks.iter().enumerate() {
            for (position, member) in layout.members[landmark.members.clone()].iter().enumerate() {
                let place = &mut next[member.reduced as usize];
                list[*place] = (index as u32, position as u32);
                *place += 1;
            }
        }
        Self { list, starts }
    }

    fn of_column(&self, column: usize) -> &[(u32, u32)] {
        &self.list[self.starts[column]..self.starts[column + 1]]
    }
}

/// The set of rows below the diagonal of one column after another. A row is in it when its stamp is the
/// column's number, so that a new column clears nothing.
struct ColumnPattern {
    column: u32,
    seen_in: Vec<u32>,
    rows: Vec<u32>,
}

impl ColumnPattern {
    fn new(n_columns: usize) -> Self {
        Self { column: NO_SLOT, seen_in: vec![NO_SLOT; n_columns], rows: Vec::new() }
    }

    fn begin(&mut self, column: usize) {
        self.column = column as u32;
        self.rows.clear();
    }

    fn insert(&mut self, row: u32) {
        let stamp = &mut self.seen_in[row as usize];
        if *stamp != self.column {
            *stamp = self.column;
            self.rows.push(row);
        }
    }

    fn sorted_rows(&mut self) -> &[u32] {
        self.rows.sort_unstable();
        &self.rows
    }
}

/// The pairs of a factor's members, in the order of [`FactorPairs`].
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

fn resolve(variables: [Option<VariableRef>; 3], places: &[Vec<Place>]) -> [Place; 3] {
    variables.map(|variable| match variable {
        Some(VariableRef { store, index }) => places[store as usize][index as usize],
        None => Place::Fixed,
    })
}

/// Counts, each one place behind what it counts, become the places where its entries start.
fn running_sums(mut counts: Vec<usize>) -> Vec<usize> {
    for i in 1..counts.len() {
        counts[i] += counts[i - 1];
    }
    counts
}

/// Offsets are kept in 31 bits: 16 GB of blocks, more than any problem solved on one thread.
fn block_offset(offset: usize) -> u32 {
    assert!(offset < TRANSPOSED as usize, "the normal equations exceed 16 GB");
    offset as u32
}
