//! Which of the segments found are kept: long ones, off the border, spread over the image.

use nalgebra::Vector2;

use crate::lines::Segment;
use crate::lines::clip::Frame;

/// Start and end of a segment, pixels, brighter side to the right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ends {
    pub start: Vector2<f32>,
    pub end: Vector2<f32>,
}

impl Ends {
    pub fn length(&self) -> f32 {
        (self.end - self.start).norm()
    }
}

/// Squares of the grid along the longer side of the frame, over which segments are spread: in an image of 640
/// x 480 they have 80 pixels, and 200 segments are four to a square.
const N_CELLS: f32 = 8.0;
/// A square may take this many times its equal share before the others have been served.
const SHARES_PER_CELL: usize = 2;

/// Two edges of the same polarity are farther apart than this, pixels: between them must be one of the other.
const SAME_EDGE_PX: f32 = 1.2;
/// A segment repeats another if more than this share of its length lies beside it.
const MAX_REPEATED_SHARE: f32 = 0.5;

/// The square of the grid over the frame that a point of it lies in, counted row by row.
fn cell(frame: &Frame, point: Vector2<f32>) -> usize {
    let extent = frame.max() - frame.min();
    let side = extent.max() / N_CELLS;
    let columns = (extent.x / side).ceil() as usize;
    let offset = (point - frame.min()) / side;
    offset.y as usize * columns + (offset.x as usize).min(columns - 1)
}

/// Cuts segments off at the frame and drops those then shorter than `min_length_px`.
pub(super) fn clip_and_drop(segments: &mut Vec<Ends>, frame: &Frame, min_length_px: f32) {
    segments.retain_mut(|segment| match frame.clip_ends(segment.start, segment.end) {
        Some((start, end)) => {
            *segment = Ends { start, end };
            segment.length() >= min_length_px
        }
        None => false,
    });
}

/// Orders segments by merit: the longest first, but those a square of the grid has beyond twice its share of
/// `n_wanted` after all others. Segments of equal length keep their order.
pub(super) fn spread(segments: &mut Vec<Ends>, frame: &Frame, n_wanted: usize) {
    segments.sort_by(|a, b| b.length().total_cmp(&a.length()));
    if segments.len() <= n_wanted {
        return;
    }
    let n_cells = cell(frame, frame.max()) + 1;
    let quota = (SHARES_PER_CELL * n_wanted).div_ceil(n_cells);
    let mut taken = vec![0usize; n_cells];
    let mut later = Vec::new();
    segments.retain(|segment| {
        let cell = cell(frame, (segment.start + segment.end) * 0.5).min(n_cells - 1);
        taken[cell] += 1;
        let now = taken[cell] <= quota;
        if !now {
            later.push(*segment);
        }
        now
    });
    segments.append(&mut later);
}

/// Whether a segment says again what another does: it lies on it, or for the greater part so. Pieces found
/// apart may be refined to the same edge.
pub(super) fn is_repeated(kept: &Segment, segment: &Segment) -> bool {
    let near = |end: &Vector2<f32>| kept.distance(end).abs() <= SAME_EDGE_PX;
    if !near(&segment.start) || !near(&segment.end) || kept.vector().dot(&segment.vector()) <= 0.0 {
        return false;
    }
    let direction = kept.direction();
    let along = |end: Vector2<f32>| direction.dot(&(end - kept.start)).clamp(0.0, kept.length());
    along(segment.end) - along(segment.start) > MAX_REPEATED_SHARE * segment.length()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(x0: f32, y0: f32, x1: f32, y1: f32) -> Ends {
        Ends { start: Vector2::new(x0, y0), end: Vector2::new(x1, y1) }
    }

    #[test]
    fn segments_are_cut_at_the_frame() {
        let frame = Frame::inside(101, 51, 5.0).unwrap();
        let mut segments = vec![
            ends(0.0, 20.0, 100.0, 20.0),
            ends(100.0, 0.0, 0.0, 50.0),
            ends(2.0, 0.0, 2.0, 50.0),
            ends(30.0, 2.0, 80.0, 3.0),
            ends(20.0, 20.0, 30.0, 20.0),
        ];
        clip_and_drop(&mut segments, &frame, 12.0);
        assert_eq!(segments.len(), 2);
        assert_eq!(segments[0], ends(5.0, 20.0, 95.0, 20.0));
        assert!((segments[1].start - Vector2::new(90.0, 5.0)).norm() < 1e-4);
        assert!((segments[1].end - Vector2::new(10.0, 45.0)).norm() < 1e-4);
        assert!(Frame::inside(10, 100, 5.0).is_none());
        assert!(Frame::inside(0, 0, 5.0).is_none());
    }

    #[test]
    fn crowded_squares_wait_for_the_others() {
        let frame = Frame::inside(400, 400, 5.0).unwrap();
        // Long ones close together, and short ones everywhere.
        let mut segments: Vec<Ends> =
            (0..100u8).map(|i| ends(10.0, 10.0 + 0.1 * f32::from(i), 50.0, 10.0)).collect();
        segments.extend((0..80u8).map(|i| {
            let (x, y) = (20.0 + 40.0 * f32::from(i % 8), 70.0 + 30.0 * f32::from(i / 8));
            ends(x, y, x + 20.0, y)
        }));
        let all = segments.clone();
        spread(&mut segments, &frame, 64);
        assert_eq!(segments.len(), all.len());
        assert_eq!(segments[..64].iter().filter(|segment| segment.length() > 30.0).count(), 2);
        spread(&mut segments, &frame, 200);
        assert!(segments.is_sorted_by(|a, b| a.length() >= b.length()));
    }

    #[test]
    fn what_lies_on_a_kept_segment_repeats_it() {
        let segment = |x0: f32, y0: f32, x1: f32, y1: f32| Segment {
            start: Vector2::new(x0, y0),
            end: Vector2::new(x1, y1),
            sigma_px: 0.3,
            gradient: 20.0,
        };
        let kept = segment(10.0, 10.0, 110.0, 10.0);
        assert!(is_repeated(&kept, &segment(40.0, 10.4, 70.0, 9.8)));
        assert!(is_repeated(&kept, &segment(90.0, 10.0, 125.0, 10.0)));
        // Going on, beside, across, of the other polarity.
        assert!(!is_repeated(&kept, &segment(100.0, 10.0, 150.0, 10.0)));
        assert!(!is_repeated(&kept, &segment(40.0, 13.0, 70.0, 13.0)));
        assert!(!is_repeated(&kept, &segment(40.0, 0.0, 70.0, 20.0)));
        assert!(!is_repeated(&kept, &segment(70.0, 10.0, 40.0, 10.0)));
    }
}
