//! Worlds of flat textured faces, and what is true of them.

mod atlanta;
mod builder;
mod corridor;
mod floor;
mod furniture;
mod room;
mod unstructured;

use geometry::Direction;
use nalgebra::{Vector2, Vector3};

pub use atlanta::AtlantaConfig;
pub use corridor::{CorridorConfig, CorridorShape};
pub use floor::FourRoomsConfig;
pub use room::{RoomConfig, Texture};
pub use unstructured::UnstructuredConfig;

use crate::texture::Material;

/// Which world to build.
#[derive(Clone, Debug, PartialEq)]
pub enum WorldConfig {
    /// One furnished room.
    Room(RoomConfig),
    /// A straight or a closed corridor.
    Corridor(CorridorConfig),
    /// Four rooms in a square, joined by doorways.
    FourRooms(FourRoomsConfig),
    /// A hall of blocks in three horizontal orientations that are not orthogonal (an "Atlanta world").
    Atlanta(AtlantaConfig),
    /// A cave of facets in which no two edges are parallel by design.
    Unstructured(UnstructuredConfig),
}

impl WorldConfig {
    /// Builds the world.
    pub fn build(&self) -> World {
        match self {
            Self::Room(config) => config.build(),
            Self::Corridor(config) => config.build(),
            Self::FourRooms(config) => config.build(),
            Self::Atlanta(config) => config.build(),
            Self::Unstructured(config) => config.build(),
        }
    }
}

/// A set of textured, opaque, one-sided convex faces under fixed lamps, and the truth about its lines.
#[derive(Clone, Debug)]
pub struct World {
    pub(crate) surfaces: Vec<Surface>,
    pub(crate) faces: Vec<Face>,
    pub(crate) lights: Vec<Light>,
    pub(crate) segments: Vec<TrueSegment>,
    pub(crate) vanishing_directions: Vec<Direction>,
}

/// A textured plane. Several faces may lie on one surface and share its texture without a seam.
#[derive(Clone, Debug)]
pub struct Surface {
    /// The texture's corner `(0, 0)`, in the world.
    pub origin: Vector3<f64>,
    /// Unit direction of texture coordinate `u`.
    pub u_axis: Vector3<f64>,
    /// Unit direction of texture coordinate `v`, orthogonal to `u_axis`.
    pub v_axis: Vector3<f64>,
    /// Extent of the texture along `u` and `v`.
    pub size: Vector2<f64>,
    /// What it is painted with.
    pub material: Material,
    /// Seed of the painting.
    pub seed: u64,
}

impl Surface {
    /// Unit normal, on the side from which the surface is visible.
    pub fn normal(&self) -> Vector3<f64> {
        self.u_axis.cross(&self.v_axis)
    }

    /// The world point at texture coordinates `uv`.
    pub fn point(&self, uv: &Vector2<f64>) -> Vector3<f64> {
        self.origin + self.u_axis * uv.x + self.v_axis * uv.y
    }
}

/// A convex piece of a surface.
#[derive(Clone, Debug)]
pub(crate) struct Face {
    pub surface: usize,
    /// Corners in texture coordinates, counter-clockwise as seen from the visible side.
    pub corners: Vec<Vector2<f64>>,
}

/// A lamp: a point that shines equally in all directions, with a softened decay.
#[derive(Clone, Debug)]
pub struct Light {
    /// Position in the world.
    pub position: Vector3<f64>,
    /// Radiance that it adds to a white face nearby that is turned to it, as a share of full white.
    pub intensity: f64,
    /// Distance at which its contribution has halved.
    pub reach: f64,
}

/// A straight edge of the world along which shape or material changes.
#[derive(Clone, Debug, PartialEq)]
pub struct TrueSegment {
    /// One end, in the world.
    pub start: Vector3<f64>,
    /// The other end, in the world.
    pub end: Vector3<f64>,
    /// Index into [`World::vanishing_directions`] of the family it is parallel to, if any.
    pub family: Option<usize>,
}

