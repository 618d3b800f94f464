//! One furnished room.

use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::World;
use super::builder::{Area, Placement, Wall, WorldBuilder};
use super::furniture::{self, DOOR_SIZE, Look};
use crate::random::stream;
use crate::texture::Material;

/// How much there is to see on the faces of a building.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Texture {
    /// Patterns at every scale, with corners everywhere.
    Rich,
    /// Plain paint: edges of walls, doors and furniture, and a few pictures.
    Poor,
}

/// A rectangular room, its floor's middle at the origin, with furniture along the walls and a table in the
/// middle.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomConfig {
    /// Length along x, along y, and height.
    pub size: Vector3<f64>,
    /// How its faces are painted.
    pub texture: Texture,
    /// Whether there is furniture. Without it, walls with a door and a window remain.
    pub furnished: bool,
    /// Seed of the layout and of the paint.
    pub seed: u64,
}

impl Default for RoomConfig {
    fn default() -> Self {
        Self { size: Vector3::new(6.4, 5.2, 2.7), texture: Texture::Rich, furnished: true, seed: 0 }
    }
}

impl RoomConfig {
    /// Builds the room.
    pub fn build(&self) -> World {
        let mut rng = stream(self.seed, "room");
        let mut b = WorldBuilder::new(self.seed, &[Vector3::x(), Vector3::y(), Vector3::z()]);
        let shell = Shell { middle: Vector3::zeros(), size: self.size };
        lamps(&mut b, &shell);
        furnish_room(&mut b, &shell, self.texture, self.furnished, &[None; 4], &mut rng);
        if self.furnished {
            let place = Placement::at(0.0, 0.0, 0.0, 0.0);
            let look = look_of(self.texture);
            let size = Vector3::new(1.3, 0.8, 0.74);
            furniture::table(&mut b, &place, size, &look);
            furniture::boxes_on(&mut b, &place, size, &look, &mut rng);
        }
        b.finish()
    }
}

/// The inside of a rectangular room.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shell {
    /// Middle of the floor.
    pub middle: Vector3<f64>,
    pub size: Vector3<f64>,
}

impl Shell {
    /// The walls towards +y, +x, -y and -x, as seen from inside.
    pub fn walls(&self) -> [Wall; 4] {
        let (hx, hy) = (0.5 * self.size.x, 0.5 * self.size.y);
        let corner = |sx: f64, sy: f64| self.middle + Vector3::new(sx * hx, sy * hy, 0.0);
        let wall = |from, to| Wall::between(from, to, self.size.z);
        [
            wall(corner(-1.0, 1.0), corner(1.0, 1.0)),
            wall(corner(1.0, 1.0), corner(1.0, -1.0)),
            wall(corner(1.0, -1.0), corner(-1.0, -1.0)),
            wall(corner(-1.0, -1.0), corner(-1.0, 1.0)),
        ]
    }
}

pub(crate) fn look_of(texture: Texture) -> Look {
    match texture {
        Texture::Rich => Look::rich(),
        Texture::Poor => Look::poor(),
    }
}

/// Two lamps below the ceiling.
pub(crate) fn lamps(b: &mut WorldBuilder, shell: &Shell) {
    for (x, y, intensity) in [(-0.22, 0.12, 0.75), (0.26, -0.15, 0.6)] {
        let offset = Vector3::new(x * shell.size.x, y * shell.size.y, shell.size.z - 0.25);
        b.light(shell.middle + offset, intensity, 2.6);
    }
}

/// Walls, floor and ceiling with their fittings. `doorways[i]` is an open passage in wall `i`.
pub(crate) fn furnish_room(
    b: &mut WorldBuilder,
    shell: &Shell,
    texture: Texture,
    furnished: bool,
    doorways: &[Option<Area>; 4],
    rng: &mut ChaCha8Rng,
) {
    let look = look_of(texture);
    let (dx, dy) = (Vector3::x() * shell.size.x, Vector3::y() * shell.size.y);
    let corner = shell.middle - 0.5 * (dx + dy);
    b.rectangle(corner, dx, dy, look.floor);
    b.rectangle(corner + dy + Vector3::z() * shell.size.z, dx, -dy, look.ceiling);
    let first = rng.random_range(0..4);
    for (i, wall) in shell.walls().iter().enumerate() {
        let openings: Vec<Area> = doorways[i].into_iter().collect();
        b.wall(wall, &openings, wall_material(texture, i, rng));
        let mut gaps = openings.clone();
        for opening in &openings {
            furniture::doorway_frame(b, wall, *opening, &look);
        }
        match ((i + first) % 4, openings.is_empty()) {
            (0, true) => gaps.push(wall_with_door(b, wall, texture, rng)),
            (2, true) => wall_with_window(b, wall, texture, furnished, rng),
            (_, true) if furnished => wall_with_shelves(b, wall, texture, rng),
            (_, true) => pictures(b, wall, Area::new(0.4, wall.length - 0.4, 1.2, 2.1), texture, rng),
            (_, false) => {
                let opening = openings[0];
                pictures(b, wall, Area::new(0.2, opening.u0 - 0.3, 0.9, 2.2), texture, rng);
                pictures(b, wall, Area::new(opening.u1 + 0.3, wall.length - 0.2, 0.9, 2.2), texture, rng);
            }
        }
        furniture::skirting(b, wall, &gaps, &look);
    }
}

