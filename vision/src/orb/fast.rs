//! FAST-9/16 corners [Rosten & Drummond, "Machine learning for high-speed corner detection", ECCV 2006].

use super::OrbConfig;
use crate::GrayImage;

/// A corner at a whole pixel of its level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Corner {
    pub x: u16,
    pub y: u16,
    /// The largest threshold at which it is still a corner, grey levels.
    pub score: u8,
}

/// The circle of 16 pixels around a candidate, (dx, dy), clockwise from the top.
const CIRCLE: [(i32, i32); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];

/// Finds corners; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Detector {
    scores: Vec<u8>,
    corners: Vec<Corner>,
}

impl Detector {
    pub fn detect(&mut self, image: &GrayImage, config: &OrbConfig) -> &[Corner] {
        self.corners.clear();
        let (width, height, margin) = (image.width(), image.height(), config.edge_margin_px);
        if width <= 2 * margin || height <= 2 * margin {
            return &self.corners;
        }
        self.scores.clear();
        self.scores.resize(image.as_raw().len(), 0);
        let at = |x: u32, y: u32| (y * width + x) as usize;
        for y in margin - 1..height - margin + 1 {
            for x in margin - 1..width - margin + 1 {
                self.scores[at(x, y)] = score(image, x, y);
            }
        }
        let cell = config.cell_size_px;
        for top in (margin..height - margin).step_by(cell as usize) {
            for left in (margin..width - margin).step_by(cell as usize) {
                for threshold in [config.fast_threshold, config.min_fast_threshold] {
                    let before = self.corners.len();
                    for y in top..(top + cell).min(height - margin) {
                        for x in left..(left + cell).min(width - margin) {
                            let score = self.scores[at(x, y)];
                            if score <= threshold {
                                continue;
                            }
                            let mut is_peak = true;
                            for ny in y - 1..=y + 1 {
                                for nx in x - 1..=x + 1 {
                                    let other = self.scores[at(nx, ny)];
                                    is_peak &= (ny, nx) == (y, x)
                                        || if (ny, nx) < (y, x) { other < score } else { other <= score };
                                }
                            }
                            if is_peak {
                                self.corners.push(Corner { x: x as u16, y: y as u16, score });
                            }
                        }
                    }
                    if self.corners.len() > before {
                        break;
                    }
                }
            }
        }
        &self.corners
    }
}

/// The largest `t` such that 9 neighbouring pixels of the circle are all brighter than the centre by at least `t`, or
/// all darker; 0 if there is none.
fn score(image: &GrayImage, x: u32, y: u32) -> u8 {
    let pixel = |dx: i32, dy: i32| i32::from(image.row((y as i32 + dy) as u32)[(x as i32 + dx) as usize]);
    let centre = pixel(0, 0);
    let differences: [i32; 16] = CIRCLE.map(|(dx, dy)| pixel(dx, dy) - centre);
    let arc =
        |start: usize, sign: i32| (0..9).map(|k| sign * differences[(start + k) % 16]).min().unwrap_or(0);
    (0..16).map(|start| arc(start, 1).max(arc(start, -1))).max().unwrap_or(0).max(0) as u8
}
