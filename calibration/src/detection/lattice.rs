//! Joins saddles into the lattice of a board.

use super::saddles::Saddle;
use crate::Board;
use geometry::nalgebra::Vector2;
use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// A neighbor lies along an edge to this, radians.
const ALONG_EDGE: f64 = 0.3;
/// Bright and dark take turns from corner to corner: to this, radians.
const TURNED: f64 = 0.6;
/// Neighbors are looked for among so many nearest saddles.
const N_NEAREST: usize = 40;

type Place = (i32, i32);

/// The corners of the board in its order, pixels; `None` if there is no whole board.
pub fn find(saddles: &[Saddle], board: &Board) -> Option<Vec<Vector2<f64>>> {
    let neighbors: Vec<[Option<usize>; 4]> =
        (0..saddles.len()).map(|from| neighbors(saddles, from)).collect();
    let mut is_used = vec![false; saddles.len()];
    for seed in 0..saddles.len() {
        if is_used[seed] {
            continue;
        }
        let lattice = grow(saddles, &neighbors, seed);
        lattice.values().for_each(|idx| is_used[*idx] = true);
        if let Some(corners) = whole_board(&lattice, saddles, board) {
            return Some(corners);
        }
    }
    None
}

/// The difference of two angles, -π to π.
fn difference(a: f64, b: f64) -> f64 {
    (a - b + PI).rem_euclid(TAU) - PI
}

/// Along each of a saddle's edges the nearest saddle that the edge leads to.
fn neighbors(saddles: &[Saddle], from: usize) -> [Option<usize>; 4] {
    let here = &saddles[from];
    let mut near: Vec<(f64, usize)> = (0..saddles.len())
        .filter(|idx| *idx != from)
        .map(|idx| ((saddles[idx].place - here.place).norm(), idx))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.truncate(N_NEAREST);
    here.edges.map(|edge| {
        let fits = |idx: usize| {
            let there = &saddles[idx];
            let way = there.place - here.place;
            let angle = way.y.atan2(way.x);
            let comes_back = there.edges.iter().any(|back| difference(*back, angle + PI).abs() < ALONG_EDGE);
            // Modulo half a turn.
            let turn = (there.bright - here.bright).rem_euclid(PI);
            difference(angle, edge).abs() < ALONG_EDGE && comes_back && (turn - FRAC_PI_2).abs() < TURNED
        };
        near.iter().map(|(_, idx)| *idx).find(|idx| fits(*idx))
    })
}

/// The places of all saddles that hang together with one, which is at the origin. Its first edge is the x
/// axis, the next in the image's sense of rotation the y axis.
fn grow(saddles: &[Saddle], neighbors: &[[Option<usize>; 4]], seed: usize) -> BTreeMap<Place, usize> {
    let mut lattice = BTreeMap::from([((0, 0), seed)]);
    let mut places = BTreeMap::from([(seed, (0, 0))]);
    // With each saddle, which of its edges is the x axis.
    let mut waiting = VecDeque::from([(seed, 0usize)]);
    while let Some((from, x_axis)) = waiting.pop_front() {
        let (x, y) = places[&from];
        for (direction, (dx, dy)) in [(1, 0), (0, 1), (-1, 0), (0, -1)].into_iter().enumerate() {
            let Some(to) = neighbors[from][(x_axis + direction) % 4] else { continue };
            if neighbors[to].iter().all(|back| *back != Some(from)) {
                continue;
            }
            let place = (x + dx, y + dy);
            if lattice.contains_key(&place) || places.contains_key(&to) {
                continue;
            }
            let way = saddles[to].place - saddles[from].place;
            let off = |edge: usize| difference(saddles[to].edges[edge], way.y.atan2(way.x)).abs();
            let onwards = (0..4).min_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or(0);
            lattice.insert(place, to);
            places.insert(to, place);
            waiting.push_back((to, (onwards + 4 - direction) % 4));
        }
    }
    lattice
}

/// A part of the lattice as large as the board without gaps, if there is one; of several the strongest.
fn whole_board(
    lattice: &BTreeMap<Place, usize>,
    saddles: &[Saddle],
    board: &Board,
) -> Option<Vec<Vector2<f64>>> {
    if lattice.len() < board.n_corners() {
        return None;
    }
    let (columns, rows) = (board.columns() as i32, board.rows() as i32);
    let mut best: Option<(f32, Vec<usize>)> = None;
    for is_turned in [false, true] {
        // The board's corner in column c and row r lies in the lattice at the origin plus this.
        let step = |c: i32, r: i32| if is_turned { (rows - 1 - r, c) } else { (c, r) };
        for origin in lattice.keys() {
            let at = |c: i32, r: i32| {
                let (x, y) = step(c, r);
                lattice.get(&(origin.0 + x, origin.1 + y)).copied()
            };
            let corners: Option<Vec<usize>> =
                (0..rows).flat_map(|r| (0..columns).map(move |c| (c, r))).map(|(c, r)| at(c, r)).collect();
            let Some(corners) = corners else { continue };
            let weakest = corners.iter().map(|idx| saddles[*idx].strength).fold(f32::MAX, f32::min);
            if best.as_ref().is_none_or(|(strength, _)| weakest > *strength) {
                best = Some((weakest, corners));
            }
        }
        if columns == rows {
            break;
        }
    }
    best.map(|(_, corners)| corners.iter().map(|idx| saddles[*idx].place).collect())
}
