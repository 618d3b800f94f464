//! Which face is seen along each ray.

use geometry::Pose;
use nalgebra::Vector3;

use super::rays::{BLOCK, Cone, RayTable, TILE, dot};
use crate::world::World;

/// Seen where there is no face.
pub(crate) const NOTHING: u16 = u16::MAX;

/// A face as the camera sees it. For a ray `r` in the camera frame, `inverse_depth · r` is one over the
/// distance to the face's plane in lengths of `r`; the face is met where that is positive and `r` is on the
/// inner side of the planes through the camera center and each side.
pub(crate) struct FaceView {
    pub inverse_depth: [f32; 3],
    /// Texture coordinate `u = u_axis · r / (inverse_depth · r) - u_offset`, in finest texels.
    pub u_axis: [f32; 3],
    pub v_axis: [f32; 3],
    pub u_offset: f32,
    pub v_offset: f32,
    pub surface: usize,
    sides: Vec<[f32; 3]>,
}

impl FaceView {
    #[inline]
    pub fn meets(&self, ray: [f32; 3]) -> Option<f32> {
        let w = dot(self.inverse_depth, ray);
        (w > 0.0 && self.sides.iter().all(|side| dot(*side, ray) >= 0.0)).then_some(w)
    }

    /// Texture coordinates where `ray` meets the face's plane.
    #[inline]
    pub fn texture_coordinates(&self, ray: [f32; 3]) -> (f32, f32) {
        let depth = 1.0 / dot(self.inverse_depth, ray);
        (dot(self.u_axis, ray) * depth - self.u_offset, dot(self.v_axis, ray) * depth - self.v_offset)
    }
}

/// All faces turned to the camera in one frame.
pub(crate) struct FrameFaces {
    pub faces: Vec<FaceView>,
}

/// A camera closer than this to a plane is taken to be on it and does not see it.
const MIN_PLANE_DISTANCE: f64 = 1e-4;

impl FrameFaces {
    pub fn new(world: &World, camera_from_world: &Pose, texel: f64) -> Self {
        let rotate = |vector: &Vector3<f64>| camera_from_world.rotation * vector;
        let mut faces = Vec::new();
        for face in &world.faces {
            let surface = &world.surfaces[face.surface];
            let origin = camera_from_world.transform(&surface.origin);
            let normal = rotate(&surface.normal());
            let plane = normal.dot(&origin);
            if plane > -MIN_PLANE_DISTANCE {
                continue;
            }
            let corners: Vec<Vector3<f64>> =
                face.corners.iter().map(|uv| camera_from_world.transform(&surface.point(uv))).collect();
            let centroid = corners.iter().sum::<Vector3<f64>>();
            let sides = (0..corners.len())
                .map(|i| {
                    let side = corners[i].cross(&corners[(i + 1) % corners.len()]).normalize();
                    to_f32(&(side * side.dot(&centroid).signum()))
                })
                .collect();
            let (u_axis, v_axis) = (rotate(&surface.u_axis), rotate(&surface.v_axis));
            faces.push(FaceView {
                inverse_depth: to_f32(&(normal / plane)),
                u_axis: to_f32(&(u_axis / texel)),
                v_axis: to_f32(&(v_axis / texel)),
                u_offset: (u_axis.dot(&origin) / texel) as f32,
                v_offset: (v_axis.dot(&origin) / texel) as f32,
                surface: face.surface,
                sides,
            });
        }
        assert!(faces.len() < usize::from(NOTHING), "too many faces for the identifiers of faces");
        Self { faces }
    }

    /// The faces out of `among` that some ray of the cone can meet, without those hidden by one that covers
    /// the whole cone.
    fn within(&self, cone: &Cone, among: &[u16], found: &mut Vec<Candidate>) {
        found.clear();
        let mut cover = 0.0_f32;
        'faces: for &index in among {
            let face = &self.faces[usize::from(index)];
            let (mut covers, (w_low, w_high)) = (true, cone.bounds(face.inverse_depth));
            if w_high <= 0.0 || w_high < cover {
                continue;
            }
            for side in &face.sides {
                let along = dot(*side, cone.axis);
                if along < -cone.sin {
                    continue 'faces;
                }
                covers &= along > cone.sin;
            }
            covers &= w_low > 0.0;
            if covers {
                cover = cover.max(w_low);
            }
            found.push(Candidate { index, covers, w_high });
        }
        found.retain(|candidate| candidate.w_high >= cover);
    }
}

