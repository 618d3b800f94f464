//! Corridors: long, plain, full of lines.

use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::World;
use super::builder::{Area, Placement, Wall, WorldBuilder};
use super::furniture::{self, DOOR_SIZE};
use super::room::{Shell, Texture, look_of, pictures, wall_material};
use crate::random::{mix, stream};
use crate::texture::Material;

/// The plan of a corridor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CorridorShape {
    /// Along +x, from `x = 0` to `x = length`, its center line on `y = 0`.
    Straight {
        /// Length between the end walls.
        length: f64,
    },
    /// Around a block; the center line is a rectangle about the origin.
    Ring {
        /// Length of the center line along x.
        length_x: f64,
        /// Length of the center line along y.
        length_y: f64,
    },
}

/// A corridor with doors, pictures and ceiling lamps.
#[derive(Clone, Debug, PartialEq)]
pub struct CorridorConfig {
    /// Its plan.
    pub shape: CorridorShape,
    /// Between the walls.
    pub width: f64,
    /// Between floor and ceiling.
    pub height: f64,
    /// How its faces are painted.
    pub texture: Texture,
    /// Every stretch of this length looks exactly the same, paint included. `None`: all differ.
    pub look_alike_every: Option<f64>,
    /// Seed of the layout and of the paint.
    pub seed: u64,
}

impl Default for CorridorConfig {
    fn default() -> Self {
        Self {
            shape: CorridorShape::Straight { length: 54.0 },
            width: 2.3,
            height: 2.6,
            texture: Texture::Poor,
            look_alike_every: None,
            seed: 0,
        }
    }
}

/// Length of the stretches between two lamps, each with doors on one or both sides.
const MODULE_LENGTH: f64 = 4.5;

impl CorridorConfig {
    /// Builds the corridor.
    pub fn build(&self) -> World {
        let mut b = WorldBuilder::new(self.seed, &[Vector3::x(), Vector3::y(), Vector3::z()]);
        match self.shape {
            CorridorShape::Straight { length } => self.straight(&mut b, length),
            CorridorShape::Ring { length_x, length_y } => self.ring(&mut b, length_x, length_y),
        }
        b.finish()
    }

    fn straight(&self, b: &mut WorldBuilder, length: f64) {
        let shell = Shell {
            middle: Vector3::new(0.5 * length, 0.0, 0.0),
            size: Vector3::new(length, self.width, self.height),
        };
        self.floor_and_ceiling(b, &shell);
        for (i, wall) in shell.walls().iter().enumerate() {
            self.fitted_wall(b, wall, i as u64);
        }
        self.lamps_along(b, Vector3::new(0.0, 0.0, 0.0), Vector3::x(), length);
    }

    fn ring(&self, b: &mut WorldBuilder, length_x: f64, length_y: f64) {
        let outer = Shell {
            middle: Vector3::zeros(),
            size: Vector3::new(length_x + self.width, length_y + self.width, self.height),
        };
        self.floor_and_ceiling(b, &outer);
        for (i, wall) in outer.walls().iter().enumerate() {
            self.fitted_wall(b, wall, i as u64);
        }
        let inner = Shell {
            middle: Vector3::zeros(),
            size: Vector3::new(length_x - self.width, length_y - self.width, self.height),
        };
        for (i, wall) in inner.walls().iter().enumerate() {
            let outside = Wall::between(wall.point(wall.length, 0.0, 0.0), wall.origin, wall.height);
            self.fitted_wall(b, &outside, 4 + i as u64);
        }
        let (hx, hy) = (0.5 * length_x, 0.5 * length_y);
        self.lamps_along(b, Vector3::new(-hx, -hy, 0.0), Vector3::x(), length_x);
        self.lamps_along(b, Vector3::new(hx, -hy, 0.0), Vector3::y(), length_y);
        self.lamps_along(b, Vector3::new(hx, hy, 0.0), -Vector3::x(), length_x);
        self.lamps_along(b, Vector3::new(-hx, hy, 0.0), -Vector3::y(), length_y);
    }

    fn floor_and_ceiling(&self, b: &mut WorldBuilder, shell: &Shell) {
        let look = look_of(self.texture);
        let floor = match self.texture {
            Texture::Rich => Material::Tiles { albedo: 0.5, pitch: 0.4 },
            Texture::Poor => look.floor,
        };
        let (dx, dy) = (Vector3::x() * shell.size.x, Vector3::y() * shell.size.y);
        let corner = shell.middle - 0.5 * (dx + dy);
        b.rectangle(corner, dx, dy, floor);
        b.rectangle(corner + dy + Vector3::z() * self.height, dx, -dy, look.ceiling);
    }

