//! Keypoint distribution, choosing corners so that they cover the image: a quadtree, grown until it has as
//! many leaves as corners are wanted.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::fast::Corner;

/// Keeps at most `quota` of `corners`, which lie in an image of `width` x `height` pixels.
///
/// The image is cut into squares, squares with more than one corner into quarters, and so on, all of one size
/// before any smaller one and of equal ones the fullest first, until `spread_share * quota` are occupied.
/// Each keeps its strongest corner; the rest of the quota goes to the strongest of all others. Reorders
/// `corners`; what is kept comes in reading order.
pub(super) fn spread(
    corners: &mut [Corner],
    width: u32,
    height: u32,
    quota: usize,
    spread_share: f32,
    kept: &mut Vec<Corner>,
) {
    kept.clear();
    if corners.len() <= quota {
        kept.extend_from_slice(corners);
    } else if quota > 0 {
        let n_leaves = (quota as f32 * spread_share).ceil() as usize;
        let mut leaves = Leaves::default();
        plant(corners, width, height, &mut leaves);
        while leaves.len() < n_leaves {
            let Some(Divisible(cell)) = leaves.divisible.pop() else { break };
            for quarter in cell.quarters(corners).into_iter().flatten() {
                leaves.push(quarter);
            }
        }
        // The roots may be more than wanted, and so may the quarters of the last division.
        kept.extend(leaves.cells().map(|cell| corners[bring_strongest_first(cell, corners)]));
        keep_strongest(kept, quota);
        let n_spread = kept.len();
        if n_spread < quota {
            let others = |cell: &Cell| cell.start + 1..cell.end;
            kept.extend(leaves.cells().flat_map(others).map(|i| corners[i]));
            let rest = &mut kept[n_spread..];
            let n_rest = (quota - n_spread).min(rest.len());
            if n_rest > 0 && n_rest < rest.len() {
                rest.select_nth_unstable_by_key(n_rest - 1, strength);
            }
            kept.truncate(n_spread + n_rest);
        }
    }
    kept.sort_unstable_by_key(|c| (c.y, c.x));
}

/// Sorts the strongest to the front; of equal ones the first in reading order.
fn strength(corner: &Corner) -> (Reverse<u8>, u16, u16) {
    (Reverse(corner.score), corner.y, corner.x)
}

fn keep_strongest(corners: &mut Vec<Corner>, n: usize) {
    if corners.len() > n {
        corners.select_nth_unstable_by_key(n, strength);
        corners.truncate(n);
    }
}

/// Occupied squares: those holding one corner, and those that can be divided further.
#[derive(Default)]
struct Leaves {
    single: Vec<Cell>,
    divisible: BinaryHeap<Divisible>,
}

impl Leaves {
    fn len(&self) -> usize {
        self.single.len() + self.divisible.len()
    }

    fn cells(&self) -> impl Iterator<Item = &Cell> {
        self.single.iter().chain(self.divisible.iter().map(|Divisible(cell)| cell))
    }

    fn push(&mut self, cell: Cell) {
        if cell.len() == 1 || cell.side < 2 {
            self.single.push(cell);
        } else if cell.len() > 1 {
            self.divisible.push(Divisible(cell));
        }
    }
}

/// A square holding `corners[start..end]`.
#[derive(Clone, Copy, Debug)]
struct Cell {
    left: u32,
    top: u32,
    side: u32,
    start: usize,
    end: usize,
}

/// A cell in the order of division: the largest, then the fullest, then the first in reading order.
struct Divisible(Cell);

impl Divisible {
    fn key(&self) -> (u32, usize, Reverse<(u32, u32)>) {
        (self.0.side, self.0.len(), Reverse((self.0.top, self.0.left)))
    }
}

impl PartialEq for Divisible {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Eq for Divisible {}

impl PartialOrd for Divisible {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Divisible {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key().cmp(&other.key())
    }
}

/// The first squares: one row or column of them, as wide as the image's short side.
fn plant(corners: &mut [Corner], width: u32, height: u32, leaves: &mut Leaves) {
    let side = width.min(height).max(1);
    let mut start = 0;
    for step in 0..width.max(height).div_ceil(side) {
        let (left, top) = if width > height { (step * side, 0) } else { (0, step * side) };
        let rest = &mut corners[start..];
        let n = partition(rest, |c| u32::from(c.x) < left + side && u32::from(c.y) < top + side);
        leaves.push(Cell { left, top, side, start, end: start + n });
        start += n;
    }
}

impl Cell {
    fn len(&self) -> usize {
        self.end - self.start
    }

