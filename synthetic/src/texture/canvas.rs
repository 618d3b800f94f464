//! A raster of albedos, in units of the surface, to paint on.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Albedos at the centers of square texels; texel `(i, j)` covers `[i, i + 1] x [j, j + 1]` texels.
pub(crate) struct Canvas {
    pub width: usize,
    pub height: usize,
    /// Side of a texel, in map units.
    pub texel: f64,
    pub albedo: Vec<f32>,
}

impl Canvas {
    /// A blank canvas over `size_u x size_v` map units.
    pub fn new(size_u: f64, size_v: f64, texel: f64) -> Self {
        let side = |length: f64| ((length / texel).ceil() as usize).max(1);
        let (width, height) = (side(size_u), side(size_v));
        Self { width, height, texel, albedo: vec![0.0; width * height] }
    }

    pub fn size(&self) -> (f64, f64) {
        (self.width as f64 * self.texel, self.height as f64 * self.texel)
    }

    pub fn fill(&mut self, albedo: f64) {
        self.albedo.fill(albedo as f32);
    }

    /// Adds smooth random values in `±amplitude` that vary over `cell` map units (value noise).
    pub fn noise(&mut self, cell_u: f64, cell_v: f64, amplitude: f64, rng: &mut ChaCha8Rng) {
        let columns = Lattice::new(self.width, cell_u / self.texel);
        let rows = Lattice::new(self.height, cell_v / self.texel);
        let mut draw = || -> Vec<f32> {
            (0..columns.n_nodes).map(|_| (amplitude * rng.random_range(-1.0..1.0)) as f32).collect()
        };
        let expand = |nodes: &[f32]| -> Vec<f32> {
            columns.at.iter().map(|&(k, s)| nodes[k] + (nodes[k + 1] - nodes[k]) * s).collect()
        };
        let (mut upper, mut lower) = (expand(&draw()), expand(&draw()));
        let mut current = 0;
        for (row, &(k, share)) in self.albedo.chunks_exact_mut(self.width).zip(&rows.at) {
            while current < k {
                upper = std::mem::replace(&mut lower, expand(&draw()));
                current += 1;
            }
            for ((pixel, a), b) in row.iter_mut().zip(&upper).zip(&lower) {
                *pixel += a + (b - a) * share;
            }
        }
    }

    /// Blends `albedo` into the axis-aligned rectangle, its sides anti-aliased.
    pub fn rectangle(&mut self, u0: f64, v0: f64, u1: f64, v1: f64, albedo: f64, opacity: f64) {
        let overlap = |i: usize, low: f64, high: f64| {
            (f64::min(high, i as f64 + 1.0) - f64::max(low, i as f64)).clamp(0.0, 1.0)
        };
        let [u0, v0, u1, v1] = [u0, v0, u1, v1].map(|x| x / self.texel);
        for j in clip(v0, v1, self.height) {
            let vertical = overlap(j, v0, v1) * opacity;
            for i in clip(u0, u1, self.width) {
                let share = (vertical * overlap(i, u0, u1)) as f32;
                let pixel = &mut self.albedo[j * self.width + i];
                *pixel += (albedo as f32 - *pixel) * share;
            }
        }
    }

    /// Blends `albedo` into a convex shape given as half-planes `a u + b v <= c` with unit `(a, b)`.
    pub fn convex(&mut self, half_planes: &[(f64, f64, f64)], bounds: [f64; 4], albedo: f64) {
        self.shape(bounds, albedo, |u, v| {
            half_planes.iter().map(|&(a, b, c)| c - a * u - b * v).fold(f64::INFINITY, f64::min)
        });
    }

    /// Blends `albedo` into a disc, or a ring of the given width.
    pub fn disc(&mut self, u: f64, v: f64, radius: f64, ring: Option<f64>, albedo: f64) {
        self.shape([u - radius, v - radius, u + radius, v + radius], albedo, |x, y| {
            let distance = (x - u).hypot(y - v);
            let outer = radius - distance;
            ring.map_or(outer, |width| outer.min(distance - radius + width))
        });
    }

    /// A rectangle turned by `angle` about its middle.
    pub fn turned_rectangle(&mut self, u: f64, v: f64, half: (f64, f64), angle: f64, albedo: f64) {
        let (s, c) = angle.sin_cos();
        let (along, across) = (c * u + s * v, c * v - s * u);
        let planes = [
            (c, s, along + half.0),
            (-c, -s, half.0 - along),
            (-s, c, across + half.1),
            (s, -c, half.1 - across),
        ];
        let reach_u = (c * half.0).abs() + (s * half.1).abs();
        let reach_v = (s * half.0).abs() + (c * half.1).abs();
        self.convex(&planes, [u - reach_u, v - reach_v, u + reach_u, v + reach_v], albedo);
    }

    /// Blends `albedo` in by the coverage that the signed inner distance (map units) implies.
    fn shape(&mut self, bounds: [f64; 4], albedo: f64, inner_distance: impl Fn(f64, f64) -> f64) {
        let [u0, v0, u1, v1] = bounds.map(|x| x / self.texel);
        for j in clip(v0 - 1.0, v1 + 1.0, self.height) {
            for i in clip(u0 - 1.0, u1 + 1.0, self.width) {
                let (u, v) = ((i as f64 + 0.5) * self.texel, (j as f64 + 0.5) * self.texel);
                let share = (inner_distance(u, v) / self.texel + 0.5).clamp(0.0, 1.0) as f32;
                let pixel = &mut self.albedo[j * self.width + i];
                *pixel += (albedo as f32 - *pixel) * share;
            }
        }
    }
}

/// Texels that `[low, high]` (in texels) touches.
fn clip(low: f64, high: f64, n: usize) -> std::ops::Range<usize> {
    let end = (high.ceil().max(0.0) as usize).min(n);
    (low.floor().max(0.0) as usize).min(end)..end
}

/// For each texel along an axis: the noise node before it and the eased share of the next.
struct Lattice {
    at: Vec<(usize, f32)>,
    n_nodes: usize,
}

impl Lattice {
    fn new(n: usize, cell: f64) -> Self {
        let at: Vec<(usize, f32)> = (0..n)
            .map(|i| {
                let x = (i as f64 + 0.5) / cell;
                let share = x.fract();
                (x as usize, (share * share * (3.0 - 2.0 * share)) as f32)
            })
            .collect();
        let n_nodes = at[n - 1].0 + 2;
        Self { at, n_nodes }
    }
}
