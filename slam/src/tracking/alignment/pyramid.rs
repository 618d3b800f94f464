//! Half resolutions of an image.

use geometry::Camera;
use geometry::nalgebra::Vector2;
use std::sync::Arc;
use vision::GrayImage;

/// Images are not halved below this many pixels across: patches would cover most of them.
const MIN_SIZE_PX: u32 = 8;

/// An image in ever halved resolutions, each with the camera that would have taken it.
pub(super) struct HalvedImages {
    levels: Vec<(Arc<GrayImage>, Camera)>,
}

impl HalvedImages {
    /// Level 0 is the image itself.
    pub fn of(image: &Arc<GrayImage>, camera: &Camera, coarsest: u8) -> Self {
        let mut levels = vec![(image.clone(), camera.clone())];
        for _ in 0..coarsest {
            let (image, camera) = &levels[levels.len() - 1];
            if image.width().min(image.height()) < 2 * MIN_SIZE_PX {
                break;
            }
            levels.push((Arc::new(halved(image)), camera.scaled(0.5, 0.5)));
        }
        Self { levels }
    }

    pub fn coarsest(&self) -> usize {
        self.levels.len() - 1
    }

    pub fn level(&self, level: usize) -> (&GrayImage, &Camera) {
        let (image, camera) = &self.levels[level];
        (image, camera)
    }
}

/// Every pixel is the mean of four. An odd last row or column is left out.
fn halved(image: &GrayImage) -> GrayImage {
    let (width, height) = (image.width() / 2, image.height() / 2);
    let mut half = GrayImage::new(width, height);
    for y in 0..height {
        let (upper, lower) = (image.row(2 * y), image.row(2 * y + 1));
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        for (pixel, (up, low)) in half.row_mut(y).iter_mut().zip(pairs) {
            let sum = u16::from(up[0]) + u16::from(up[1]) + u16::from(low[0]) + u16::from(low[1]);
            *pixel = ((sum + 2) / 4) as u8;
        }
    }
    half
}

/// Gray level between pixels. `None` within a pixel of the edge.
pub(super) fn gray_level(image: &GrayImage, pixel: &Vector2<f64>) -> Option<f64> {
    let (left, top) = (pixel.x.floor(), pixel.y.floor());
    let is_inside = left >= 1.0
        && top >= 1.0
        && left + 2.0 < f64::from(image.width())
        && top + 2.0 < f64::from(image.height());
    if !is_inside {
        return None;
    }
    let (right_share, lower_share) = (pixel.x - left, pixel.y - top);
    let (left, top) = (left as usize, top as u32);
    let across =
        |row: &[u8]| f64::from(row[left]) * (1.0 - right_share) + f64::from(row[left + 1]) * right_share;
    Some(across(image.row(top)) * (1.0 - lower_share) + across(image.row(top + 1)) * lower_share)
}

/// How far from a pixel its gradient is taken.
pub(super) const GRADIENT_REACH_PX: f64 = 0.5;

/// Change of the gray level per pixel, to the right and down.
pub(super) fn gradient(image: &GrayImage, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
    let at = |x: f64, y: f64| gray_level(image, &(pixel + Vector2::new(x, y)));
    const REACH: f64 = GRADIENT_REACH_PX;
    let change = Vector2::new(at(REACH, 0.0)? - at(-REACH, 0.0)?, at(0.0, REACH)? - at(0.0, -REACH)?);
    Some(change / (2.0 * REACH))
}