    /// Its occupied quarters; reorders its corners.
    fn quarters(&self, corners: &mut [Corner]) -> [Option<Cell>; 4] {
        let half = self.side.div_ceil(2);
        let (middle_x, middle_y) = (self.left + half, self.top + half);
        let corners = &mut corners[self.start..self.end];
        let upper = partition(corners, |c| u32::from(c.y) < middle_y);
        let upper_left = partition(&mut corners[..upper], |c| u32::from(c.x) < middle_x);
        let lower_left = partition(&mut corners[upper..], |c| u32::from(c.x) < middle_x);
        let cuts = [0, upper_left, upper, upper + lower_left, corners.len()].map(|cut| self.start + cut);
        let origins =
            [(self.left, self.top), (middle_x, self.top), (self.left, middle_y), (middle_x, middle_y)];
        std::array::from_fn(|i| {
            let (start, end) = (cuts[i], cuts[i + 1]);
            let (left, top) = origins[i];
            (start < end).then_some(Cell { left, top, side: half, start, end })
        })
    }
}

/// Moves the corners that satisfy `first` to the front and returns their number.
fn partition(corners: &mut [Corner], first: impl Fn(&Corner) -> bool) -> usize {
    let mut n = 0;
    for i in 0..corners.len() {
        // Swapping always, counting sometimes: no branch to mispredict.
        corners.swap(i, n);
        n += usize::from(first(&corners[n]));
    }
    n
}

/// Moves a cell's strongest corner to the cell's front and returns its index.
fn bring_strongest_first(cell: &Cell, corners: &mut [Corner]) -> usize {
    let corners = &mut corners[cell.start..cell.end];
    let strongest = (0..corners.len()).min_by_key(|&i| strength(&corners[i]));
    corners.swap(0, strongest.unwrap_or(0));
    cell.start
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::Random;

    fn corner(x: u16, y: u16, score: u8) -> Corner {
        Corner { x, y, score, ..Corner::default() }
    }

    fn random_corners(n: usize, width: u32, height: u32, seed: u64) -> Vec<Corner> {
        let mut random = Random::new(seed);
        let mut corners: Vec<Corner> = (0..n)
            .map(|_| Corner {
                x: random.below(width) as u16,
                y: random.below(height) as u16,
                score: 8 + random.below(200) as u8,
                ..Corner::default()
            })
            .collect();
        corners.sort_by_key(|c| (c.y, c.x));
        corners.dedup_by_key(|c| (c.y, c.x));
        corners
    }

    #[test]
    fn exactly_the_quota_is_kept_where_there_is_enough() {
        for (width, height) in [(640, 480), (480, 640), (1241, 376), (100, 100)] {
            let corners = random_corners(3000, width, height, 5);
            for (quota, share) in
                [(0, 1.0), (1, 1.0), (2, 0.5), (7, 0.3), (100, 0.0), (999, 1.0), (2500, 0.7)]
            {
                let mut kept = Vec::new();
                spread(&mut corners.clone(), width, height, quota, share, &mut kept);
                assert_eq!(kept.len(), quota, "{width}x{height}");
                assert!(kept.windows(2).all(|w| (w[0].y, w[0].x) < (w[1].y, w[1].x)), "unsorted or repeated");
                assert!(kept.iter().all(|c| corners.contains(c)));
            }
        }
    }

    #[test]
    fn all_are_kept_where_there_are_too_few() {
        let corners = random_corners(50, 640, 480, 6);
        let mut kept = Vec::new();
        spread(&mut corners.clone(), 640, 480, 51, 1.0, &mut kept);
        assert_eq!(kept, corners);
        spread(&mut [], 640, 480, 10, 1.0, &mut kept);
        assert!(kept.is_empty());
    }

    #[test]
    fn a_thin_half_is_not_starved_by_a_crowded_one() {
        // 5000 corners crowd the left half, 60 weak ones stand in the right.
        let mut corners = random_corners(5000, 320, 480, 7);
        for corner in random_corners(60, 320, 480, 8) {
            corners.push(Corner { x: corner.x + 320, score: 8, ..corner });
        }
        let mut kept = Vec::new();
        spread(&mut corners, 640, 480, 200, 1.0, &mut kept);
        let n_right = kept.iter().filter(|c| c.x >= 320).count();
        // By area it is due half of the leaves, of which many are empty there; by strength it would get none.
        assert!(n_right >= 25, "only {n_right} of 60");
    }

    #[test]
    fn the_strongest_of_a_square_is_the_one_kept() {
        let mut corners = vec![corner(10, 10, 30), corner(12, 11, 90), corner(600, 400, 20)];
        let mut kept = Vec::new();
        spread(&mut corners, 640, 480, 2, 1.0, &mut kept);
        assert_eq!(kept, [corner(12, 11, 90), corner(600, 400, 20)]);
    }
}
