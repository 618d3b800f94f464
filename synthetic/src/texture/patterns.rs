//! How each material is painted.

use std::f64::consts::TAU;

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::{Canvas, Material};

impl Material {
    /// Paints a surface of `size` map units at `texel` map units a texel; the same for the same generator.
    pub(crate) fn paint(&self, size: (f64, f64), texel: f64, rng: &mut ChaCha8Rng) -> Canvas {
        let mut canvas = Canvas::new(size.0, size.1, texel);
        match *self {
            Self::Paint { albedo } => even_paint(&mut canvas, albedo, rng),
            Self::Plaster { albedo, contrast } => plaster(&mut canvas, albedo, contrast, rng),
            Self::Wallpaper { albedo } => wallpaper(&mut canvas, albedo, rng),
            Self::Bricks { albedo } => bricks(&mut canvas, albedo, rng),
            Self::Planks { albedo } => planks(&mut canvas, albedo, rng),
            Self::Tiles { albedo, pitch } => tiles(&mut canvas, albedo, pitch, rng),
            Self::Print => print(&mut canvas, rng),
            Self::Landscape => landscape(&mut canvas, rng),
            Self::Text => text(&mut canvas, rng),
            Self::Books => books(&mut canvas, rng),
            Self::Sky => sky(&mut canvas, rng),
        }
        for pixel in &mut canvas.albedo {
            *pixel = pixel.clamp(0.02, 0.98);
        }
        canvas
    }
}

fn even_paint(canvas: &mut Canvas, albedo: f64, rng: &mut ChaCha8Rng) {
    canvas.fill(albedo);
    canvas.noise(1.3, 1.3, 0.015, rng);
    canvas.noise(0.35, 0.35, 0.006, rng);
    canvas.noise(0.02, 0.02, 0.004, rng);
}

/// Noise at five scales, each half as strong as the one above it.
fn octaves(canvas: &mut Canvas, coarsest: f64, amplitude: f64, rng: &mut ChaCha8Rng) {
    let mut cell = coarsest;
    for octave in 0..5 {
        canvas.noise(cell, cell, amplitude * 0.72_f64.powi(octave), rng);
        cell *= 0.47;
    }
}

fn plaster(canvas: &mut Canvas, albedo: f64, contrast: f64, rng: &mut ChaCha8Rng) {
    canvas.fill(albedo);
    octaves(canvas, 0.4, 0.13 * contrast, rng);
    specks(canvas, 110.0, 0.5 * contrast, rng);
}

/// Small dark and light dots and scratches, `density` to a square map unit.
fn specks(canvas: &mut Canvas, density: f64, strength: f64, rng: &mut ChaCha8Rng) {
    let (width, height) = canvas.size();
    for _ in 0..(density * width * height) as usize {
        let (u, v) = (rng.random_range(0.0..width), rng.random_range(0.0..height));
        let albedo = 0.5 + strength * if rng.random_bool(0.6) { -0.8 } else { 0.8 };
        let size = rng.random_range(0.004..0.02);
        if rng.random_bool(0.7) {
            canvas.disc(u, v, size, None, albedo);
        } else {
            canvas.turned_rectangle(u, v, (2.5 * size, 0.4 * size), rng.random_range(0.0..TAU), albedo);
        }
    }
}

/// Random shapes of random tone, `n` of them, with sizes in `size` (map units).
fn shapes(canvas: &mut Canvas, n: usize, size: std::ops::Range<f64>, rng: &mut ChaCha8Rng) {
    let (width, height) = canvas.size();
    for _ in 0..n {
        let (u, v) = (rng.random_range(0.0..width), rng.random_range(0.0..height));
        // Small shapes are the most frequent ones.
        let share: f64 = rng.random::<f64>();
        let radius = size.start + (size.end - size.start) * share * share;
        let albedo = rng.random_range(0.05..0.95);
        let angle = rng.random_range(0.0..TAU);
        match rng.random_range(0..5) {
            0 => canvas.disc(u, v, radius, None, albedo),
            1 => canvas.disc(u, v, radius, Some(0.35 * radius), albedo),
            2 => canvas.turned_rectangle(u, v, (1.6 * radius, 0.3 * radius), angle, albedo),
            3 => triangle(canvas, u, v, radius, angle, albedo),
            _ => canvas.turned_rectangle(u, v, (radius, 0.7 * radius), angle, albedo),
        }
    }
}

