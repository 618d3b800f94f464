//! Assembles a world out of walls, panels and boxes, and collects its edges on the way.

use geometry::Direction;
use nalgebra::{Vector2, Vector3};

use super::{Face, Light, Surface, TrueSegment, World};
use crate::random::mix;
use crate::texture::Material;

/// Edges shorter than this are too short to be a line in an image and are not listed.
const MIN_SEGMENT_LENGTH: f64 = 0.12;
/// Edges within this angle of a family's axis belong to it; constructions are exact up to rounding.
const FAMILY_ANGLE_RAD: f64 = 1e-6;
/// Edges whose ends agree to this are the same edge.
const SAME_POINT: f64 = 1e-6;

/// A right-handed frame standing on the floor, turned about the vertical.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    pub origin: Vector3<f64>,
    pub yaw: f64,
}

impl Placement {
    pub fn at(x: f64, y: f64, z: f64, yaw: f64) -> Self {
        Self { origin: Vector3::new(x, y, z), yaw }
    }

    pub fn axis_x(&self) -> Vector3<f64> {
        Vector3::new(self.yaw.cos(), self.yaw.sin(), 0.0)
    }

    pub fn axis_y(&self) -> Vector3<f64> {
        Vector3::new(-self.yaw.sin(), self.yaw.cos(), 0.0)
    }

    pub fn point(&self, x: f64, y: f64, z: f64) -> Vector3<f64> {
        self.origin + self.axis_x() * x + self.axis_y() * y + Vector3::z() * z
    }
}

/// A wall as seen by someone who faces it: `origin` bottom left, `right` unit, height along `z`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wall {
    pub origin: Vector3<f64>,
    pub right: Vector3<f64>,
    pub length: f64,
    pub height: f64,
}

impl Wall {
    /// Between two floor points, visible from the side on which `from` is to the left of `to`.
    pub fn between(from: Vector3<f64>, to: Vector3<f64>, height: f64) -> Self {
        let along = to - from;
        Self { origin: from, right: along.normalize(), length: along.norm(), height }
    }

    /// The point `u` to the right, `v` up and `out` towards the viewer.
    pub fn point(&self, u: f64, v: f64, out: f64) -> Vector3<f64> {
        self.origin + self.right * u + Vector3::z() * v + self.right.cross(&Vector3::z()) * out
    }
}

/// A rectangle `[u0, u1] x [v0, v1]` on a wall.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Area {
    pub u0: f64,
    pub u1: f64,
    pub v0: f64,
    pub v1: f64,
}

impl Area {
    pub fn new(u0: f64, u1: f64, v0: f64, v1: f64) -> Self {
        Self { u0, u1, v0, v1 }
    }

    /// Smaller by `margin` on every side.
    pub fn shrunk(&self, margin: f64) -> Self {
        Self::new(self.u0 + margin, self.u1 - margin, self.v0 + margin, self.v1 - margin)
    }
}

pub(crate) struct WorldBuilder {
    surfaces: Vec<Surface>,
    faces: Vec<Face>,
    lights: Vec<Light>,
    segments: Vec<TrueSegment>,
    families: Vec<Direction>,
    /// Seed of the next surface's painting; look-alike modules set it back to repeat themselves.
    paint_seed: u64,
}

impl WorldBuilder {
    /// `family_axes` are the directions that the world is known to be built along.
    pub fn new(seed: u64, family_axes: &[Vector3<f64>]) -> Self {
        let families = family_axes.iter().filter_map(|axis| Direction::new(*axis)).collect();
        Self {
            surfaces: Vec::new(),
            faces: Vec::new(),
            lights: Vec::new(),
            segments: Vec::new(),
            families,
            paint_seed: mix(seed, 1),
        }
    }

    /// Makes the next surfaces look as those after any other call with the same `seed`.
    pub fn restart_paint(&mut self, seed: u64) {
        self.paint_seed = seed;
    }

    pub fn light(&mut self, position: Vector3<f64>, intensity: f64, reach: f64) {
        self.lights.push(Light { position, intensity, reach });
    }

    /// A surface spanned by two orthogonal edges; it shows nothing until faces are put on it.
    pub fn surface(
        &mut self,
        origin: Vector3<f64>,
        u_edge: Vector3<f64>,
        v_edge: Vector3<f64>,
        material: Material,
    ) -> usize {
        self.paint_seed = mix(self.paint_seed, 2);
        self.surfaces.push(Surface {
            origin,
            u_axis: u_edge.normalize(),
            v_axis: v_edge.normalize(),
            size: Vector2::new(u_edge.norm(), v_edge.norm()),
            material,
            seed: self.paint_seed,
        });
        self.surfaces.len() - 1
    }

    /// A rectangular face on a surface, without listing its sides as edges.
    pub fn bare_face(&mut self, surface: usize, area: Area) {
        let corners = [(area.u0, area.v0), (area.u1, area.v0), (area.u1, area.v1), (area.u0, area.v1)];
        let corners = corners.iter().map(|&(u, v)| Vector2::new(u, v)).collect();
        self.faces.push(Face { surface, corners });
    }

    /// A rectangle on a surface of its own, visible from the side of `u_edge x v_edge`.
    pub fn rectangle(
        &mut self,
        origin: Vector3<f64>,
        u_edge: Vector3<f64>,
        v_edge: Vector3<f64>,
        material: Material,
    ) {
        let surface = self.surface(origin, u_edge, v_edge, material);
        self.bare_face(surface, Area::new(0.0, u_edge.norm(), 0.0, v_edge.norm()));
        let corners = [origin, origin + u_edge, origin + u_edge + v_edge, origin + v_edge];
        self.outline(&corners);
    }

