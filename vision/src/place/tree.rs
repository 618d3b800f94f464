//! A binary search tree over descriptors, each node asking for one bit.

use crate::Descriptor;

/// Whose descriptor an entry is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Owner {
    /// The image's place in the index's table.
    pub slot: u32,
    /// The descriptor's place in the image.
    pub feature_idx: u32,
}

/// A tree that uses only the bits `first_bit`, `first_bit + bit_step`, ... so that several trees ask
/// different bits.
#[derive(Clone, Debug)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    first_bit: u32,
    bit_step: u32,
    max_leaf_size: usize,
}

#[derive(Clone, Debug)]
enum Node {
    /// Descriptors without the bit are below `children[0]`, those with it below `children[1]`.
    Split {
        bit: u32,
        children: [u32; 2],
    },
    Leaf(Leaf),
}

/// Entries that agree in all bits asked on the way; descriptor and owner at equal indices.
#[derive(Clone, Debug, Default)]
pub(super) struct Leaf {
    pub descriptors: Vec<Descriptor>,
    pub owners: Vec<Owner>,
    /// Not divided while it has no more entries than this: raised when no bit divides it well.
    capacity: usize,
}

/// A bit divides a leaf well if the smaller part gets at least one entry in this many.
const WORST_DIVISION: usize = 8;

impl Leaf {
    fn empty(capacity: usize) -> Self {
        Self { capacity, ..Self::default() }
    }

    fn push(&mut self, descriptor: Descriptor, owner: Owner) {
        self.descriptors.push(descriptor);
        self.owners.push(owner);
    }

    fn retain(&mut self, is_alive: &impl Fn(u32) -> bool) {
        let mut n = 0;
        for i in 0..self.owners.len() {
            if is_alive(self.owners[i].slot) {
                (self.descriptors[n], self.owners[n]) = (self.descriptors[i], self.owners[i]);
                n += 1;
            }
        }
        self.descriptors.truncate(n);
        self.owners.truncate(n);
    }

    /// The bit that comes closest to dividing the entries in halves, if it does so well enough.
    fn dividing_bit(&self, bits: impl Iterator<Item = u32>) -> Option<u32> {
        let n = self.descriptors.len();
        let smaller_part = |bit: u32| {
            let n_set = self.descriptors.iter().filter(|d| d.bit(bit)).count();
            n_set.min(n - n_set)
        };
        // Of equal bits the first.
        let (best, bit) = bits.map(|bit| (smaller_part(bit), std::cmp::Reverse(bit))).max()?;
        (best * WORST_DIVISION >= n).then_some(bit.0)
    }
}

impl Tree {
    pub fn new(first_bit: u32, bit_step: u32, max_leaf_size: usize) -> Self {
        Self { nodes: vec![Node::Leaf(Leaf::empty(max_leaf_size))], first_bit, bit_step, max_leaf_size }
    }

    /// The leaf a descriptor belongs to.
    pub fn leaf(&self, descriptor: &Descriptor) -> &Leaf {
        let mut idx = 0;
        loop {
            match &self.nodes[idx] {
                Node::Split { bit, children } => idx = children[usize::from(descriptor.bit(*bit))] as usize,
                Node::Leaf(leaf) => return leaf,
            }
        }
    }

    /// Adds an entry. Entries of images that are no longer alive are dropped from a leaf before it is
    /// divided.
    pub fn insert(&mut self, descriptor: Descriptor, owner: Owner, is_alive: &impl Fn(u32) -> bool) {
        let mut idx = 0;
        loop {
            match &mut self.nodes[idx] {
                Node::Split { bit, children } => idx = children[usize::from(descriptor.bit(*bit))] as usize,
                Node::Leaf(leaf) => {
                    leaf.push(descriptor, owner);
                    if leaf.descriptors.len() > leaf.capacity {
                        leaf.retain(is_alive);
                        if leaf.descriptors.len() > leaf.capacity {
                            self.divide(idx);
                        }
                    }
                    return;
                }
            }
        }
    }

    fn divide(&mut self, idx: usize) {
        let bits = (self.first_bit..Descriptor::N_BITS).step_by(self.bit_step as usize);
        let Node::Leaf(leaf) = &mut self.nodes[idx] else { return };
        let Some(bit) = leaf.dividing_bit(bits) else {
            leaf.capacity = 2 * leaf.descriptors.len();
            return;
        };
        let whole = std::mem::take(leaf);
        let mut parts = [Leaf::empty(self.max_leaf_size), Leaf::empty(self.max_leaf_size)];
        for (descriptor, owner) in whole.descriptors.into_iter().zip(whole.owners) {
            parts[usize::from(descriptor.bit(bit))].push(descriptor, owner);
        }
        let first = self.nodes.len() as u32;
        self.nodes.extend(parts.map(Node::Leaf));
        self.nodes[idx] = Node::Split { bit, children: [first, first + 1] };
    }

    /// Drops the entries of images that are no longer alive, and joins leaves that have become small.
    pub fn compact(&mut self, is_alive: &impl Fn(u32) -> bool) {
        let mut old = std::mem::take(&mut self.nodes);
        self.nodes.push(Node::Leaf(Leaf::default()));
        self.nodes[0] = self.compacted(&mut old, 0, is_alive);
    }

    /// The compacted form of the old tree's node `idx`; what lies below it is appended to `self.nodes`.
    ///
    /// The depth of recursion is that of the tree: at most the number of bits, for each is asked only once on
    /// a path.
    fn compacted(&mut self, old: &mut [Node], idx: usize, is_alive: &impl Fn(u32) -> bool) -> Node {
        let (bit, children) = match &mut old[idx] {
            Node::Leaf(leaf) => {
                let mut leaf = std::mem::take(leaf);
                leaf.retain(is_alive);
                leaf.capacity = self.max_leaf_size.max(leaf.descriptors.len());
                return Node::Leaf(leaf);
            }
            Node::Split { bit, children } => (*bit, *children),
        };
        let parts = children.map(|child| self.compacted(old, child as usize, is_alive));
        match parts {
            // Half of what a leaf may hold, so that the next few entries do not divide it again.
            [Node::Leaf(mut a), Node::Leaf(b)]
                if a.descriptors.len() + b.descriptors.len() <= self.max_leaf_size / 2 =>
            {
                a.descriptors.extend(b.descriptors);
                a.owners.extend(b.owners);
                a.capacity = self.max_leaf_size;
                Node::Leaf(a)
            }
            parts => {
                let first = self.nodes.len() as u32;
                self.nodes.extend(parts);
                Node::Split { bit, children: [first, first + 1] }
            }
        }
    }

    /// Number of entries, alive or not.
    #[cfg(test)]
    pub fn n_entries(&self) -> usize {
        let size = |node: &Node| if let Node::Leaf(leaf) = node { leaf.descriptors.len() } else { 0 };
        self.nodes.iter().map(size).sum()
    }

    #[cfg(test)]
    pub fn n_nodes(&self) -> usize {
        self.nodes.len()
    }
}
