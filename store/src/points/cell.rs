//! The grid cells that stand for points and lines in the R*Trees.
//!
//! Bundle adjustment moves thousands of points a little, and moving an entry of the tree costs ten times what
//! rewriting a row does. So the tree holds the cell of a grid the point lies in: a point that stays in its
//! cell leaves the tree alone. Cells grow with the distance the point is seen from, as its uncertainty does.
//! The cell depends on the point's row alone, not on its past. Lines stand as the cells from one end to the
//! other.

use nalgebra::Vector3;

/// Side of a cell as a share of the distance the point can be seen from, before it is rounded down to a power
/// of two. A sixteenth: corrections of a settled map are some hundredths of that, and queries of a room are
/// still sharp.
const SIDE_SHARE: f64 = 1.0 / 16.0;

/// The same for a line, as a share of its length. A quarter: the box of a slanting line is far larger than
/// the line.
const SIDE_SHARE_OF_LENGTH: f64 = 1.0 / 4.0;

/// Bits of a key that hold the point's id; the session's number is above them.
const POINT_BITS: u32 = 40;

/// Greatest id of a point or line that has room in a key.
pub(crate) const MAX_POINT_ID: u64 = (1 << POINT_BITS) - 1;

/// The R*Tree's key of a point or line; `point` is at most [`MAX_POINT_ID`].
pub(crate) fn cell_key(session: i64, point: i64) -> i64 {
    session << POINT_BITS | point
}

/// The id of the point a key stands for.
pub(crate) fn point_of_key(key: i64) -> i64 {
    key & MAX_POINT_ID as i64
}

/// A box that contains a point, by axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cell {
    pub low: [f64; 3],
    pub high: [f64; 3],
}

impl Cell {
    /// The cell of a point that can be seen from up to `max_distance`. The point itself where that is no
    /// usable number.
    pub fn of(position: &Vector3<f64>, max_distance: f64) -> Self {
        Self::of_side(position, max_distance * SIDE_SHARE)
    }

    /// The cells from one end of a line to the other. A line's uncertainty grows with its length as a point's
    /// with its distance.
    pub fn of_ends([start, end]: &[Vector3<f64>; 2]) -> Self {
        let side = (end - start).norm() * SIDE_SHARE_OF_LENGTH;
        let (a, b) = (Self::of_side(start, side), Self::of_side(end, side));
        Self {
            low: std::array::from_fn(|axis| a.low[axis].min(b.low[axis])),
            high: std::array::from_fn(|axis| a.high[axis].max(b.high[axis])),
        }
    }

    fn of_side(position: &Vector3<f64>, greatest_side: f64) -> Self {
        let side = power_of_two_up_to(greatest_side);
        let low = |x: f64| side.map_or(x, |side| (x / side).floor() * side);
        let high = |x: f64| side.map_or(x, |side| ((x / side).floor() + 1.0) * side);
        let p: [f64; 3] = (*position).into();
        Self { low: p.map(low), high: p.map(high) }
    }
}

/// The greatest power of two that is not greater; `None` unless positive, finite and of full precision.
fn power_of_two_up_to(value: f64) -> Option<f64> {
    const SIGN_AND_EXPONENT: u64 = 0xfff << 52;
    (value.is_normal() && value > 0.0).then(|| f64::from_bits(value.to_bits() & SIGN_AND_EXPONENT))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_of_two() {
        let cases = [(1.0, 1.0), (1.999, 1.0), (2.0, 2.0), (0.3, 0.25), (1e-9, 2f64.powi(-30))];
        cases.iter().for_each(|(value, power)| assert_eq!(power_of_two_up_to(*value), Some(*power)));
        [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-310]
            .iter()
            .for_each(|x| assert_eq!(power_of_two_up_to(*x), None));
    }

    #[test]
    fn a_cell_contains_its_point_and_keeps_a_point_that_moves_little() {
        let position = Vector3::new(1.26, -0.01, 1e6);
        let cell = Cell::of(&position, 8.0);
        assert_eq!((cell.low, cell.high), ([1.0, -0.5, 1e6], [1.5, 0.0, 1e6 + 0.5]));
        assert_eq!(Cell::of(&(position + Vector3::new(0.1, -0.1, 0.1)), 8.9), cell);
        assert_ne!(Cell::of(&(position + Vector3::new(0.0, 0.02, 0.0)), 8.0), cell);
        let unknown = Cell::of(&position, f64::INFINITY);
        assert_eq!((unknown.low, unknown.high), (position.into(), position.into()));
    }

    #[test]
    fn a_lines_cells_reach_from_end_to_end() {
        let ends = [Vector3::new(0.1, 0.0, 2.0), Vector3::new(-1.3, 0.0, 3.5)];
        let cell = Cell::of_ends(&ends);
        assert_eq!((cell.low, cell.high), ([-1.5, 0.0, 2.0], [0.5, 0.5, 4.0]));
        let without_length = Cell::of_ends(&[ends[0]; 2]);
        assert_eq!((without_length.low, without_length.high), (ends[0].into(), ends[0].into()));
    }

    #[test]
    fn keys_hold_both_numbers() {
        let key = cell_key(8_388_607, MAX_POINT_ID as i64);
        assert!(key > 0);
        assert_eq!(point_of_key(key), MAX_POINT_ID as i64);
        assert!(cell_key(2, 1) > cell_key(1, MAX_POINT_ID as i64));
    }
}