fn to_f32(v: &Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

struct Candidate {
    index: u16,
    /// Whether every ray of the tile meets it.
    covers: bool,
    w_high: f32,
}

/// The face seen at each pixel corner of a band of rows, and the faces to consider in each of its tiles.
pub(crate) struct VisibilityMap {
    pub stride: usize,
    /// Face at corner `(x, first_row + y)`, at `y * stride + x`.
    pub ids: Vec<u16>,
    first_tile_row: usize,
    tiles_across: usize,
    tile_lists: Vec<std::ops::Range<u32>>,
    candidates: Vec<u16>,
}

impl VisibilityMap {
    /// Decides rows of tiles that contain the corners of pixel rows `first_row..end_row`.
    pub fn new(rays: &RayTable, frame: &FrameFaces, first_row: usize, end_row: usize) -> Self {
        let first_tile_row = first_row / TILE;
        let end_tile_row = end_row / TILE + 1;
        let tiles_across = rays.stride / TILE;
        let n_tiles = (end_tile_row - first_tile_row) * tiles_across;
        let mut map = Self {
            stride: rays.stride,
            ids: vec![NOTHING; n_tiles * TILE * TILE],
            first_tile_row,
            tiles_across,
            tile_lists: vec![0..0; n_tiles],
            candidates: Vec::new(),
        };
        let all: Vec<u16> = (0..frame.faces.len() as u16).collect();
        let mut in_block = Vec::new();
        let first_block_row = first_tile_row / BLOCK * BLOCK;
        for block_y in (first_block_row..end_tile_row).step_by(BLOCK) {
            for block_x in (0..tiles_across).step_by(BLOCK) {
                let Some(cone) = rays.block_cone(block_x, block_y) else { continue };
                frame.within(cone, &all, &mut in_block);
                let among: Vec<u16> = in_block.iter().map(|candidate| candidate.index).collect();
                for tile_y in block_y.max(first_tile_row)..(block_y + BLOCK).min(end_tile_row) {
                    for tile_x in block_x..(block_x + BLOCK).min(tiles_across) {
                        map.decide_tile(rays, frame, &among, tile_x, tile_y);
                    }
                }
            }
        }
        map
    }

    /// The row of `ids` for corner row `y` of the image.
    pub fn row(&self, y: usize) -> &[u16] {
        &self.ids[(y - self.first_tile_row * TILE) * self.stride..][..self.stride]
    }

    /// The faces that the pixel with top left corner `(x, y)` may show.
    pub fn candidates(&self, x: usize, y: usize) -> &[u16] {
        let list = &self.tile_lists[(y / TILE - self.first_tile_row) * self.tiles_across + x / TILE];
        &self.candidates[list.start as usize..list.end as usize]
    }

    fn decide_tile(
        &mut self,
        rays: &RayTable,
        frame: &FrameFaces,
        among: &[u16],
        tile_x: usize,
        tile_y: usize,
    ) {
        let (x0, y0) = (tile_x * TILE, tile_y * TILE);
        let Some(cone) = rays.tile_cone(tile_x, tile_y) else { return };
        let mut found = Vec::new();
        frame.within(cone, among, &mut found);
        let start = self.candidates.len() as u32;
        self.candidates.extend(found.iter().map(|candidate| candidate.index));
        let row_of_tile = tile_y - self.first_tile_row;
        self.tile_lists[row_of_tile * self.tiles_across + tile_x] = start..self.candidates.len() as u32;
        for row in 0..TILE {
            let ids = &mut self.ids[(row_of_tile * TILE + row) * self.stride + x0..][..TILE];
            if let [only] = &found[..]
                && only.covers
            {
                ids.fill(only.index);
            } else if y0 + row < rays.rows {
                decide_row(rays, frame, &found, (y0 + row) * rays.stride + x0, ids);
            }
        }
    }
}

/// Casts the rays of one row of a tile, all of them against one face after the other.
fn decide_row(rays: &RayTable, frame: &FrameFaces, found: &[Candidate], from: usize, ids: &mut [u16]) {
    let x: &[f32; TILE] = rays.corner_x[from..from + TILE].try_into().expect("a row of a tile");
    let y: &[f32; TILE] = rays.corner_y[from..from + TILE].try_into().expect("a row of a tile");
    let z: &[f32; TILE] = rays.corner_z[from..from + TILE].try_into().expect("a row of a tile");
    let mut nearest = [0.0_f32; TILE];
    for candidate in found {
        let face = &frame.faces[usize::from(candidate.index)];
        let [a, b, c] = face.inverse_depth;
        let mut w = [0.0_f32; TILE];
        for i in 0..TILE {
            w[i] = a * x[i] + b * y[i] + c * z[i];
        }
        if !candidate.covers {
            for [a, b, c] in &face.sides {
                for i in 0..TILE {
                    let inside = a * x[i] + b * y[i] + c * z[i] >= 0.0;
                    w[i] = if inside { w[i] } else { 0.0 };
                }
            }
        }
        for i in 0..TILE {
            if w[i] > nearest[i] {
                nearest[i] = w[i];
                ids[i] = candidate.index;
            }
        }
    }
}
