//! A finished texture with its half-size copies, and filtered look-ups in it.

/// Gray levels at halving resolutions. Coordinates are in texels of the finest level, from its corner.
pub(crate) struct MipTexture {
    levels: Vec<Level>,
}

/// Rows have one texel more than `width`, and there is one row more than `height`: both repeat the last, so
/// that every texel has a right and a lower neighbor.
struct Level {
    width: usize,
    height: usize,
    padded: Vec<u8>,
}

/// How a pixel's footprint on the texture is averaged: `n_taps` look-ups along its longer axis, each in one
/// level or two.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    /// The finer level.
    level: usize,
    /// Weight of the coarser level.
    coarse_share: f32,
    n_taps: u32,
    /// Step between look-ups, in finest texels.
    step_u: f32,
    step_v: f32,
}

/// More look-ups than this cost more than the sharpness at grazing angles is worth.
const MAX_TAPS: f32 = 5.0;
/// Two levels are blended over this part of the way between them; elsewhere one look-up is enough.
const BLEND_SPAN: f32 = 0.5;

impl Footprint {
    /// From the derivatives of texture coordinates by pixel coordinates: `[du_dx, dv_dx, du_dy, dv_dy]`.
    pub fn new([du_dx, dv_dx, du_dy, dv_dy]: [f32; 4]) -> Self {
        // Axes of the ellipse that the Jacobian makes of a unit circle.
        let (uu, vv) = (du_dx * du_dx + du_dy * du_dy, dv_dx * dv_dx + dv_dy * dv_dy);
        let uv = du_dx * dv_dx + du_dy * dv_dy;
        let half_trace = 0.5 * (uu + vv);
        let root = (0.25 * (uu - vv) * (uu - vv) + uv * uv).sqrt();
        let major = (half_trace + root).sqrt().max(1e-6);
        let minor = (half_trace - root).max(0.0).sqrt();
        let n_taps = (major / minor.max(1.0)).ceil().clamp(1.0, MAX_TAPS);
        let between = (major / n_taps).log2().max(0.0);
        let level = between as usize;
        let coarse_share = ((between - level as f32 - 0.5) / BLEND_SPAN + 0.5).clamp(0.0, 1.0);
        if n_taps == 1.0 {
            return Self { level, coarse_share, n_taps: 1, step_u: 0.0, step_v: 0.0 };
        }
        let (axis_u, axis_v) =
            if uu >= vv { (uu - vv + 2.0 * root, 2.0 * uv) } else { (2.0 * uv, vv - uu + 2.0 * root) };
        let scale = major / (n_taps * (axis_u * axis_u + axis_v * axis_v).sqrt().max(1e-12));
        Self { level, coarse_share, n_taps: n_taps as u32, step_u: axis_u * scale, step_v: axis_v * scale }
    }
}

impl MipTexture {
    /// Halves `pixels` (row-major, `width` wide) until one texel is left in a direction.
    pub fn new(width: usize, pixels: &[u8]) -> Self {
        let mut levels = vec![Level::padded(width, pixels.chunks_exact(width).map(<[u8]>::to_vec))];
        while let Some(next) = levels[levels.len() - 1].halved() {
            levels.push(next);
        }
        Self { levels }
    }

    /// Mean gray levels over equal footprints centered at `(u[i], v[i])`.
    #[inline]
    pub fn sample<const N: usize>(&self, u: &[f32; N], v: &[f32; N], footprint: &Footprint) -> [f32; N] {
        let coarsest = self.levels.len() - 1;
        let fine = footprint.level.min(coarsest);
        let coarse_share = if fine < coarsest { footprint.coarse_share } else { 0.0 };
        let weight = 1.0 / footprint.n_taps as f32;
        let first = -0.5 * (footprint.n_taps - 1) as f32;
        let mut sums = [0.0; N];
        for tap in 0..footprint.n_taps {
            let offset = first + tap as f32;
            let (mut tap_u, mut tap_v) = (*u, *v);
            for i in 0..N {
                tap_u[i] += offset * footprint.step_u;
                tap_v[i] += offset * footprint.step_v;
            }
            if coarse_share < 1.0 {
                self.levels[fine].add_bilinear(
                    &tap_u,
                    &tap_v,
                    LEVEL_SCALE[fine],
                    weight * (1.0 - coarse_share),
                    &mut sums,
                );
            }
            if coarse_share > 0.0 {
                let (level, scale) = (&self.levels[fine + 1], LEVEL_SCALE[fine + 1]);
                level.add_bilinear(&tap_u, &tap_v, scale, weight * coarse_share, &mut sums);
            }
        }
        sums
    }
}

/// `2^-level`, for more levels than a texture that fits into memory can have.
const LEVEL_SCALE: [f32; 32] = {
    let mut scales = [1.0; 32];
    let mut level = 1;
    while level < 32 {
        scales[level] = 0.5 * scales[level - 1];
        level += 1;
    }
    scales
};

impl Level {
    fn padded(width: usize, rows: impl Iterator<Item = Vec<u8>>) -> Self {
        let (mut padded, mut height) = (Vec::new(), 0);
        for row in rows {
            padded.extend_from_slice(&row);
            padded.push(row[width - 1]);
            height += 1;
        }
        padded.extend_from_within((height - 1) * (width + 1)..);
        Self { width, height, padded }
    }

    fn row(&self, y: usize) -> &[u8] {
        &self.padded[y * (self.width + 1)..][..self.width]
    }

    fn halved(&self) -> Option<Self> {
        let (width, height) = (self.width / 2, self.height / 2);
        if width == 0 || height == 0 {
            return None;
        }
        let rows = (0..height).map(|y| {
            let (upper, lower) = (self.row(2 * y).chunks_exact(2), self.row(2 * y + 1).chunks_exact(2));
            let mean = |(a, b): (&[u8], &[u8])| {
                let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
                ((sum + 2) / 4) as u8
            };
            upper.zip(lower).map(mean).collect()
        });
        Some(Self::padded(width, rows))
    }

    /// Adds `weight` times the gray levels at `(u[i], v[i]) * scale`, clamped to the edge.
    #[inline]
    fn add_bilinear<const N: usize>(
        &self,
        u: &[f32; N],
        v: &[f32; N],
        scale: f32,
        weight: f32,
        sums: &mut [f32; N],
    ) {
        let (right, bottom) = ((self.width - 1) as f32, (self.height - 1) as f32);
        // Plain loops: closures over arrays are not inlined here, which costs a quarter of the frame.
        let (mut x, mut y, mut x0, mut y0) = ([0.0_f32; N], [0.0_f32; N], [0_i32; N], [0_i32; N]);
        for i in 0..N {
            x[i] = (u[i] * scale - 0.5).max(0.0).min(right);
            y[i] = (v[i] * scale - 0.5).max(0.0).min(bottom);
            x0[i] = x[i] as i32;
            y0[i] = y[i] as i32;
        }
        let stride = self.width + 1;
        for i in 0..N {
            let at = y0[i] as usize * stride + x0[i] as usize;
            let (upper, lower) = (&self.padded[at..at + 2], &self.padded[at + stride..at + stride + 2]);
            let (fx, fy) = (x[i] - x0[i] as f32, y[i] - y0[i] as f32);
            let (a, b) = (f32::from(upper[0]), f32::from(upper[1]));
            let (c, d) = (f32::from(lower[0]), f32::from(lower[1]));
            let top = a + (b - a) * fx;
            let below = c + (d - c) * fx;
            sums[i] += weight * (top + (below - top) * fy);
        }
    }
}
