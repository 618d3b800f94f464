//! What stands in rooms and hangs on walls.

use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::builder::{Area, Placement, Wall, WorldBuilder};
use crate::texture::Material;

/// Width and height of a door leaf.
pub(crate) const DOOR_SIZE: (f64, f64) = (0.92, 2.06);
/// Width of door, window and picture frames.
const FRAME_WIDTH: f64 = 0.07;
/// How far frames stand out from the wall.
const FRAME_DEPTH: f64 = 0.03;
const SKIRTING_HEIGHT: f64 = 0.1;
const SKIRTING_DEPTH: f64 = 0.018;

/// How the parts of a building are painted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    pub floor: Material,
    pub ceiling: Material,
    pub skirting: Material,
    pub door: Material,
    pub frame: Material,
    pub wood: Material,
    pub box_side: Material,
    /// Fills frames.
    pub picture: Material,
}

impl Look {
    pub fn rich() -> Self {
        Self {
            floor: Material::Planks { albedo: 0.42 },
            ceiling: Material::Plaster { albedo: 0.78, contrast: 0.25 },
            skirting: Material::Planks { albedo: 0.3 },
            door: Material::Planks { albedo: 0.5 },
            frame: Material::Planks { albedo: 0.22 },
            wood: Material::Planks { albedo: 0.55 },
            box_side: Material::Print,
            picture: Material::Print,
        }
    }

    pub fn poor() -> Self {
        Self {
            floor: Material::Paint { albedo: 0.4 },
            ceiling: Material::Paint { albedo: 0.85 },
            skirting: Material::Paint { albedo: 0.45 },
            door: Material::Paint { albedo: 0.48 },
            frame: Material::Paint { albedo: 0.3 },
            wood: Material::Paint { albedo: 0.5 },
            box_side: Material::Paint { albedo: 0.36 },
            picture: Material::Landscape,
        }
    }
}

/// Four bars around `area`, on the wall from `from` to `to`; `bottom` leaves out the lower one for doors.
fn frame(b: &mut WorldBuilder, wall: &Wall, area: Area, out: (f64, f64), bottom: bool, material: Material) {
    let w = FRAME_WIDTH;
    let bars = [
        Area::new(area.u0 - w, area.u0, if bottom { area.v0 - w } else { area.v0 }, area.v1 + w),
        Area::new(area.u1, area.u1 + w, if bottom { area.v0 - w } else { area.v0 }, area.v1 + w),
        Area::new(area.u0, area.u1, area.v1, area.v1 + w),
        Area::new(area.u0, area.u1, area.v0 - w, area.v0),
    ];
    for bar in &bars[..if bottom { 4 } else { 3 }] {
        b.panel(wall, *bar, out.0, out.1, material, material);
    }
}

/// A closed door whose left side is at `u`.
pub(crate) fn door(b: &mut WorldBuilder, wall: &Wall, u: f64, look: &Look) {
    let area = Area::new(u, u + DOOR_SIZE.0, 0.0, DOOR_SIZE.1);
    frame(b, wall, area, (0.0, 0.045), false, look.frame);
    b.panel(wall, area, 0.0, 0.012, look.door, look.door);
    let handle = Area::new(area.u1 - 0.12, area.u1 - 0.04, 1.02, 1.05);
    b.panel(wall, handle, 0.012, 0.06, look.frame, look.frame);
    // A name plate, so that doors can be told apart where the look is rich.
    b.panel(wall, Area::new(area.u0 + 0.3, area.u1 - 0.3, 1.5, 1.62), 0.012, 0.02, look.picture, look.frame);
}

/// The frame around an open doorway.
pub(crate) fn doorway_frame(b: &mut WorldBuilder, wall: &Wall, opening: Area, look: &Look) {
    frame(b, wall, opening, (0.0, FRAME_DEPTH), false, look.frame);
}

/// A window of two panes.
pub(crate) fn window(b: &mut WorldBuilder, wall: &Wall, area: Area, look: &Look) {
    frame(b, wall, area, (0.0, 0.05), true, look.frame);
    b.panel(wall, area, 0.0, 0.006, Material::Sky, look.frame);
    let middle = 0.5 * (area.u0 + area.u1);
    b.panel(
        wall,
        Area::new(middle - 0.03, middle + 0.03, area.v0, area.v1),
        0.006,
        0.05,
        look.frame,
        look.frame,
    );
    let sill = Area::new(area.u0 - 0.12, area.u1 + 0.12, area.v0 - FRAME_WIDTH - 0.03, area.v0 - FRAME_WIDTH);
    b.panel(wall, sill, 0.0, 0.16, look.wood, look.wood);
}

