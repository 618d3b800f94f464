//! The direction of the level line at every pixel, and the order in which pixels are taken for seeds.

use nalgebra::Vector2;

use super::rescale::Shrunk;

/// Bins of gradient magnitude by which seeds are sorted.
const N_BINS: usize = 1024;

/// A pixel of the shrunk image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pixel {
    pub x: u32,
    pub y: u32,
}

/// Unit level-line directions, brighter side to the right; and which pixels are taken.
#[derive(Clone, Debug, Default)]
pub(super) struct Field {
    pub width: usize,
    pub height: usize,
    /// Elements from one row to the next. A row of pixels without direction goes before the first, and the
    /// last column and row have none either, so that every pixel with a direction has eight neighbors in
    /// memory.
    pub stride: usize,
    /// Zero where the gradient is too weak.
    pub direction: Vec<Vector2<f32>>,
    /// Norm of the gradient, gray levels per pixel of the shrunk image.
    pub magnitude: Vec<f32>,
    /// 0 for a pixel with a direction that no region has taken.
    pub taken: Vec<u8>,
    seeds: Vec<u32>,
    unsorted: Vec<u32>,
}

impl Field {
    /// Takes the gradient of `image` on blocks of 2 x 2 pixels, in place of what was here.
    pub fn compute(&mut self, image: &Shrunk, min_magnitude: f32) {
        let (width, height) = (image.width, image.height);
        if (self.width, self.height) != (width, height) {
            self.resize(width, height);
        }
        let mut largest = 0u32;
        for y in 0..height.saturating_sub(1) {
            let at = self.at(Pixel { x: 0, y: y as u32 });
            let n = width.saturating_sub(1);
            let (above, below) =
                (&image.pixels[y * width..][..width], &image.pixels[(y + 1) * width..][..width]);
            let direction = &mut self.direction[at..][..n];
            let magnitude = &mut self.magnitude[at..][..n];
            let taken = &mut self.taken[at..][..n];
            let mut row_largest = 0u32;
            for x in 0..n {
                let (falling, rising) = (below[x + 1] - above[x], above[x + 1] - below[x]);
                let (gx, gy) = (0.5 * (falling + rising), 0.5 * (falling - rising));
                let norm = (gx * gx + gy * gy).sqrt();
                let strong = norm > min_magnitude;
                let inverse = if strong { 1.0 / norm } else { 0.0 };
                direction[x] = Vector2::new(gy * inverse, -gx * inverse);
                magnitude[x] = norm;
                taken[x] = u8::from(!strong);
                // The bits of floats that are not negative are in the order of the floats.
                row_largest = row_largest.max(norm.to_bits());
            }
            largest = largest.max(row_largest);
        }
        self.sort_seeds(f32::from_bits(largest));
    }

    /// Makes room for an image of another size, with no direction anywhere: at the outer elements that is how
    /// it stays.
    fn resize(&mut self, width: usize, height: usize) {
        (self.width, self.height, self.stride) = (width, height, width);
        let n = self.at(Pixel { x: 0, y: height as u32 }) + 1;
        self.direction.clear();
        self.direction.resize(n, Vector2::zeros());
        self.magnitude.clear();
        self.magnitude.resize(n, 0.0);
        self.taken.clear();
        self.taken.resize(n, 1);
    }

    /// Sorts the pixels that have a direction by falling magnitude, of which `largest` is the largest, to
    /// within a bin, by counting.
    fn sort_seeds(&mut self, largest: f32) {
        // Every pixel is written, and the next one over it if it has no direction: no branch to guess wrong.
        self.unsorted.resize(self.taken.len(), 0);
        let mut n = 0;
        for (at, &taken) in self.taken.iter().enumerate() {
            self.unsorted[n] = at as u32;
            n += usize::from(taken == 0);
        }
        self.unsorted.truncate(n);
        let bins_per_unit = if largest > 0.0 { N_BINS as f32 / largest } else { 0.0 };
        let bin = |at: u32| {
            let bin = (self.magnitude[at as usize] * bins_per_unit) as usize;
            N_BINS - 1 - bin.min(N_BINS - 1)
        };
        let mut starts = [0usize; N_BINS + 1];
        for &at in &self.unsorted {
            starts[bin(at) + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        self.seeds.resize(self.unsorted.len(), 0);
        for &at in &self.unsorted {
            let slot = &mut starts[bin(at)];
            self.seeds[*slot] = at;
            *slot += 1;
        }
    }

    pub fn n_seeds(&self) -> usize {
        self.seeds.len()
    }

    /// The seed of rank `i`, if no region has taken it.
    pub fn seed(&self, i: usize) -> Option<Pixel> {
        let at = self.seeds[i] as usize;
        (self.taken[at] == 0).then(|| {
            let at = at as u32 - self.stride as u32 - 1;
            Pixel { x: at % self.stride as u32, y: at / self.stride as u32 }
        })
    }

    /// The element of a pixel.
    #[inline]
    pub fn at(&self, pixel: Pixel) -> usize {
        (pixel.y as usize + 1) * self.stride + pixel.x as usize + 1
    }
}
