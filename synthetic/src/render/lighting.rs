//! Light on surfaces: lamps with shadows and an even ambient light, on a coarse grid.

use nalgebra::{Vector2, Vector3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::texture::Canvas;
use crate::world::{Surface, World};

/// Light that comes from everywhere, as a share of full white.
const AMBIENT: f64 = 0.52;
/// Distance between grid points where light is computed; shadows are as soft as this.
const CELL: f64 = 0.12;
/// Grid points on the rim of a surface are drawn in by this much.
const RIM_INSET: f64 = 0.02;
/// Surfaces up to this far apart do not shadow each other, nor do lamps' own housings.
const SHADOW_MARGIN: f64 = 0.03;
/// Lamps that add less than this are not traced.
const MIN_CONTRIBUTION: f64 = 0.004;

/// Irradiance at grid points of a surface, as shares of full white.
pub(crate) struct LightMap {
    columns: usize,
    values: Vec<f32>,
    cell: Vector2<f64>,
}

impl LightMap {
    pub fn new(world: &World, surface: &Surface) -> Self {
        let spans = surface.size.map(|length| (length / CELL).ceil().max(1.0));
        let cell = surface.size.component_div(&spans);
        let (columns, rows) = (spans.x as usize + 1, spans.y as usize + 1);
        let normal = surface.normal();
        let inset_of = |length: f64| f64::min(RIM_INSET, 0.25 * length);
        let mut values = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                // Points at the rim are drawn in, so that they are not inside of an adjoining wall.
                let uv = Vector2::new(column as f64 * cell.x, row as f64 * cell.y);
                let drawn_in = uv
                    .zip_map(&surface.size, |x, length| x.clamp(inset_of(length), length - inset_of(length)));
                let point = surface.point(&drawn_in) + normal * 0.01;
                values.push(irradiance(world, &point, &normal) as f32);
            }
        }
        Self { columns, values, cell }
    }

    /// Gray levels of the painted canvas under this light, with one level of dither.
    pub fn lit(&self, canvas: &Canvas, rng: &mut ChaCha8Rng) -> Vec<u8> {
        let rows = self.values.len() / self.columns;
        let position = |i: usize, cell: f64, n: usize| {
            let x = (i as f64 + 0.5) * canvas.texel / cell;
            let k = (x as usize).min(n - 2);
            (k, ((x - k as f64).min(1.0)) as f32)
        };
        let across: Vec<(usize, f32)> =
            (0..canvas.width).map(|i| position(i, self.cell.x, self.columns)).collect();
        let mut state: u64 = rng.random();
        let mut pixels = Vec::with_capacity(canvas.albedo.len());
        for (j, line) in canvas.albedo.chunks_exact(canvas.width).enumerate() {
            let (k, share) = position(j, self.cell.y, rows);
            let upper = &self.values[k * self.columns..][..self.columns];
            let lower = &self.values[(k + 1) * self.columns..][..self.columns];
            let row: Vec<f32> = upper.iter().zip(lower).map(|(a, b)| 255.0 * (a + (b - a) * share)).collect();
            for (albedo, &(k, share)) in line.iter().zip(&across) {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let dither = (state >> 40) as f32 / (1_u64 << 24) as f32;
                pixels.push((albedo * (row[k] + (row[k + 1] - row[k]) * share) + dither) as u8);
            }
        }
        pixels
    }
}

fn irradiance(world: &World, point: &Vector3<f64>, normal: &Vector3<f64>) -> f64 {
    let lamps: f64 = world
        .lights()
        .iter()
        .map(|light| {
            let offset = light.position - point;
            let distance = offset.norm().max(1e-6);
            let cosine = normal.dot(&offset) / distance;
            let share = light.intensity * cosine.max(0.0) / (1.0 + (distance / light.reach).powi(2));
            let visible =
                share > MIN_CONTRIBUTION && world.is_visible_between(point, &light.position, SHADOW_MARGIN);
            if visible { share } else { 0.0 }
        })
        .sum();
    // Ambient light comes from above rather than from below.
    let ambient = AMBIENT * (0.9 + 0.1 * normal.z);
    (ambient + lamps).min(1.0)
}