/// A framed picture.
pub(crate) fn picture(b: &mut WorldBuilder, wall: &Wall, area: Area, look: &Look) {
    let inner = area.shrunk(FRAME_WIDTH);
    frame(b, wall, inner, (0.0, FRAME_DEPTH), true, look.frame);
    b.panel(wall, inner, 0.0, 0.015, look.picture, look.frame);
}

/// A sheet pinned to the wall.
pub(crate) fn poster(b: &mut WorldBuilder, wall: &Wall, area: Area, material: Material) {
    b.panel(wall, area, 0.0, 0.008, material, Material::Paint { albedo: 0.8 });
}

/// Skirting along the wall except across `gaps` (sorted along the wall).
pub(crate) fn skirting(b: &mut WorldBuilder, wall: &Wall, gaps: &[Area], look: &Look) {
    let mut from = 0.0;
    let ends = gaps.iter().map(|gap| (gap.u0 - FRAME_WIDTH, gap.u1 + FRAME_WIDTH));
    for (to, next) in ends.chain([(wall.length, wall.length)]) {
        if to - from > 0.05 {
            let area = Area::new(from, to, 0.0, SKIRTING_HEIGHT);
            b.panel(wall, area, 0.0, SKIRTING_DEPTH, look.skirting, look.skirting);
        }
        from = next;
    }
}

/// Shelves with books, standing against the wall.
pub(crate) fn bookshelf(
    b: &mut WorldBuilder,
    wall: &Wall,
    area: Area,
    depth: f64,
    look: &Look,
    books: Material,
) {
    let board = 0.03;
    let n_shelves = ((area.v1 - area.v0) / 0.36).round().max(2.0) as usize;
    b.panel(wall, Area::new(area.u0, area.u0 + board, area.v0, area.v1), 0.0, depth, look.wood, look.wood);
    b.panel(wall, Area::new(area.u1 - board, area.u1, area.v0, area.v1), 0.0, depth, look.wood, look.wood);
    let pitch = (area.v1 - area.v0 - board) / n_shelves as f64;
    for shelf in 0..=n_shelves {
        let v = area.v0 + pitch * shelf as f64;
        b.panel(
            wall,
            Area::new(area.u0 + board, area.u1 - board, v, v + board),
            0.0,
            depth,
            look.wood,
            look.wood,
        );
        if shelf < n_shelves {
            let row = Area::new(area.u0 + board, area.u1 - board, v + board, v + 0.8 * pitch);
            b.panel(wall, row, 0.0, 0.7 * depth, books, look.wood);
        }
    }
}

/// A cupboard with two doors, standing against the wall.
pub(crate) fn cupboard(b: &mut WorldBuilder, wall: &Wall, area: Area, depth: f64, look: &Look) {
    b.panel(wall, area, 0.0, depth, look.door, look.wood);
    let middle = 0.5 * (area.u0 + area.u1);
    for leaf in [Area::new(area.u0, middle, area.v0, area.v1), Area::new(middle, area.u1, area.v0, area.v1)] {
        b.panel(wall, leaf.shrunk(0.03), depth, depth + 0.02, look.wood, look.frame);
    }
}

/// A table of `size` (length, width, height), its middle at the placement.
pub(crate) fn table(b: &mut WorldBuilder, place: &Placement, size: Vector3<f64>, look: &Look) {
    let (hx, hy, top) = (0.5 * size.x, 0.5 * size.y, size.z);
    b.cuboid(place, Vector3::new(-hx, -hy, top - 0.04), Vector3::new(hx, hy, top), look.frame, look.wood);
    let (inset, leg) = (0.05, 0.06);
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
        let middle = Vector3::new(sx * (hx - inset - 0.5 * leg), sy * (hy - inset - 0.5 * leg), 0.0);
        let half = Vector3::new(0.5 * leg, 0.5 * leg, 0.0);
        b.cuboid(place, middle - half, middle + half + Vector3::z() * (top - 0.04), look.frame, look.frame);
    }
}

/// Boxes side by side on a table top, turned by multiples of a right angle.
pub(crate) fn boxes_on(
    b: &mut WorldBuilder,
    place: &Placement,
    size: Vector3<f64>,
    look: &Look,
    rng: &mut ChaCha8Rng,
) {
    let mut x = -0.5 * size.x + 0.06;
    loop {
        let (length, width) = (rng.random_range(0.16..0.34), rng.random_range(0.15..0.3));
        let height = rng.random_range(0.1..0.36);
        if x + length > 0.5 * size.x - 0.04 {
            break;
        }
        let spare = (0.5 * (size.y - width) - 0.03).max(0.0);
        let y = rng.random_range(-1.0..1.0) * spare;
        let low = Vector3::new(x, y - 0.5 * width, size.z);
        b.cuboid(place, low, low + Vector3::new(length, width, height), look.box_side, look.box_side);
        x += length + rng.random_range(0.05..0.15);
    }
}
