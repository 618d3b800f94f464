//! Keypoints sorted into cells (a spatial hash), so that those near a place are found without looking at all.

use std::ops::RangeInclusive;

use crate::Keypoint;

/// The rectangle a [`KeypointGrid`] covers, pixels. Undistorted coordinates may well be negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridBounds {
    /// Left edge.
    pub min_x: f32,
    /// Top edge.
    pub min_y: f32,
    /// Right edge.
    pub max_x: f32,
    /// Bottom edge.
    pub max_y: f32,
}

impl GridBounds {
    /// The bounds of an image of this size.
    pub fn of_image(width: u32, height: u32) -> Self {
        Self { min_x: 0.0, min_y: 0.0, max_x: width as f32, max_y: height as f32 }
    }
}

/// Cells along x; with [`N_ROWS`] about 10 x 10 px each at 640x480.
const N_COLUMNS: usize = 64;
/// Cells along y.
const N_ROWS: usize = 48;

/// Positions (and octaves) in a 64 x 48 grid of cells, stored cell after cell.
///
/// Positions outside the bounds are kept in the nearest border cell and found like all others; positions that
/// are not finite are left out.
#[derive(Clone, Debug)]
pub struct KeypointGrid {
    bounds: GridBounds,
    cells_per_px: (f32, f32),
    /// Entries of cell `c` are `entries[cell_starts[c]..cell_starts[c + 1]]`.
    cell_starts: Vec<u32>,
    entries: Vec<Entry>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    x: f32,
    y: f32,
    idx: u32,
    octave: u8,
}

impl KeypointGrid {
    /// A grid over `positions` (x, y), all taken to be of octave 0.
    pub fn build(positions: &[(f32, f32)], bounds: GridBounds) -> Self {
        Self::from_entries(positions.iter().map(|&(x, y)| (x, y, 0)), bounds)
    }

    /// A grid over keypoints where they were detected.
    pub fn from_keypoints(keypoints: &[Keypoint], bounds: GridBounds) -> Self {
        Self::from_entries(keypoints.iter().map(|k| (k.x, k.y, k.octave)), bounds)
    }

    /// A grid over `(x, y, octave)`, for example undistorted positions of keypoints.
    pub fn from_entries(
        entries: impl ExactSizeIterator<Item = (f32, f32, u8)> + Clone,
        bounds: GridBounds,
    ) -> Self {
        let per_px = |n: usize, from: f32, to: f32| {
            let cells = n as f32 / (to - from);
            if cells.is_finite() && cells > 0.0 { cells } else { 0.0 }
        };
        let mut grid = Self {
            bounds,
            cells_per_px: (
                per_px(N_COLUMNS, bounds.min_x, bounds.max_x),
                per_px(N_ROWS, bounds.min_y, bounds.max_y),
            ),
            cell_starts: vec![0; N_COLUMNS * N_ROWS + 1],
            entries: Vec::new(),
        };
        let finite = |&(_, (x, y, _)): &(usize, (f32, f32, u8))| x.is_finite() && y.is_finite();
        // Counting sort by cell: count, sum up, place.
        for (_, (x, y, _)) in entries.clone().enumerate().filter(finite) {
            let cell = grid.cell(x, y);
            grid.cell_starts[cell + 1] += 1;
        }
        for cell in 0..N_COLUMNS * N_ROWS {
            grid.cell_starts[cell + 1] += grid.cell_starts[cell];
        }
        let mut next = grid.cell_starts.clone();
        grid.entries = vec![Entry::default(); grid.cell_starts[N_COLUMNS * N_ROWS] as usize];
        for (idx, (x, y, octave)) in entries.enumerate().filter(finite) {
            let cell = grid.cell(x, y);
            grid.entries[next[cell] as usize] = Entry { x, y, idx: idx as u32, octave };
            next[cell] += 1;
        }
        grid
    }

    /// Number of positions held.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether no position is held.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Puts into `out` (cleared first) the indices of all positions with `|dx| <= radius` and `|dy| <=
    /// radius` whose octave is in `octaves`, in a fixed order. A window that is not finite finds nothing.
    pub fn query_window(&self, x: f32, y: f32, radius: f32, octaves: RangeInclusive<u8>, out: &mut Vec<u32>) {
        out.clear();
        self.for_each_in_window(x, y, radius, octaves, |idx| out.push(idx));
    }

