//! A cave of facets: corners and edges in plenty, and no direction that repeats.

use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::World;
use super::builder::WorldBuilder;
use crate::random::{stream, unit_vector};
use crate::texture::Material;

/// A closed shell of irregular triangles about the origin, with loose tetrahedra inside of it.
#[derive(Clone, Debug, PartialEq)]
pub struct UnstructuredConfig {
    /// Mean distance of the shell from the origin.
    pub radius: f64,
    /// Number of tetrahedra.
    pub n_tetrahedra: usize,
    /// Seed of the shapes and of the paint.
    pub seed: u64,
}

impl Default for UnstructuredConfig {
    fn default() -> Self {
        Self { radius: 4.2, n_tetrahedra: 22, seed: 0 }
    }
}

/// Relative spread of the shell's vertices about the mean radius.
const ROUGHNESS: f64 = 0.12;
/// The tetrahedra stay between these shares of the radius, out of the middle where cameras move.
const BELT: (f64, f64) = (0.58, 0.74);
/// Cameras move below and above this share of the radius.
const MAX_ELEVATION: f64 = 0.85;

impl UnstructuredConfig {
    /// Builds the cave.
    pub fn build(&self) -> World {
        let mut rng = stream(self.seed, "unstructured");
        let mut b = WorldBuilder::new(self.seed, &[]);
        b.light(Vector3::new(0.8, -0.6, 0.9), 0.7, 3.5);
        b.light(Vector3::new(-0.9, 0.7, 0.5), 0.5, 3.5);
        self.shell(&mut b, &mut rng);
        for _ in 0..self.n_tetrahedra {
            self.tetrahedron(&mut b, &mut rng);
        }
        b.finish()
    }

    /// A twice divided octahedron with its vertices displaced.
    fn shell(&self, b: &mut WorldBuilder, rng: &mut ChaCha8Rng) {
        let n = 4_i32;
        let mut displaced = std::collections::BTreeMap::new();
        let mut vertex = |i: i32, j: i32, k: i32| -> Vector3<f64> {
            *displaced.entry((i, j, k)).or_insert_with(|| {
                let direction = Vector3::new(f64::from(i), f64::from(j), f64::from(k)).normalize();
                let radius = self.radius * (1.0 + ROUGHNESS * rng.random_range(-1.0..1.0));
                (direction + 0.1 * unit_vector(rng)).normalize() * radius
            })
        };
        let mut triangles = Vec::new();
        for (sx, sy, sz) in [
            (1, 1, 1),
            (-1, 1, 1),
            (1, -1, 1),
            (-1, -1, 1),
            (1, 1, -1),
            (-1, 1, -1),
            (1, -1, -1),
            (-1, -1, -1),
        ] {
            for i in 0..n {
                for j in 0..(n - i) {
                    let mut at = |i: i32, j: i32| vertex(sx * i, sy * j, sz * (n - i - j));
                    triangles.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
                    if i + j < n - 1 {
                        triangles.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                    }
                }
            }
        }
        for (i, triangle) in triangles.iter().enumerate() {
            facing(b, *triangle, Vector3::zeros(), true, paint(i, rng));
        }
    }

    fn tetrahedron(&self, b: &mut WorldBuilder, rng: &mut ChaCha8Rng) {
        let direction = loop {
            let candidate = unit_vector(rng);
            if candidate.z.abs() < MAX_ELEVATION {
                break candidate;
            }
        };
        let middle = direction * self.radius * rng.random_range(BELT.0..BELT.1);
        let size = rng.random_range(0.35..0.7);
        let base = [
            Vector3::new(1.0, 1.0, 1.0),
            Vector3::new(-1.0, -1.0, 1.0),
            Vector3::new(-1.0, 1.0, -1.0),
            Vector3::new(1.0, -1.0, -1.0),
        ];
        let turn = nalgebra::Rotation3::new(unit_vector(rng) * rng.random_range(0.0..3.0));
        let corners =
            base.map(|corner| middle + turn * corner * (0.58 * size) + unit_vector(rng) * (0.15 * size));
        let centroid = corners.iter().sum::<Vector3<f64>>() / 4.0;
        for skip in 0..4 {
            let face: Vec<Vector3<f64>> = (0..4).filter(|i| *i != skip).map(|i| corners[i]).collect();
            facing(b, [face[0], face[1], face[2]], centroid, false, paint(skip + 1, rng));
        }
    }
}

/// Adds a triangle that is visible from `point`, or only from the other side.
fn facing(
    b: &mut WorldBuilder,
    triangle: [Vector3<f64>; 3],
    point: Vector3<f64>,
    visible: bool,
    material: Material,
) {
    let [p, q, r] = triangle;
    let towards = (q - p).cross(&(r - p)).dot(&(point - p)) > 0.0;
    b.polygon(&if towards == visible { [p, q, r] } else { [p, r, q] }, material);
}

fn paint(index: usize, rng: &mut ChaCha8Rng) -> Material {
    let albedo = rng.random_range(0.4..0.7);
    if index.is_multiple_of(3) {
        Material::Wallpaper { albedo }
    } else {
        Material::Plaster { albedo, contrast: 1.0 }
    }
}
