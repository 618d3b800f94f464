//! Gray levels of pixels, given which faces are seen.

use super::Renderer;
use super::rays::RayTable;
use super::visibility::{FaceView, FrameFaces, NOTHING, VisibilityMap};
use crate::texture::{Footprint, MipTexture};

/// Pixels in a row that share one estimate of their footprint on the texture.
const RUN: usize = 8;
/// Sub-samples of a pixel that shows more than one face: eight queens, so that no two share a row or column.
const SUB_SAMPLES: [(f32, f32); 8] = [
    (0.0625, 0.4375),
    (0.1875, 0.8125),
    (0.3125, 0.1875),
    (0.4375, 0.6875),
    (0.5625, 0.0625),
    (0.6875, 0.9375),
    (0.8125, 0.3125),
    (0.9375, 0.5625),
];

/// Shades whole rows of pixels, the first of them `first_row` of the image.
pub(crate) fn shade_band(renderer: &Renderer, frame: &FrameFaces, first_row: usize, pixels: &mut [f32]) {
    let width = renderer.camera.width() as usize;
    let n_rows = pixels.len() / width;
    let map = VisibilityMap::new(&renderer.rays, frame, first_row, first_row + n_rows);
    let textures: Vec<std::cell::OnceCell<&MipTexture>> =
        frame.faces.iter().map(|_| Default::default()).collect();
    let texture_of = |id: u16| {
        *textures[usize::from(id)].get_or_init(|| renderer.texture(frame.faces[usize::from(id)].surface))
    };
    for (row, line) in pixels.chunks_exact_mut(width).enumerate() {
        let y = first_row + row;
        let (upper, lower) = (map.row(y), map.row(y + 1));
        let mut x = 0;
        while x < width {
            let id = upper[x];
            let run_end = ((x / RUN + 1) * RUN).min(width);
            let interior =
                |x: usize| upper[x] == id && upper[x + 1] == id && lower[x] == id && lower[x + 1] == id;
            let end = (x..run_end).find(|x| !interior(*x)).unwrap_or(run_end);
            if end == x {
                line[x] = mixed_pixel(&renderer.rays, frame, &map, texture_of, x, y);
                x += 1;
                continue;
            }
            if id != NOTHING {
                let face = &frame.faces[usize::from(id)];
                plain_run(&renderer.rays, face, texture_of(id), x, y, &mut line[x..end]);
            }
            x = end;
        }
    }
}

/// Pixels that show one face each, and all the same one.
fn plain_run(rays: &RayTable, face: &FaceView, texture: &MipTexture, x: usize, y: usize, line: &mut [f32]) {
    let footprint = footprint(rays, face, x + line.len() / 2, y);
    // All rays of a whole run at once, though the run may be shorter: arrays of fixed length are vectorized,
    // and the table's padding lies behind the last row.
    let from = y * rays.stride + x;
    let below = from + rays.stride;
    let (x0, x1) = (&rays.corner_x[from..][..RUN + 1], &rays.corner_x[below..][..RUN + 1]);
    let (y0, y1) = (&rays.corner_y[from..][..RUN + 1], &rays.corner_y[below..][..RUN + 1]);
    let (z0, z1) = (&rays.corner_z[from..][..RUN + 1], &rays.corner_z[below..][..RUN + 1]);
    let (mut u, mut v) = ([0.0_f32; RUN], [0.0_f32; RUN]);
    for i in 0..RUN {
        // The sum of the corners: its length cancels.
        let ray = [
            (x0[i] + x0[i + 1]) + (x1[i] + x1[i + 1]),
            (y0[i] + y0[i + 1]) + (y1[i] + y1[i + 1]),
            (z0[i] + z0[i + 1]) + (z1[i] + z1[i + 1]),
        ];
        (u[i], v[i]) = face.texture_coordinates(ray);
    }
    line.copy_from_slice(&texture.sample(&u, &v, &footprint)[..line.len()]);
}

/// A pixel that shows several faces, or a face and nothing: the mean over its sub-samples, where each face is
/// looked up once, in the middle of its part.
fn mixed_pixel<'a>(
    rays: &RayTable,
    frame: &FrameFaces,
    map: &VisibilityMap,
    texture_of: impl Fn(u16) -> &'a MipTexture,
    x: usize,
    y: usize,
) -> f32 {
    let candidates = map.candidates(x, y);
    let seen = SUB_SAMPLES.map(|(fx, fy)| {
        let ray = inside_pixel(rays, x, y, fx, fy);
        let mut nearest = (NOTHING, 0.0_f32);
        for &id in candidates {
            if let Some(w) = frame.faces[usize::from(id)].meets(ray)
                && w > nearest.1
            {
                nearest = (id, w);
            }
        }
        nearest.0
    });
    let mut sum = 0.0;
    for (i, &id) in seen.iter().enumerate() {
        if id == NOTHING || seen[..i].contains(&id) {
            continue;
        }
        let (mut n, mut fx, mut fy) = (0.0, 0.0, 0.0);
        for (offset, _) in SUB_SAMPLES.iter().zip(&seen).filter(|(_, other)| **other == id) {
            n += 1.0;
            fx += offset.0;
            fy += offset.1;
        }
        let face = &frame.faces[usize::from(id)];
        let (u, v) = face.texture_coordinates(inside_pixel(rays, x, y, fx / n, fy / n));
        sum += n * texture_of(id).sample(&[u], &[v], &footprint(rays, face, x, y))[0];
    }
    sum / SUB_SAMPLES.len() as f32
}

/// The ray at a share of the way from a pixel's top left to its bottom right corner.
#[inline]
fn inside_pixel(rays: &RayTable, x: usize, y: usize, fx: f32, fy: f32) -> [f32; 3] {
    let i = y * rays.stride + x;
    let blend = |table: &[f32]| {
        let (upper, lower) = (&table[i..i + 2], &table[i + rays.stride..i + rays.stride + 2]);
        let top = upper[0] + (upper[1] - upper[0]) * fx;
        let bottom = lower[0] + (lower[1] - lower[0]) * fx;
        top + (bottom - top) * fy
    };
    [blend(&rays.corner_x), blend(&rays.corner_y), blend(&rays.corner_z)]
}

/// The footprint of pixel `(x, y)`, by differences.
fn footprint(rays: &RayTable, face: &FaceView, x: usize, y: usize) -> Footprint {
    let (u, v) = face.texture_coordinates(rays.corner(x, y));
    let (u_right, v_right) = face.texture_coordinates(rays.corner(x + 1, y));
    let (u_below, v_below) = face.texture_coordinates(rays.corner(x, y + 1));
    Footprint::new([u_right - u, v_right - v, u_below - u, v_below - v])
}
