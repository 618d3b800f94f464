//! A finished texture with its half-size copies, and filtered look-ups in it.

/// Grey levels at halving resolutions. Coordinates are in texels of the finest level, from its corner.
pub(crate) struct MipTexture {
    levels: Vec<Level>,
}

struct Level {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

/// How a pixel's footprint on the texture is averaged: `n_taps` look-ups along its longer axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    /// Level of detail; 0 is the finest, fractions blend two levels.
    pub level: f32,
    /// Number of look-ups.
    pub n_taps: u32,
    /// Step between look-ups, in finest texels.
    pub step_u: f32,
    pub step_v: f32,
}

/// More look-ups than this cost more than the sharpness at grazing angles is worth.
const MAX_TAPS: f32 = 6.0;

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
        let level = (major / n_taps).log2().max(0.0);
        if n_taps == 1.0 {
            return Self { level, n_taps: 1, step_u: 0.0, step_v: 0.0 };
        }
        let (axis_u, axis_v) =
            if uu >= vv { (uu - vv + 2.0 * root, 2.0 * uv) } else { (2.0 * uv, vv - uu + 2.0 * root) };
        let scale = major / (n_taps * axis_u.hypot(axis_v).max(1e-12));
        Self { level, n_taps: n_taps as u32, step_u: axis_u * scale, step_v: axis_v * scale }
    }
}

impl MipTexture {
    /// Halves `pixels` (row-major, `width` wide) until one texel is left in a direction.
    pub fn new(width: usize, pixels: Vec<u8>) -> Self {
        let height = pixels.len() / width;
        let mut levels = vec![Level { width, height, pixels }];
        while let Some(next) = levels[levels.len() - 1].halved() {
            levels.push(next);
        }
        Self { levels }
    }

    /// Mean grey level over a footprint centred at `(u, v)`.
    #[inline]
    pub fn sample(&self, u: f32, v: f32, footprint: &Footprint) -> f32 {
        if footprint.n_taps == 1 {
            return self.trilinear(u, v, footprint.level);
        }
        let first = -0.5 * (footprint.n_taps - 1) as f32;
        let mut sum = 0.0;
        for tap in 0..footprint.n_taps {
            let offset = first + tap as f32;
            sum +=
                self.trilinear(u + offset * footprint.step_u, v + offset * footprint.step_v, footprint.level);
        }
        sum / footprint.n_taps as f32
    }

    #[inline]
    fn trilinear(&self, u: f32, v: f32, level: f32) -> f32 {
        let coarsest = self.levels.len() - 1;
        let below = (level as usize).min(coarsest);
        let scale = LEVEL_SCALE[below];
        let fine = self.levels[below].bilinear(u * scale, v * scale);
        let share = level - below as f32;
        if share < 0.02 || below == coarsest {
            return fine;
        }
        let coarse = self.levels[below + 1].bilinear(0.5 * u * scale, 0.5 * v * scale);
        fine + (coarse - fine) * share
    }
}

/// `2^-level`.
const LEVEL_SCALE: [f32; 20] = {
    let mut scales = [1.0; 20];
    let mut level = 1;
    while level < 20 {
        scales[level] = 0.5 * scales[level - 1];
        level += 1;
    }
    scales
};

impl Level {
    fn halved(&self) -> Option<Self> {
        let (width, height) = (self.width / 2, self.height / 2);
        if width == 0 || height == 0 {
            return None;
        }
        let mut pixels = Vec::with_capacity(width * height);
        for row in 0..height {
            let upper = &self.pixels[2 * row * self.width..][..2 * width];
            let lower = &self.pixels[(2 * row + 1) * self.width..][..2 * width];
            for (a, b) in upper.chunks_exact(2).zip(lower.chunks_exact(2)) {
                let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
                pixels.push(((sum + 2) / 4) as u8);
            }
        }
        Some(Self { width, height, pixels })
    }

    /// Coordinates in this level's texels, from the corner; clamped to the edge.
    #[inline]
    fn bilinear(&self, u: f32, v: f32) -> f32 {
        let x = (u - 0.5).clamp(0.0, (self.width - 1) as f32);
        let y = (v - 0.5).clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (x as usize, y as usize);
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let x1 = (x0 + 1).min(self.width - 1);
        let upper = &self.pixels[y0 * self.width..][..self.width];
        let lower = &self.pixels[(y0 + 1).min(self.height - 1) * self.width..][..self.width];
        let [a, b, c, d] = [upper[x0], upper[x1], lower[x0], lower[x1]].map(f32::from);
        let top = a + (b - a) * fx;
        let bottom = c + (d - c) * fx;
        top + (bottom - top) * fy
    }
}
