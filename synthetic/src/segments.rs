//! Which parts of the world's edges a camera sees.

use geometry::Pose;
use nalgebra::{Vector2, Vector3};

use crate::render::Renderer;
use crate::world::TrueSegment;

/// Faces this close to a point on them do not hide it.
pub(crate) const TOUCH_DISTANCE: f64 = 5e-3;
/// Samples are at most this far apart in the image...
const SAMPLE_STEP_PX: f64 = 4.0;
/// ...and no more than this many to an edge.
const MAX_SAMPLES: usize = 160;
/// Parts shorter than this are not reported.
const MIN_LENGTH_PX: f64 = 10.0;
/// Contrast is taken between points this far to either side.
const CONTRAST_OFFSET_PX: f64 = 2.0;

/// A visible part of a true segment.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibleSegment {
    /// Index into [`crate::World::segments`].
    pub segment: usize,
    /// Direction family, an index into [`crate::World::vanishing_directions`].
    pub family: Option<usize>,
    /// Ends of the part in the world.
    pub ends_in_world: [Vector3<f64>; 2],
    /// Ends of the part in the (distorted) image.
    pub ends_px: [Vector2<f64>; 2],
    /// Mean absolute difference of gray levels across it, before noise and exposure. Low values mean that the
    /// edge is there, but cannot be seen.
    pub contrast: f64,
}

pub(crate) fn visible_segments(renderer: &Renderer, camera_from_world: &Pose) -> Vec<VisibleSegment> {
    let view = View { renderer, camera_from_world, center: camera_from_world.center() };
    let segments = renderer.world().segments().iter().enumerate();
    segments.flat_map(|(index, segment)| view.parts(index, segment)).collect()
}

struct View<'a> {
    renderer: &'a Renderer,
    camera_from_world: &'a Pose,
    center: Vector3<f64>,
}

impl View<'_> {
    fn parts(&self, index: usize, segment: &TrueSegment) -> Vec<VisibleSegment> {
        let point_at = |share: f64| segment.start.lerp(&segment.end, share);
        // A coarse pass finds whether, and over how many pixels, the edge crosses the image.
        const COARSE: usize = 24;
        let coarse: Vec<Option<Vector2<f64>>> =
            (0..=COARSE).map(|k| self.project(&point_at(k as f64 / COARSE as f64))).collect();
        let length: f64 = coarse.windows(2).filter_map(|pair| Some((pair[0]? - pair[1]?).norm())).sum();
        if coarse.iter().all(Option::is_none) {
            return Vec::new();
        }
        let n = ((length / SAMPLE_STEP_PX) as usize).clamp(COARSE, MAX_SAMPLES);
        let seen: Vec<bool> = (0..=n).map(|k| self.sees(&point_at(k as f64 / n as f64))).collect();
        let mut parts = Vec::new();
        let mut from = 0;
        while from <= n {
            let to = (from..=n).find(|k| !seen[*k]).unwrap_or(n + 1);
            if to > from + 1 {
                let ends = [from, to - 1].map(|k| point_at(k as f64 / n as f64));
                parts.extend(self.part(index, segment.family, ends));
            }
            from = to.max(from) + 1;
        }
        parts
    }

    fn part(&self, segment: usize, family: Option<usize>, ends: [Vector3<f64>; 2]) -> Option<VisibleSegment> {
        let ends_px = [self.project(&ends[0])?, self.project(&ends[1])?];
        let long_enough = (ends_px[1] - ends_px[0]).norm() >= MIN_LENGTH_PX;
        long_enough.then(|| VisibleSegment {
            segment,
            family,
            ends_in_world: ends,
            ends_px,
            contrast: self.contrast(&ends, &ends_px),
        })
    }

    fn contrast(&self, ends: &[Vector3<f64>; 2], ends_px: &[Vector2<f64>; 2]) -> f64 {
        const SAMPLES: usize = 9;
        let along = (ends_px[1] - ends_px[0]).normalize();
        let across = Vector2::new(-along.y, along.x) * CONTRAST_OFFSET_PX;
        let differences: Vec<f64> = (1..=SAMPLES)
            .filter_map(|k| {
                let pixel = self.project(&ends[0].lerp(&ends[1], k as f64 / (SAMPLES + 1) as f64))?;
                Some((self.gray(&(pixel + across))? - self.gray(&(pixel - across))?).abs())
            })
            .collect();
        differences.iter().sum::<f64>() / differences.len().max(1) as f64
    }

    fn gray(&self, pixel: &Vector2<f64>) -> Option<f64> {
        let bearing = self.renderer.camera().unproject(pixel)?;
        let ray = self.camera_from_world.rotation.inverse() * bearing;
        Some(self.renderer.surface_gray(&self.renderer.world().cast_ray(&self.center, &ray)?))
    }

    /// Where a world point is in the image, if inside.
    fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let camera = self.renderer.camera();
        camera.project(&self.camera_from_world.transform(point)).filter(|pixel| camera.contains(pixel))
    }

    fn sees(&self, point: &Vector3<f64>) -> bool {
        self.project(point).is_some()
            && self.renderer.world().is_visible_between(&self.center, point, TOUCH_DISTANCE)
    }
}