    /// A convex polygon, visible from the side on which its corners run counter-clockwise.
    pub fn polygon(&mut self, corners: &[Vector3<f64>], material: Material) {
        let u_axis = (corners[1] - corners[0]).normalize();
        let normal = u_axis.cross(&(corners[2] - corners[0])).normalize();
        let v_axis = normal.cross(&u_axis);
        let flat: Vec<Vector2<f64>> = corners
            .iter()
            .map(|corner| {
                Vector2::new(u_axis.dot(&(corner - corners[0])), v_axis.dot(&(corner - corners[0])))
            })
            .collect();
        let low = flat.iter().fold(Vector2::repeat(f64::INFINITY), |low, p| low.inf(p));
        let high = flat.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |high, p| high.sup(p));
        let size = high - low;
        let origin = corners[0] + u_axis * low.x + v_axis * low.y;
        let surface = self.surface(origin, u_axis * size.x, v_axis * size.y, material);
        self.faces.push(Face { surface, corners: flat.iter().map(|p| p - low).collect() });
        self.outline(corners);
    }

    /// A wall with openings that reach from the floor to a lintel.
    pub fn wall(&mut self, wall: &Wall, openings: &[Area], material: Material) {
        let surface =
            self.surface(wall.origin, wall.right * wall.length, Vector3::z() * wall.height, material);
        let mut from = 0.0;
        for opening in openings {
            self.bare_face(surface, Area::new(from, opening.u0, 0.0, wall.height));
            self.bare_face(surface, Area::new(opening.u0, opening.u1, opening.v1, wall.height));
            self.edge(wall.point(from, 0.0, 0.0), wall.point(opening.u0, 0.0, 0.0));
            self.edge(wall.point(opening.u0, 0.0, 0.0), wall.point(opening.u0, opening.v1, 0.0));
            self.edge(wall.point(opening.u0, opening.v1, 0.0), wall.point(opening.u1, opening.v1, 0.0));
            self.edge(wall.point(opening.u1, opening.v1, 0.0), wall.point(opening.u1, 0.0, 0.0));
            from = opening.u1;
        }
        self.bare_face(surface, Area::new(from, wall.length, 0.0, wall.height));
        self.edge(wall.point(from, 0.0, 0.0), wall.point(wall.length, 0.0, 0.0));
        self.edge(wall.point(0.0, wall.height, 0.0), wall.point(wall.length, wall.height, 0.0));
        self.edge(wall.point(0.0, 0.0, 0.0), wall.point(0.0, wall.height, 0.0));
        self.edge(wall.point(wall.length, 0.0, 0.0), wall.point(wall.length, wall.height, 0.0));
    }

    /// A slab on a wall that stands out by `from..to`; its back is not drawn.
    pub fn panel(&mut self, wall: &Wall, area: Area, from: f64, to: f64, front: Material, sides: Material) {
        let Area { u0, u1, v0, v1 } = area;
        let (du, dv) = (wall.right * (u1 - u0), Vector3::z() * (v1 - v0));
        let inward = wall.point(0.0, 0.0, from) - wall.point(0.0, 0.0, to);
        self.rectangle(wall.point(u0, v0, to), du, dv, front);
        self.rectangle(wall.point(u0, v1, to), du, inward, sides);
        self.rectangle(wall.point(u0, v0, from), du, -inward, sides);
        self.rectangle(wall.point(u0, v0, from), -inward, dv, sides);
        self.rectangle(wall.point(u1, v0, to), inward, dv, sides);
    }

    /// A box in a placed frame: sides (four), top and bottom.
    pub fn cuboid(
        &mut self,
        place: &Placement,
        low: Vector3<f64>,
        high: Vector3<f64>,
        sides: Material,
        top: Material,
    ) {
        let size = high - low;
        let (dx, dy, dz) = (place.axis_x() * size.x, place.axis_y() * size.y, Vector3::z() * size.z);
        self.rectangle(place.point(low.x, low.y, low.z), dx, dz, sides);
        self.rectangle(place.point(high.x, low.y, low.z), dy, dz, sides);
        self.rectangle(place.point(high.x, high.y, low.z), -dx, dz, sides);
        self.rectangle(place.point(low.x, high.y, low.z), -dy, dz, sides);
        self.rectangle(place.point(low.x, low.y, high.z), dx, dy, top);
        self.rectangle(place.point(low.x, high.y, low.z), dx, -dy, top);
    }

    pub fn finish(self) -> World {
        World {
            surfaces: self.surfaces,
            faces: self.faces,
            lights: self.lights,
            segments: self.segments,
            vanishing_directions: self.families,
        }
    }

    fn outline(&mut self, corners: &[Vector3<f64>]) {
        for i in 0..corners.len() {
            self.edge(corners[i], corners[(i + 1) % corners.len()]);
        }
    }

    /// Lists an edge unless it is too short or already there.
    pub fn edge(&mut self, start: Vector3<f64>, end: Vector3<f64>) {
        let Some(direction) = Direction::new(end - start) else { return };
        if (end - start).norm() < MIN_SEGMENT_LENGTH {
            return;
        }
        let same = |a: &Vector3<f64>, b: &Vector3<f64>| (a - b).norm() < SAME_POINT;
        let known = self.segments.iter().any(|s| {
            (same(&s.start, &start) && same(&s.end, &end)) || (same(&s.start, &end) && same(&s.end, &start))
        });
        if !known {
            let family = self.families.iter().position(|axis| axis.angle(&direction) < FAMILY_ANGLE_RAD);
            self.segments.push(TrueSegment { start, end, family });
        }
    }
}
