//! Orientation by the intensity centroid [Rosin, "Measuring corner properties", CVIU 1999].

use super::PATCH_RADIUS_PX;
use crate::GrayImage;

/// Direction from (x, y) to the centroid of the disc around it, radians in [0, 2 pi).
pub(super) fn angle(image: &GrayImage, x: u32, y: u32) -> f32 {
    let radius = PATCH_RADIUS_PX as i32;
    let (mut m10, mut m01) = (0i32, 0i32);
    for dy in -radius..=radius {
        let row = image.row((y as i32 + dy) as u32);
        for dx in -radius..=radius {
            if dx * dx + dy * dy <= radius * (radius + 1) {
                let value = i32::from(row[(x as i32 + dx) as usize]);
                m10 += dx * value;
                m01 += dy * value;
            }
        }
    }
    let angle = (m01 as f32).atan2(m10 as f32);
    if angle < 0.0 { (angle + std::f32::consts::TAU).min(std::f32::consts::TAU.next_down()) } else { angle }
}