fn triangle(canvas: &mut Canvas, u: f64, v: f64, radius: f64, angle: f64, albedo: f64) {
    let planes: [(f64, f64, f64); 3] = std::array::from_fn(|i| {
        let (b, a) = (angle + TAU * i as f64 / 3.0).sin_cos();
        (a, b, a * u + b * v + 0.6 * radius)
    });
    let reach = 1.2 * radius;
    canvas.convex(&planes, [u - reach, v - reach, u + reach, v + reach], albedo);
}

fn wallpaper(canvas: &mut Canvas, albedo: f64, rng: &mut ChaCha8Rng) {
    canvas.fill(albedo);
    octaves(canvas, 0.6, 0.06, rng);
    let (width, height) = canvas.size();
    shapes(canvas, (55.0 * width * height) as usize, 0.012..0.075, rng);
    canvas.noise(0.012, 0.012, 0.03, rng);
}

fn bricks(canvas: &mut Canvas, albedo: f64, rng: &mut ChaCha8Rng) {
    let (brick_width, brick_height, joint) = (0.21, 0.068, 0.011);
    let (width, height) = canvas.size();
    canvas.fill(0.72);
    let mut v = 0.0;
    let mut course = 0;
    while v < height {
        let mut u = if course % 2 == 0 { 0.0 } else { -0.5 * brick_width };
        while u < width {
            let tone = albedo * rng.random_range(0.55..1.35);
            let mut slack = || rng.random_range(0.0..0.004);
            let (left, top, right, bottom) = (slack(), slack(), slack(), slack());
            canvas.rectangle(
                u + left,
                v + top,
                u + brick_width - joint - right,
                v + brick_height - joint - bottom,
                tone,
                1.0,
            );
            u += brick_width;
        }
        v += brick_height;
        course += 1;
    }
    octaves(canvas, 0.09, 0.07, rng);
    specks(canvas, 60.0, 0.35, rng);
}

fn planks(canvas: &mut Canvas, albedo: f64, rng: &mut ChaCha8Rng) {
    let (width, height) = canvas.size();
    let along_u = width >= height;
    let (length, across) = if along_u { (width, height) } else { (height, width) };
    canvas.fill(albedo);
    let rectangle = |canvas: &mut Canvas, s0: f64, w0: f64, s1: f64, w1: f64, tone: f64, opacity: f64| {
        if along_u {
            canvas.rectangle(s0, w0, s1, w1, tone, opacity);
        } else {
            canvas.rectangle(w0, s0, w1, s1, tone, opacity);
        }
    };
    let plank_width = 0.13;
    let mut w = 0.0;
    while w < across {
        let mut s = -rng.random_range(0.0..1.0);
        while s < length {
            let next = s + rng.random_range(0.8..1.4);
            rectangle(canvas, s, w, next, w + plank_width, albedo * rng.random_range(0.72..1.28), 1.0);
            rectangle(canvas, s, w, s + 0.006, w + plank_width, 0.3 * albedo, 0.9);
            s = next;
        }
        rectangle(canvas, 0.0, w, length, w + 0.006, 0.3 * albedo, 0.9);
        w += plank_width;
    }
    for (long, short, amplitude) in [(0.5, 0.03, 0.06), (0.22, 0.012, 0.05), (0.06, 0.02, 0.035)] {
        let (cell_u, cell_v) = if along_u { (long, short) } else { (short, long) };
        canvas.noise(cell_u, cell_v, amplitude, rng);
    }
    for _ in 0..(5.0 * width * height) as usize {
        let (u, v) = (rng.random_range(0.0..width), rng.random_range(0.0..height));
        canvas.disc(u, v, rng.random_range(0.006..0.018), None, albedo * rng.random_range(0.3..0.6));
    }
}

fn tiles(canvas: &mut Canvas, albedo: f64, pitch: f64, rng: &mut ChaCha8Rng) {
    let (width, height) = canvas.size();
    canvas.fill(0.25);
    let mut v = 0.0;
    while v < height {
        let mut u = 0.0;
        while u < width {
            let tone = albedo * rng.random_range(0.85..1.15);
            canvas.rectangle(u + 0.004, v + 0.004, u + pitch - 0.004, v + pitch - 0.004, tone, 1.0);
            u += pitch;
        }
        v += pitch;
    }
    octaves(canvas, 0.15, 0.045, rng);
    specks(canvas, 40.0, 0.3, rng);
}