/// Where a ray meets the world.
#[derive(Clone, Debug, PartialEq)]
pub struct RayHit {
    /// Distance along the ray, in lengths of its direction vector.
    pub distance: f64,
    /// The point, in the world.
    pub point: Vector3<f64>,
    /// Unit normal of the face, towards the ray's origin.
    pub normal: Vector3<f64>,
    /// Index of the surface, into [`World::surfaces`].
    pub surface: usize,
    /// Texture coordinates on that surface.
    pub uv: Vector2<f64>,
}

/// Rays that hit closer than this start on the face itself.
const MIN_RAY_DISTANCE: f64 = 1e-6;

impl World {
    /// All surfaces.
    pub fn surfaces(&self) -> &[Surface] {
        &self.surfaces
    }

    /// All lamps.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }

    /// Every edge of the world, each once. Whether a camera can see one is another question: see
    /// [`crate::Sequence::visible_segments`].
    pub fn segments(&self) -> &[TrueSegment] {
        &self.segments
    }

    /// The axis of each direction family. In a Manhattan world these are the three room axes.
    pub fn vanishing_directions(&self) -> &[Direction] {
        &self.vanishing_directions
    }

    /// The first visible face along `origin + s * direction`, `s > 0`. Faces are one-sided.
    pub fn cast_ray(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<RayHit> {
        let mut nearest: Option<RayHit> = None;
        for face in &self.faces {
            let limit = nearest.as_ref().map_or(f64::INFINITY, |hit| hit.distance);
            if let Some(hit) = self.intersect(face, origin, direction, limit) {
                nearest = Some(hit);
            }
        }
        nearest
    }

    /// Whether nothing stands between two points. Faces that touch either point do not count.
    pub fn is_visible_between(&self, from: &Vector3<f64>, to: &Vector3<f64>, tolerance: f64) -> bool {
        let offset = to - from;
        let length = offset.norm();
        if length <= tolerance {
            return true;
        }
        let direction = offset / length;
        !self.faces.iter().any(|face| self.intersect(face, from, &direction, length - tolerance).is_some())
    }

    /// Distance from `point` to the nearest face.
    pub fn clearance(&self, point: &Vector3<f64>) -> f64 {
        self.faces.iter().map(|face| self.distance_to_face(face, point)).fold(f64::INFINITY, f64::min)
    }

    fn intersect(
        &self,
        face: &Face,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        limit: f64,
    ) -> Option<RayHit> {
        let surface = &self.surfaces[face.surface];
        let normal = surface.normal();
        let approach = normal.dot(direction);
        if approach >= 0.0 {
            return None;
        }
        let distance = normal.dot(&(surface.origin - origin)) / approach;
        if !(distance > MIN_RAY_DISTANCE && distance < limit) {
            return None;
        }
        let point = origin + direction * distance;
        let offset = point - surface.origin;
        let uv = Vector2::new(surface.u_axis.dot(&offset), surface.v_axis.dot(&offset));
        face.contains(&uv).then_some(RayHit { distance, point, normal, surface: face.surface, uv })
    }

    fn distance_to_face(&self, face: &Face, point: &Vector3<f64>) -> f64 {
        let surface = &self.surfaces[face.surface];
        let offset = point - surface.origin;
        let uv = Vector2::new(surface.u_axis.dot(&offset), surface.v_axis.dot(&offset));
        let height = surface.normal().dot(&offset);
        if face.contains(&uv) {
            return height.abs();
        }
        let in_plane =
            face.edges().map(|(a, b)| distance_to_segment(&uv, &a, &b)).fold(f64::INFINITY, f64::min);
        height.hypot(in_plane)
    }
}

impl Face {
    /// The sides, in order.
    pub(crate) fn edges(&self) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + '_ {
        let n = self.corners.len();
        (0..n).map(move |i| (self.corners[i], self.corners[(i + 1) % n]))
    }

    fn contains(&self, uv: &Vector2<f64>) -> bool {
        self.edges().all(|(a, b)| (b - a).perp(&(uv - a)) >= 0.0)
    }
}

fn distance_to_segment(p: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    let along = b - a;
    let share = ((p - a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    (p - (a + along * share)).norm()
}