    /// A wall of modules, each with its doors and pictures.
    fn fitted_wall(&self, b: &mut WorldBuilder, wall: &Wall, index: u64) {
        let look = look_of(self.texture);
        let mut rng = stream(mix(self.seed, index), "corridor wall");
        let n_modules = (wall.length / self.look_alike_every.unwrap_or(MODULE_LENGTH)).floor() as u64;
        let pitch = self.look_alike_every.unwrap_or(wall.length / n_modules.max(1) as f64);
        if self.look_alike_every.is_some() && n_modules > 0 {
            self.repeated_wall(b, wall, pitch, index);
        } else {
            b.wall(wall, &[], wall_material(self.texture, 2 + index as usize, &mut rng));
        }
        let mut doors = Vec::new();
        for module in 0..n_modules {
            let label = if self.look_alike_every.is_some() { 0 } else { module };
            b.restart_paint(mix(mix(self.seed, 100 + index), label));
            let mut module_rng = stream(mix(mix(self.seed, index), label), "corridor module");
            doors.extend(self.module(b, wall, module as f64 * pitch, pitch, &mut module_rng));
        }
        if n_modules == 0 && wall.length > 1.6 {
            // The end of a corridor: a door in its middle.
            let u = 0.5 * (wall.length - DOOR_SIZE.0);
            furniture::door(b, wall, u, &look);
            doors.push(Area::new(u, u + DOOR_SIZE.0, 0.0, DOOR_SIZE.1));
        }
        furniture::skirting(b, wall, &doors, &look);
    }

    /// The bare wall in equal pieces with equal paint.
    fn repeated_wall(&self, b: &mut WorldBuilder, wall: &Wall, pitch: f64, index: u64) {
        let mut from = 0.0;
        while from < wall.length - 1e-9 {
            let to = f64::min(from + pitch, wall.length);
            b.restart_paint(mix(mix(self.seed, 200), index));
            let mut rng = stream(mix(self.seed, index), "repeated wall");
            let piece = Wall::between(wall.point(from, 0.0, 0.0), wall.point(to, 0.0, 0.0), wall.height);
            let material = wall_material(self.texture, 2 + index as usize, &mut rng);
            let surface =
                b.surface(piece.origin, piece.right * piece.length, Vector3::z() * piece.height, material);
            b.bare_face(surface, Area::new(0.0, piece.length, 0.0, piece.height));
            from = to;
        }
        for v in [0.0, wall.height] {
            b.edge(wall.point(0.0, v, 0.0), wall.point(wall.length, v, 0.0));
        }
    }

    /// One stretch of wall: usually a door, and beside it a picture or notices. Returns its door.
    fn module(
        &self,
        b: &mut WorldBuilder,
        wall: &Wall,
        from: f64,
        length: f64,
        rng: &mut ChaCha8Rng,
    ) -> Option<Area> {
        let look = look_of(self.texture);
        let u = from + rng.random_range(0.5..(length - DOOR_SIZE.0 - 1.6).max(0.6));
        let has_door = rng.random_bool(0.8);
        if has_door {
            furniture::door(b, wall, u, &look);
        }
        let beside = Area::new(u + DOOR_SIZE.0 + 0.3, from + length - 0.1, 1.1, 2.0);
        if rng.random_bool(0.5) {
            pictures(b, wall, beside, self.texture, rng);
        } else if beside.u1 - beside.u0 > 0.6 {
            let left = rng.random_range(beside.u0..beside.u1 - 0.5);
            furniture::poster(b, wall, Area::new(left, left + 0.42, 1.3, 1.9), Material::Text);
        }
        if u - from > 0.9 {
            let left = from + 0.25;
            furniture::poster(b, wall, Area::new(left, left + 0.3, 1.35, 1.77), Material::Text);
        }
        has_door.then(|| Area::new(u, u + DOOR_SIZE.0, 0.0, DOOR_SIZE.1))
    }

    /// Lamps under the ceiling, in flat housings.
    fn lamps_along(&self, b: &mut WorldBuilder, start: Vector3<f64>, along: Vector3<f64>, length: f64) {
        let pitch = self.look_alike_every.unwrap_or(MODULE_LENGTH);
        let yaw = along.y.atan2(along.x);
        let mut at = 0.5 * pitch;
        while at < length {
            let middle = start + along * at;
            let place = Placement::at(middle.x, middle.y, self.height, yaw);
            let housing = Material::Paint { albedo: 0.95 };
            b.cuboid(
                &place,
                Vector3::new(-0.6, -0.12, -0.06),
                Vector3::new(0.6, 0.12, 0.0),
                housing,
                housing,
            );
            b.light(middle + Vector3::z() * (self.height - 0.3), 0.62, 2.2);
            at += pitch;
        }
    }
}
