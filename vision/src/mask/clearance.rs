//! How far pixels are from what is left out.

use super::Mask;
use crate::GrayImage;
use crate::lines::Segment;
use nalgebra::Vector2;

/// Distances are counted to this, in thirds of a pixel: further away is far enough for any feature.
const FAR: u16 = 3 * 255;
/// A step to a neighbor, and to a diagonal one, in thirds of a pixel: the 3-4 distance of Borgefors (1986).
const STEP: u16 = 3;
/// See [`STEP`].
const DIAGONAL: u16 = 4;
/// Segments are looked at every so many pixels.
const SAMPLE_STEP_PX: f32 = 2.0;
/// Parts of a segment closer than this to what is left out belong to its edge, pixels: edges are located in
/// smoothed images, and masks are found at a lower resolution.
const EDGE_MARGIN_PX: u8 = 5;
/// What remains of a segment is used from this length on, pixels.
const MIN_PART_PX: f32 = 20.0;

/// For each pixel the distance to the nearest one that is left out, pixels, 255 and more as 255.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clearance {
    distances: GrayImage,
}

impl Clearance {
    /// Of a mask.
    pub fn of(mask: &Mask) -> Self {
        let (width, height) = (mask.width() as usize, mask.height() as usize);
        let picture = mask.picture().as_raw();
        let mut thirds: Vec<u16> = picture.iter().map(|value| if *value == 0 { 0 } else { FAR }).collect();
        for y in 0..height {
            for x in 0..width {
                let before = neighbors(x, y, width, height, false);
                relax(&mut thirds, y * width + x, before);
            }
        }
        for y in (0..height).rev() {
            for x in (0..width).rev() {
                let after = neighbors(x, y, width, height, true);
                relax(&mut thirds, y * width + x, after);
            }
        }
        let distance = |x: u32, y: u32| (thirds[y as usize * width + x as usize] / STEP) as u8;
        Self { distances: GrayImage::from_fn(mask.width(), mask.height(), distance) }
    }

    /// Width and height of the mask's images, pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.distances.width(), self.distances.height())
    }

    /// Of the pixel at column `x`, row `y`; 0 outside the image.
    #[inline]
    pub fn at(&self, x: u32, y: u32) -> u8 {
        self.distances.get(x, y).unwrap_or(0)
    }

    /// Of a place in the image; 0 outside.
    #[inline]
    pub fn at_place(&self, place: &Vector2<f32>) -> u8 {
        let (x, y) = (place.x.round(), place.y.round());
        if x >= 0.0 && y >= 0.0 { self.at(x as u32, y as u32) } else { 0 }
    }

    /// The longest part of a segment that is of the scene, and not of the edge of what is left out; `None` if
    /// too little remains.
    pub fn visible_part(&self, segment: &Segment) -> Option<Segment> {
        let length = segment.length();
        if !(segment.is_finite() && length < 1e5) {
            return None;
        }
        let n_steps = (length / SAMPLE_STEP_PX).ceil().max(1.0) as usize;
        let place = |i: usize| segment.start + (segment.end - segment.start) * (i as f32 / n_steps as f32);
        // Ends may lie a little beyond the image.
        let (right, bottom) = (self.distances.width() as f32 - 1.0, self.distances.height() as f32 - 1.0);
        let inside = |p: Vector2<f32>| Vector2::new(p.x.clamp(0.0, right), p.y.clamp(0.0, bottom));
        let is_free = |i: usize| self.at_place(&inside(place(i))) > EDGE_MARGIN_PX;
        let (mut best, mut begin) = ((0, 0), None);
        for i in 0..=n_steps + 1 {
            match begin {
                None if i <= n_steps && is_free(i) => begin = Some(i),
                Some(from) if i > n_steps || !is_free(i) => {
                    if i - 1 - from > best.1 - best.0 {
                        best = (from, i - 1);
                    }
                    begin = None;
                }
                _ => {}
            }
        }
        if best == (0, n_steps) {
            return Some(*segment);
        }
        let part = Segment { start: place(best.0), end: place(best.1), ..*segment };
        (part.length() >= MIN_PART_PX).then_some(part)
    }
}

/// Offsets to the neighbors that a pass has visited before, with the length of the step; `None` outside the
/// image.
fn neighbors(x: usize, y: usize, width: usize, height: usize, backwards: bool) -> [Option<(isize, u16)>; 4] {
    let w = width as isize;
    let (first_column, last_column) = (x == 0, x + 1 == width);
    let row_ends = if backwards { y + 1 == height } else { y == 0 };
    let sign: isize = if backwards { 1 } else { -1 };
    let (side_ends, other_ends) =
        if backwards { (last_column, first_column) } else { (first_column, last_column) };
    [
        (!side_ends).then_some((sign, STEP)),
        (!row_ends).then_some((sign * w, STEP)),
        (!row_ends && !side_ends).then_some((sign * (w + 1), DIAGONAL)),
        (!row_ends && !other_ends).then_some((sign * (w - 1), DIAGONAL)),
    ]
}

fn relax(thirds: &mut [u16], at: usize, visited: [Option<(isize, u16)>; 4]) {
    let mut least = thirds[at];
    for (offset, step) in visited.into_iter().flatten() {
        least = least.min(thirds[at.wrapping_add_signed(offset)] + step);
    }
    thirds[at] = least;
}
