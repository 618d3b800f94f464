//! Joining pieces of one line across gaps: where another edge crosses, or something thin stands in front.

use nalgebra::Vector2;

use super::pieces::Piece;
use crate::lines::select::Ends;

/// Widest gap that is bridged, pixels: the longest jump of ELSED is 9.
const MAX_GAP_PX: f32 = 10.0;
/// So much may the pieces overlap, pixels.
const MAX_OVERLAP_PX: f32 = 4.0;
/// A gap is at most this multiple of the shorter piece's length.
const MAX_GAP_SHARE: f32 = 0.5;
/// The next piece begins at most this far beside the line, pixels.
const MAX_OFFSET_PX: f32 = 1.5;
/// Cosine of the largest angle between pieces of one line: 8 degrees, that of a pixel in seven.
const MIN_COSINE: f32 = 0.99;
/// The pixels of both pieces together stray at most this from one line, squared pixels.
const MAX_VARIANCE: f64 = 0.45 * 0.45;
/// Each end of each piece lies at most this far from that line, pixels.
const MAX_END_DISTANCE_PX: f64 = 1.0;

/// Joins pieces; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Bridger {
    /// Pieces by where they start: the first of each cell of the grid, and the next after each piece.
    first: Vec<u32>,
    next: Vec<u32>,
    columns: usize,
    rows: usize,
    alive: Vec<bool>,
}

/// Side of the grid's cells, pixels: as wide as the farthest start looked for, so that it is in a
/// neighboring cell.
const CELL_PX: f32 = 12.0;
const NONE: u32 = u32::MAX;

impl Bridger {
    /// Joins what belongs to one line. The order of what remains is kept.
    pub fn join(&mut self, pieces: &mut Vec<Piece>) {
        self.index_starts(pieces);
        for i in 0..pieces.len() {
            // Each turn of the inner loop ends the life of one piece.
            while self.alive[i]
                && let Some((other, joined)) = self.continuation(pieces, i)
            {
                pieces[i] = joined;
                self.alive[other] = false;
            }
        }
        let mut alive = self.alive.iter();
        pieces.retain(|_| alive.next().copied().unwrap_or(false));
    }

    fn index_starts(&mut self, pieces: &[Piece]) {
        let far = pieces.iter().fold(Vector2::repeat(0.0f32), |far, piece| far.sup(&piece.ends.start));
        self.columns = (far.x / CELL_PX) as usize + 1;
        self.rows = (far.y / CELL_PX) as usize + 1;
        self.first.clear();
        self.first.resize(self.columns * self.rows, NONE);
        self.next.clear();
        self.alive.clear();
        self.alive.resize(pieces.len(), true);
        for (i, piece) in pieces.iter().enumerate() {
            let cell = self.cell_of(piece.ends.start);
            let slot = &mut self.first[cell.1 * self.columns + cell.0];
            self.next.push(*slot);
            *slot = i as u32;
        }
    }

    /// Column and row of a point.
    fn cell_of(&self, point: Vector2<f32>) -> (usize, usize) {
        let index = |v: f32, n: usize| ((v / CELL_PX).max(0.0) as usize).min(n - 1);
        (index(point.x, self.columns), index(point.y, self.rows))
    }

    /// The piece that goes on nearest to where piece `i` ends, and both joined.
    fn continuation(&self, pieces: &[Piece], i: usize) -> Option<(usize, Piece)> {
        let piece = &pieces[i];
        let (column, row) = self.cell_of(piece.ends.end);
        let mut best: Option<(f32, usize, Piece)> = None;
        for y in row.saturating_sub(1)..(row + 2).min(self.rows) {
            for x in column.saturating_sub(1)..(column + 2).min(self.columns) {
                let mut at = self.first[y * self.columns + x];
                while at != NONE {
                    let other = at as usize;
                    at = self.next[other];
                    if other == i || !self.alive[other] {
                        continue;
                    }
                    let Some((gap, joined)) = join_pair(piece, &pieces[other]) else { continue };
                    let nearer = best.as_ref().is_none_or(|&(least, rival, _)| (gap, other) < (least, rival));
                    if nearer {
                        best = Some((gap, other, joined));
                    }
                }
            }
        }
        best.map(|(_, other, joined)| (other, joined))
    }
}

/// Both pieces as one, and the gap between them, pixels; `None` if `after` does not go on where `before`
/// ends.
fn join_pair(before: &Piece, after: &Piece) -> Option<(f32, Piece)> {
    let (vector, other) = (before.ends.end - before.ends.start, after.ends.end - after.ends.start);
    let (length, other_length) = (vector.norm(), other.norm());
    let direction = vector / length;
    let step = after.ends.start - before.ends.end;
    let (gap, offset) = (step.dot(&direction), direction.perp(&step));
    let widest = MAX_GAP_PX.min(MAX_GAP_SHARE * length.min(other_length));
    if !(-MAX_OVERLAP_PX..=widest).contains(&gap)
        || offset.abs() > MAX_OFFSET_PX
        || vector.dot(&other) < MIN_COSINE * length * other_length
    {
        return None;
    }
    let moments = before.moments.merged(&after.moments);
    let line = moments.fit().directed_like(direction);
    let ends = [before.ends.start, before.ends.end, after.ends.start, after.ends.end];
    if line.variance > MAX_VARIANCE || ends.iter().any(|&end| line.distance(end).abs() > MAX_END_DISTANCE_PX)
    {
        return None;
    }
    let along = |point: Vector2<f32>| line.at(line.along(point));
    Some((
        gap.abs(),
        Piece { ends: Ends { start: along(before.ends.start), end: along(after.ends.end) }, moments },
    ))
}