pub(crate) fn wall_material(texture: Texture, index: usize, rng: &mut ChaCha8Rng) -> Material {
    let albedo = rng.random_range(0.55..0.7);
    match (texture, index % 4) {
        (Texture::Poor, _) => Material::Paint { albedo: albedo + 0.08 },
        (Texture::Rich, 0) => Material::Bricks { albedo: albedo - 0.12 },
        (Texture::Rich, 2) => Material::Plaster { albedo, contrast: 1.0 },
        (Texture::Rich, _) => Material::Wallpaper { albedo },
    }
}

/// A door at a random place and pictures beside it; returns the area of the door.
fn wall_with_door(b: &mut WorldBuilder, wall: &Wall, texture: Texture, rng: &mut ChaCha8Rng) -> Area {
    let look = look_of(texture);
    let u = rng.random_range(0.5..wall.length - DOOR_SIZE.0 - 0.5);
    furniture::door(b, wall, u, &look);
    let area = Area::new(u, u + DOOR_SIZE.0, 0.0, DOOR_SIZE.1);
    pictures(b, wall, Area::new(0.2, u - 0.3, 0.8, 2.2), texture, rng);
    pictures(b, wall, Area::new(area.u1 + 0.3, wall.length - 0.2, 0.8, 2.2), texture, rng);
    area
}

fn wall_with_window(
    b: &mut WorldBuilder,
    wall: &Wall,
    texture: Texture,
    furnished: bool,
    rng: &mut ChaCha8Rng,
) {
    let look = look_of(texture);
    let width = rng.random_range(1.2..1.7);
    let u = rng.random_range(0.8..(wall.length - width - 0.8));
    furniture::window(b, wall, Area::new(u, u + width, 1.0, 2.2), &look);
    if furnished {
        let area = Area::new(u - 0.1, u + width + 0.2, 0.0, 0.7);
        furniture::cupboard(b, wall, area, 0.4, &look);
    }
    pictures(b, wall, Area::new(0.2, u - 0.35, 0.7, 2.1), texture, rng);
    pictures(b, wall, Area::new(u + width + 0.35, wall.length - 0.2, 0.7, 2.1), texture, rng);
}

fn wall_with_shelves(b: &mut WorldBuilder, wall: &Wall, texture: Texture, rng: &mut ChaCha8Rng) {
    let look = look_of(texture);
    let width = rng.random_range(1.0..1.5);
    let u = rng.random_range(0.3..0.5 * (wall.length - width));
    let height = rng.random_range(1.5..2.0);
    let books = match texture {
        Texture::Rich => Material::Books,
        Texture::Poor => Material::Paint { albedo: 0.25 },
    };
    furniture::bookshelf(b, wall, Area::new(u, u + width, 0.0, height), 0.32, &look, books);
    pictures(b, wall, Area::new(u + width + 0.3, wall.length - 0.2, 0.8, 2.2), texture, rng);
}

/// Pictures and posters side by side in `area`: close together where the look is rich, at most one else.
pub(crate) fn pictures(
    b: &mut WorldBuilder,
    wall: &Wall,
    area: Area,
    texture: Texture,
    rng: &mut ChaCha8Rng,
) {
    let look = look_of(texture);
    let mut u = area.u0 + rng.random_range(0.0..0.25);
    loop {
        let (width, height) = (rng.random_range(0.45..0.9), rng.random_range(0.4..0.9));
        if u + width > area.u1 || area.v1 - area.v0 < height {
            return;
        }
        let v = area.v0 + rng.random_range(0.0..=(area.v1 - area.v0 - height));
        let place = Area::new(u, u + width, v, v + height);
        match (texture, rng.random_range(0..3)) {
            (Texture::Rich, 0) => furniture::poster(b, wall, place, Material::Text),
            (Texture::Rich, 1) => furniture::poster(b, wall, place, Material::Print),
            _ => furniture::picture(b, wall, place, &look),
        }
        if texture == Texture::Poor {
            return;
        }
        u += width + rng.random_range(0.15..0.45);
    }
}