fn print(canvas: &mut Canvas, rng: &mut ChaCha8Rng) {
    let (width, height) = canvas.size();
    canvas.fill(rng.random_range(0.3..0.85));
    octaves(canvas, 0.3, 0.05, rng);
    let largest = 0.3 * width.min(height);
    shapes(canvas, 14, 0.3 * largest..largest, rng);
    shapes(canvas, (170.0 * width * height) as usize + 6, 0.008..0.045, rng);
    let v = rng.random_range(0.05..0.8) * height;
    rows_of_marks(canvas, (0.06 * width, v, 0.94 * width, (v + 0.12).min(height)), 0.03, rng);
}

/// Rows of short dark and light marks that look like writing from afar, top to bottom in `area`.
fn rows_of_marks(canvas: &mut Canvas, area: (f64, f64, f64, f64), row: f64, rng: &mut ChaCha8Rng) {
    let (u0, v0, u1, v1) = area;
    let mut v = v0;
    while v + 0.6 * row < v1 {
        let mut u = u0;
        let end = u1 - rng.random_range(0.0..0.35) * (u1 - u0);
        while u < end {
            let width = row * rng.random_range(0.25..0.6);
            for _ in 0..2 {
                let (du, dv) = (rng.random_range(0.0..0.3 * width), rng.random_range(0.0..0.3 * row));
                let right = (u + width - rng.random_range(0.0..0.4 * width)).min(u1);
                canvas.rectangle(
                    u + du,
                    v + dv,
                    right,
                    v + dv + row * rng.random_range(0.1..0.5),
                    0.08,
                    0.95,
                );
            }
            u += width * 1.25 + if rng.random_bool(0.2) { 0.5 * row } else { 0.0 };
        }
        v += row;
    }
}

fn text(canvas: &mut Canvas, rng: &mut ChaCha8Rng) {
    let (width, height) = canvas.size();
    canvas.fill(0.86);
    canvas.noise(0.1, 0.1, 0.02, rng);
    let margin = 0.08 * width;
    rows_of_marks(canvas, (margin, 0.72 * height, width - margin, 0.95 * height), 0.11 * height, rng);
    rows_of_marks(canvas, (margin, 0.06 * height, width - margin, 0.66 * height), 0.035, rng);
}

fn landscape(canvas: &mut Canvas, rng: &mut ChaCha8Rng) {
    let (width, height) = canvas.size();
    canvas.fill(0.75);
    canvas.noise(0.4, 0.2, 0.06, rng);
    for (base, tone) in [(0.5, 0.55), (0.35, 0.4), (0.2, 0.25)] {
        let (phase, waves) = (rng.random_range(0.0..TAU), rng.random_range(0.6..1.4));
        let step = canvas.texel;
        let mut u = 0.0;
        while u < width {
            let crest = height * (base + 0.1 * (TAU * waves * u / width + phase).sin());
            canvas.rectangle(u, 0.0, u + step, crest, tone, 1.0);
            u += step;
        }
    }
    canvas.disc(rng.random_range(0.2..0.8) * width, 0.8 * height, 0.07 * height, None, 0.95);
    canvas.noise(0.03, 0.03, 0.015, rng);
}

fn books(canvas: &mut Canvas, rng: &mut ChaCha8Rng) {
    let (width, height) = canvas.size();
    canvas.fill(0.06);
    let mut u = 0.005;
    while u < width {
        let thickness = rng.random_range(0.018..0.055);
        let top = height * rng.random_range(0.72..0.99);
        let tone = rng.random_range(0.12..0.85);
        let ink: f64 = if tone > 0.45 { 0.08 } else { 0.9 };
        canvas.rectangle(u, 0.0, u + thickness - 0.002, top, tone, 1.0);
        for band in [rng.random_range(0.08..0.2), rng.random_range(0.8..0.92)] {
            canvas.rectangle(u, band * top, u + thickness - 0.002, band * top + 0.008, ink, 0.7);
        }
        let mut v = top * rng.random_range(0.28..0.4);
        while v < 0.72 * top {
            let mark = rng.random_range(0.006..0.016);
            canvas.rectangle(u + 0.3 * thickness, v, u + 0.68 * thickness, v + mark, ink, 0.85);
            v += mark + rng.random_range(0.004..0.01);
        }
        u += thickness;
    }
    canvas.noise(0.02, 0.02, 0.03, rng);
}

fn sky(canvas: &mut Canvas, rng: &mut ChaCha8Rng) {
    canvas.fill(0.93);
    canvas.noise(0.5, 0.3, 0.03, rng);
}
