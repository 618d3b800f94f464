//! Gray levels on short paths across a segment, in the last image and in the next one.

use nalgebra::Vector2;

use crate::lines::sampling::{Sampler, halved_position};

/// A path compared reaches this far on either side of the edge, pixels of its level.
pub(super) const HALF_PATH: usize = 5;
/// Largest shift of the search on the coarsest level, pixels of that level.
pub(super) const MAX_SEARCH: usize = 8;
/// The longest path read.
pub(super) const MAX_PATH: usize = 2 * (HALF_PATH + MAX_SEARCH) + 1;
/// Distance of the paths that are averaged at the finest level, pixels.
const SIDE_PATH_DISTANCE_PX: f32 = 1.5;

/// What the paths across a segment are read from, at one level.
pub(super) struct Paths<'a> {
    pub last: Sampler<'a>,
    pub next: Sampler<'a>,
    pub level: usize,
    pub old_normal: Vector2<f32>,
    pub new_normal: Vector2<f32>,
}

impl Paths<'_> {
    /// Gray levels across the old segment, `out.len()` of them about `pixel` (of the full image).
    pub fn read_last(&self, pixel: Vector2<f32>, out: &mut [f32]) {
        Self::read(&self.last, halved_position(pixel, self.level), self.old_normal, self.level, out);
    }

    /// Gray levels across the expected segment.
    pub fn read_next(&self, pixel: Vector2<f32>, out: &mut [f32]) {
        Self::read(&self.next, halved_position(pixel, self.level), self.new_normal, self.level, out);
    }

    /// At the finest level, means of three paths side by side, which are worth their time only there: the
    /// coarser ones are means already.
    fn read(sampler: &Sampler, middle: Vector2<f32>, normal: Vector2<f32>, level: usize, out: &mut [f32]) {
        let start = middle - normal * (0.5 * (out.len() - 1) as f32);
        sampler.clamped_path(start, normal, out);
        if level > 0 {
            return;
        }
        let along = Vector2::new(normal.y, -normal.x) * SIDE_PATH_DISTANCE_PX;
        let mut buffer = [0.0; MAX_PATH];
        let side = &mut buffer[..out.len()];
        for offset in [along, -along] {
            sampler.clamped_path(start + offset, normal, side);
            out.iter_mut().zip(side.iter()).for_each(|(sum, value)| *sum += value);
        }
        out.iter_mut().for_each(|sum| *sum *= 1.0 / 3.0);
    }
}