    /// As [`KeypointGrid::query_window`], calling `visit` with each index instead.
    #[inline(always)]
    pub fn for_each_in_window(
        &self,
        x: f32,
        y: f32,
        radius: f32,
        octaves: RangeInclusive<u8>,
        mut visit: impl FnMut(u32),
    ) {
        if !(x.is_finite() && y.is_finite() && radius.is_finite() && radius >= 0.0) {
            return;
        }
        let (first_column, last_column) = (self.column(x - radius), self.column(x + radius));
        for row in self.row(y - radius)..=self.row(y + radius) {
            // Cells of one row are neighbors in memory: one run of entries covers them all.
            let from = self.cell_starts[row * N_COLUMNS + first_column] as usize;
            let to = self.cell_starts[row * N_COLUMNS + last_column + 1] as usize;
            for entry in &self.entries[from..to] {
                let inside = (entry.x - x).abs() <= radius && (entry.y - y).abs() <= radius;
                if inside && octaves.contains(&entry.octave) {
                    visit(entry.idx);
                }
            }
        }
    }

    fn cell(&self, x: f32, y: f32) -> usize {
        self.row(y) * N_COLUMNS + self.column(x)
    }

    // A float too large or negative saturates when cast, so positions outside fall into the border cells.
    fn column(&self, x: f32) -> usize {
        (((x - self.bounds.min_x) * self.cells_per_px.0) as usize).min(N_COLUMNS - 1)
    }

    fn row(&self, y: f32) -> usize {
        (((y - self.bounds.min_y) * self.cells_per_px.1) as usize).min(N_ROWS - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A small generator, so that the test needs no dependency: the 64-bit LCG of Knuth.
    fn random(state: &mut u64) -> f32 {
        *state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (*state >> 40) as f32 / (1u64 << 24) as f32
    }

    #[test]
    fn windows_hold_what_a_search_over_all_finds() {
        let mut seed = 7;
        let bounds = GridBounds { min_x: -20.0, min_y: -10.0, max_x: 660.0, max_y: 490.0 };
        let entries: Vec<(f32, f32, u8)> = (0..2000)
            .map(|_| {
                // Some positions fall outside the bounds.
                let (x, y) = (random(&mut seed) * 760.0 - 60.0, random(&mut seed) * 560.0 - 40.0);
                (x, y, (random(&mut seed) * 8.0) as u8)
            })
            .collect();
        let grid = KeypointGrid::from_entries(entries.iter().copied(), bounds);
        assert_eq!(grid.len(), entries.len());
        let mut found = Vec::new();
        for _ in 0..500 {
            let (x, y) = (random(&mut seed) * 800.0 - 80.0, random(&mut seed) * 600.0 - 60.0);
            let radius = random(&mut seed) * 60.0;
            let low = (random(&mut seed) * 4.0) as u8;
            grid.query_window(x, y, radius, low..=low + 3, &mut found);
            found.sort_unstable();
            let expected: Vec<u32> = (0..entries.len() as u32)
                .filter(|&i| {
                    let (px, py, octave) = entries[i as usize];
                    (px - x).abs() <= radius && (py - y).abs() <= radius && (low..=low + 3).contains(&octave)
                })
                .collect();
            assert_eq!(found, expected);
        }
    }

    #[test]
    fn what_is_not_finite_is_neither_kept_nor_found() {
        let bounds = GridBounds::of_image(640, 480);
        let grid = KeypointGrid::build(&[(f32::NAN, 1.0), (5.0, f32::INFINITY), (5.0, 5.0)], bounds);
        assert_eq!(grid.len(), 1);
        let mut found = vec![9];
        grid.query_window(5.0, 5.0, 1.0, 0..=0, &mut found);
        assert_eq!(found, [2]);
        for (x, radius) in [(f32::NAN, 1.0), (5.0, f32::NAN), (5.0, -1.0), (5.0, f32::INFINITY)] {
            grid.query_window(x, 5.0, radius, 0..=0, &mut found);
            assert!(found.is_empty());
        }
    }

    #[test]
    fn bounds_without_extent_still_work() {
        let bounds = GridBounds { min_x: 3.0, min_y: 3.0, max_x: 3.0, max_y: f32::NAN };
        let grid = KeypointGrid::build(&[(3.0, 3.0), (4.0, 9.0)], bounds);
        let mut found = Vec::new();
        grid.query_window(4.0, 9.0, 0.5, 0..=0, &mut found);
        assert_eq!(found, [1]);
    }
}
