//! Four rooms in a square, joined by open doorways.

use nalgebra::Vector3;

use super::World;
use super::builder::{Area, Wall, WorldBuilder};
use super::room::{Shell, Texture, furnish_room, lamps, look_of};
use crate::random::{mix, stream};

/// Four rooms about the origin, numbered counter-clockwise from (-x, -y). Each opens to the next and to the
/// previous one.
#[derive(Clone, Debug, PartialEq)]
pub struct FourRoomsConfig {
    /// Inside of every room.
    pub room_size: Vector3<f64>,
    /// Thickness of the walls between rooms.
    pub wall_thickness: f64,
    /// Width of the doorways.
    pub doorway_width: f64,
    /// How the faces are painted.
    pub texture: Texture,
    /// Seed of the layout and of the paint.
    pub seed: u64,
}

impl Default for FourRoomsConfig {
    fn default() -> Self {
        Self {
            room_size: Vector3::new(5.4, 4.8, 2.7),
            wall_thickness: 0.16,
            doorway_width: 1.3,
            texture: Texture::Rich,
            seed: 0,
        }
    }
}

/// Height of the doorways.
const DOORWAY_HEIGHT: f64 = 2.15;
/// For the rooms counter-clockwise from (-x, -y): the walls (as [`Shell::walls`] counts) with a doorway.
const OPEN_WALLS: [[usize; 2]; 4] = [[0, 1], [0, 3], [2, 3], [1, 2]];

impl FourRoomsConfig {
    /// Middle of the floor of room `index`, counter-clockwise from (-x, -y).
    pub fn room_middle(&self, index: usize) -> Vector3<f64> {
        let half = 0.5 * (self.room_size + Vector3::repeat(self.wall_thickness));
        let (sx, sy) = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)][index % 4];
        Vector3::new(sx * half.x, sy * half.y, 0.0)
    }

    /// Builds the floor.
    pub fn build(&self) -> World {
        let mut b = WorldBuilder::new(self.seed, &[Vector3::x(), Vector3::y(), Vector3::z()]);
        for (room, open_walls) in OPEN_WALLS.iter().enumerate() {
            let mut rng = stream(mix(self.seed, room as u64), "room of a floor");
            let shell = Shell { middle: self.room_middle(room), size: self.room_size };
            lamps(&mut b, &shell);
            let mut doorways = [None; 4];
            for &wall in open_walls {
                doorways[wall] = Some(self.doorway(&shell.walls()[wall]));
            }
            furnish_room(&mut b, &shell, self.texture, true, &doorways, &mut rng);
            // Each passage is lined once, from the room whose wall 0 or 1 it is in.
            for &wall in open_walls.iter().filter(|wall| **wall < 2) {
                self.line_passage(&mut b, &shell.walls()[wall]);
            }
        }
        b.finish()
    }

    fn doorway(&self, wall: &Wall) -> Area {
        let u = 0.5 * (wall.length - self.doorway_width);
        Area::new(u, u + self.doorway_width, 0.0, DOORWAY_HEIGHT)
    }

    /// The four faces inside of the thickness of a wall.
    fn line_passage(&self, b: &mut WorldBuilder, wall: &Wall) {
        let look = look_of(self.texture);
        let Area { u0, u1, v1, .. } = self.doorway(wall);
        let through = wall.point(0.0, 0.0, -self.wall_thickness) - wall.point(0.0, 0.0, 0.0);
        let (up, across) = (Vector3::z() * v1, wall.right * (u1 - u0));
        b.rectangle(wall.point(u0, 0.0, 0.0), through, up, look.wood);
        b.rectangle(wall.point(u1, 0.0, -self.wall_thickness), -through, up, look.wood);
        b.rectangle(wall.point(u0, v1, -self.wall_thickness), across, -through, look.wood);
        b.rectangle(wall.point(u0, 0.0, 0.0), across, through, look.wood);
    }
}
