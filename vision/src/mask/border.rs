//! A black border of a single image, before anything has moved.

use super::small::{SmallImage, reduction};
use super::{Mask, regions};
use crate::GrayImage;

/// Black of video is 16.
const BLACK: u8 = 20;
/// Beside a border the scene is brighter by this, gray levels: where it fades into the dark, it is a scene.
const MIN_STEP: u8 = 12;
/// The share of a border's rim where it must be.
const MIN_STEP_SHARE: f64 = 0.5;
/// Pixels from a border at which the scene is looked at: the reduced image smears the edge over one.
const REACH: usize = 2;

/// What of an image is black as far as its sides, with a rim where the scene begins, which one image alone
/// cannot tell from a night sky: good for choosing a resolution, not for leaving anything out.
pub fn black_border(image: &GrayImage) -> Mask {
    let mut small = SmallImage::default();
    small.take(image);
    let (width, height) = (small.width, small.height);
    let is_black = |at: usize| small.values[at] <= BLACK;
    let (labels, n_parts) = regions::label(width, height, is_black);
    let mut touches = vec![false; n_parts as usize + 1];
    let mut rims = vec![[0usize; 2]; n_parts as usize + 1];
    for at in (0..width * height).filter(|at| labels[*at] != 0) {
        let (label, x, y) = (labels[at] as usize, at % width, at / width);
        touches[label] |= x == 0 || y == 0 || x + 1 == width || y + 1 == height;
        for next in regions::sides(at, width, height).filter(|next| labels[*next] == 0) {
            let beyond = beyond(at, next, width, height);
            rims[label][0] += 1;
            rims[label][1] += usize::from(small.values[beyond] >= BLACK + MIN_STEP);
        }
    }
    let is_border = |label: usize| {
        let [n, n_steps] = rims[label];
        label > 0 && touches[label] && n > 0 && n_steps as f64 >= MIN_STEP_SHARE * n as f64
    };
    let by = reduction(image.width()) as usize;
    Mask::from_fn(image.width(), image.height(), |x, y| {
        let (x, y) = ((x as usize / by).min(width.saturating_sub(1)), y as usize / by);
        labels.get(y * width + x).is_some_and(|label| is_border(*label as usize))
    })
}

/// The pixel so far on from `at` through `next`, within the image.
fn beyond(at: usize, next: usize, width: usize, height: usize) -> usize {
    let of = |at: usize| [(at % width) as isize, (at / width) as isize];
    let ([x, y], [next_x, next_y]) = (of(at), of(next));
    let on = |from: isize, to: isize, size: usize| {
        (to + (to - from) * (REACH as isize - 1)).clamp(0, size as isize - 1) as usize
    };
    on(y, next_y, height) * width + on(x, next_x, width)
}
