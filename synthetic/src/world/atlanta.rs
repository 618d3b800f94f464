//! A hall with blocks in three horizontal orientations that are not orthogonal to each other.

use nalgebra::Vector3;
use rand::Rng;

use super::World;
use super::builder::{Area, Placement, Wall, WorldBuilder};
use super::furniture;
use super::room::{Shell, Texture, lamps, look_of, pictures, wall_material};
use crate::random::stream;
use crate::texture::Material;

/// A hall about the origin whose walls, and blocks inside of it, follow three horizontal directions and the
/// vertical.
#[derive(Clone, Debug, PartialEq)]
pub struct AtlantaConfig {
    /// Length along x, along y, and height of the hall.
    pub size: Vector3<f64>,
    /// The three horizontal directions. A block turned by one of them also has edges at right angles to it
    /// unless it is a slab, whose short sides are too short to be listed.
    pub directions_deg: [f64; 3],
    /// How the faces are painted.
    pub texture: Texture,
    /// Seed of the layout and of the paint.
    pub seed: u64,
}

impl Default for AtlantaConfig {
    fn default() -> Self {
        Self {
            size: Vector3::new(11.0, 10.0, 3.2),
            directions_deg: [0.0, 35.0, 70.0],
            texture: Texture::Poor,
            seed: 0,
        }
    }
}

/// Thickness of the slabs; under the length from which edges are listed.
const SLAB_THICKNESS: f64 = 0.1;
/// Slabs stand between this radius and the walls.
const SLAB_RADIUS: f64 = 3.6;
const N_SLABS: usize = 9;

impl AtlantaConfig {
    /// Builds the hall.
    pub fn build(&self) -> World {
        let mut rng = stream(self.seed, "atlanta");
        let axis = |deg: f64| Vector3::new(deg.to_radians().cos(), deg.to_radians().sin(), 0.0);
        let [a, c, d] = self.directions_deg.map(axis);
        // The hall has walls across x as well.
        let mut b = WorldBuilder::new(self.seed, &[a, c, d, Vector3::z(), Vector3::y()]);
        let look = look_of(self.texture);
        let shell = Shell { middle: Vector3::zeros(), size: self.size };
        lamps(&mut b, &shell);
        b.light(Vector3::new(0.0, 0.0, self.size.z - 0.4), 0.5, 3.0);
        self.hall(&mut b, &shell);
        for i in 0..N_SLABS {
            let around = (i as f64 + rng.random_range(-0.15..0.15)) / N_SLABS as f64 * std::f64::consts::TAU;
            let yaw = self.directions_deg[i % 3].to_radians();
            let place = Placement::at(SLAB_RADIUS * around.cos(), SLAB_RADIUS * around.sin(), 0.0, yaw);
            let half = 0.5 * rng.random_range(1.2..1.9);
            let height = rng.random_range(1.3..2.4);
            let low = Vector3::new(-half, -0.5 * SLAB_THICKNESS, 0.0);
            let high = Vector3::new(half, 0.5 * SLAB_THICKNESS, height);
            let paint = wall_material(self.texture, i, &mut rng);
            b.cuboid(&place, low, high, paint, look.wood);
            for (from, to) in [(low.x, high.x), (high.x, low.x)] {
                let y = if from < to { low.y } else { high.y };
                let side = Wall::between(place.point(from, y, 0.0), place.point(to, y, 0.0), height);
                pictures(
                    &mut b,
                    &side,
                    Area::new(0.05, side.length, 0.4, height - 0.2),
                    self.texture,
                    &mut rng,
                );
            }
        }
        b.finish()
    }

    fn hall(&self, b: &mut WorldBuilder, shell: &Shell) {
        let look = look_of(self.texture);
        let mut rng = stream(self.seed, "atlanta hall");
        let (dx, dy) = (Vector3::x() * shell.size.x, Vector3::y() * shell.size.y);
        let corner = -0.5 * (dx + dy);
        b.rectangle(corner, dx, dy, Material::Plaster { albedo: 0.45, contrast: 0.5 });
        b.rectangle(corner + dy + Vector3::z() * shell.size.z, dx, -dy, look.ceiling);
        for (i, wall) in shell.walls().iter().enumerate() {
            b.wall(wall, &[], wall_material(self.texture, i, &mut rng));
            furniture::skirting(b, wall, &[], &look);
            let area = Area::new(0.3, wall.length - 0.3, 1.0, 2.4);
            pictures(b, wall, area, Texture::Rich, &mut rng);
        }
    }
}
