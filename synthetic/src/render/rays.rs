//! The camera's rays at pixel corners and centers, and the cones of rays of image tiles.

use geometry::Camera;
use nalgebra::Vector2;

/// Tiles are squares of this many pixel corners.
pub(crate) const TILE: usize = 16;
/// Blocks are squares of this many tiles.
pub(crate) const BLOCK: usize = 4;

/// Unit rays in the camera frame, structure of arrays. Corner `(x, y)` is at pixel coordinates
/// `(x - 0.5, y - 0.5)`; rows are padded to whole tiles by repetition. Where the camera model has no ray, the
/// ray is zero and sees nothing.
pub(crate) struct RayTable {
    pub stride: usize,
    pub rows: usize,
    pub corner_x: Vec<f32>,
    pub corner_y: Vec<f32>,
    pub corner_z: Vec<f32>,
    /// Cones of tiles, and of blocks, row-major.
    tile_cones: Vec<Option<Cone>>,
    block_cones: Vec<Option<Cone>>,
}

/// All unit rays within an angle of an axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cone {
    pub axis: [f32; 3],
    pub sin: f32,
    pub cos: f32,
}

impl RayTable {
    pub fn new(camera: &Camera) -> Self {
        let (width, height) = (camera.width() as usize, camera.height() as usize);
        let stride = (width + 2).next_multiple_of(TILE);
        let rows = (height + 2).next_multiple_of(TILE);
        let [mut corner_x, mut corner_y, mut corner_z] = [const { Vec::new() }; 3];
        for y in 0..rows {
            for x in 0..stride {
                let (x, y) = (x.min(width) as f64 - 0.5, y.min(height) as f64 - 0.5);
                let ray = camera.unproject(&Vector2::new(x, y)).unwrap_or_default();
                corner_x.push(ray.x as f32);
                corner_y.push(ray.y as f32);
                corner_z.push(ray.z as f32);
            }
        }
        let (tile_cones, block_cones) = (Vec::new(), Vec::new());
        let mut table = Self { stride, rows, corner_x, corner_y, corner_z, tile_cones, block_cones };
        table.tile_cones = table.cones_of(TILE);
        table.block_cones = table.cones_of(BLOCK * TILE);
        table
    }

    /// The cone of tile `(tile_x, tile_y)`; `None` if it has no rays.
    #[inline]
    pub fn tile_cone(&self, tile_x: usize, tile_y: usize) -> Option<&Cone> {
        self.tile_cones[tile_y * (self.stride / TILE) + tile_x].as_ref()
    }

    /// The cone of the block whose first tile is `(tile_x, tile_y)`, both multiples of [`BLOCK`].
    #[inline]
    pub fn block_cone(&self, tile_x: usize, tile_y: usize) -> Option<&Cone> {
        let blocks_across = (self.stride / TILE).div_ceil(BLOCK);
        self.block_cones[tile_y / BLOCK * blocks_across + tile_x / BLOCK].as_ref()
    }

    fn cones_of(&self, size: usize) -> Vec<Option<Cone>> {
        let origins = |n: usize| (0..n).step_by(size);
        origins(self.rows).flat_map(|y| origins(self.stride).map(move |x| self.cone(x, y, size))).collect()
    }

    #[inline]
    pub fn corner(&self, x: usize, y: usize) -> [f32; 3] {
        let i = y * self.stride + x;
        [self.corner_x[i], self.corner_y[i], self.corner_z[i]]
    }

    /// The cone of the pixels whose top left corners lie in a rectangle of corners. `None` if it has no rays.
    fn cone(&self, x0: usize, y0: usize, size: usize) -> Option<Cone> {
        let (x1, y1) = ((x0 + size).min(self.stride - 1), (y0 + size).min(self.rows - 1));
        let step = if size > TILE { 4 } else { 1 };
        let rays =
            (y0..=y1).step_by(step).flat_map(|y| (x0..=x1).step_by(step).map(move |x| self.corner(x, y)));
        let sum = rays.clone().fold([0.0_f32; 3], |sum, ray| std::array::from_fn(|i| sum[i] + ray[i]));
        let length = dot(sum, sum).sqrt();
        if length < 1e-6 {
            return None;
        }
        let axis = sum.map(|x| x / length);
        let seen = rays.filter(|ray| dot(*ray, *ray) > 0.5);
        // A little wider, for the rays between corners and for rounding.
        let angle = seen.map(|ray| dot(axis, ray)).fold(1.0, f32::min).clamp(-1.0, 1.0).acos();
        let wider = angle * if step > 1 { 1.1 } else { 1.01 } + 1e-4;
        Some(Cone { axis, sin: wider.sin(), cos: wider.cos() })
    }
}

#[inline]
pub(crate) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Cone {
    /// Least and greatest dot product of `vector` with a ray in the cone.
    #[inline]
    pub fn bounds(&self, vector: [f32; 3]) -> (f32, f32) {
        let along = dot(vector, self.axis);
        let across = (dot(vector, vector) - along * along).max(0.0).sqrt();
        let (middle, spread) = (along * self.cos, across * self.sin);
        let length = (along * along + across * across).sqrt();
        // Where the vector, or its negative, lies inside of the cone, that is the extreme.
        let high = if along > length * self.cos { length } else { middle + spread };
        let low = if -along > length * self.cos { -length } else { middle - spread };
        (low, high)
    }
}
