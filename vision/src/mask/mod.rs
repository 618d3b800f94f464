//! What of an image is not the scene: black borders and rims of lenses, watermarks, a car's bonnet.
//!
//! A [`Mask`] says which pixels are left out, given by somebody or found by a [`MaskFinder`] as what stays
//! where it is while the scene moves. Features are kept away from it by its [`Clearance`].

mod border;
mod clearance;
mod evidence;
mod finder;
mod motion;
mod regions;
mod runs;
mod small;
#[cfg(test)]
mod tests;

pub use border::black_border;
pub use clearance::Clearance;
pub use finder::{MaskFinder, MaskFinderConfig};

use crate::GrayImage;

/// Gray levels below this are left out, as in masks of other programs, where black is left out and white
/// used.
const USED_FROM: u8 = 128;

/// Which pixels of a camera's images show the scene.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mask {
    /// 255 where the scene is seen, 0 what is left out.
    picture: GrayImage,
}

impl Mask {
    /// By a picture that is dark where nothing is to be used.
    pub fn from_picture(picture: &GrayImage) -> Self {
        let used = |x: u32, y: u32| if picture.row(y)[x as usize] < USED_FROM { 0 } else { 255 };
        Self { picture: GrayImage::from_fn(picture.width(), picture.height(), used) }
    }

    /// Leaves out the pixels at column `x`, row `y` for which `is_left_out(x, y)`.
    pub fn from_fn(width: u32, height: u32, is_left_out: impl Fn(u32, u32) -> bool) -> Self {
        Self { picture: GrayImage::from_fn(width, height, |x, y| if is_left_out(x, y) { 0 } else { 255 }) }
    }

    /// White where the scene is seen, black what is left out.
    pub fn picture(&self) -> &GrayImage {
        &self.picture
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.picture.width()
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.picture.height()
    }

    /// Whether the pixel at column `x`, row `y` is left out; those outside the image are.
    pub fn leaves_out(&self, x: u32, y: u32) -> bool {
        self.picture.get(x, y).is_none_or(|value| value == 0)
    }

    /// The share of the image that is left out, 0 to 1; 0 for an empty one.
    pub fn share(&self) -> f64 {
        let n_left_out = self.picture.as_raw().iter().filter(|value| **value == 0).count();
        n_left_out as f64 / (self.picture.as_raw().len().max(1)) as f64
    }

    /// First column and row of the smallest box that holds all that is not left out, and the first behind it;
    /// `None` if everything is left out.
    pub fn used_box(&self) -> Option<[(u32, u32); 2]> {
        let is_used = |y: u32| self.picture.row(y).iter().any(|value| *value != 0);
        let top = (0..self.height()).find(|y| is_used(*y))?;
        let bottom = (top..self.height()).rev().find(|y| is_used(*y))?;
        let (mut left, mut right) = (self.width(), 0);
        for row in (top..=bottom).map(|y| self.picture.row(y)) {
            let Some(first) = row.iter().position(|value| *value != 0) else { continue };
            let last = row.iter().rposition(|value| *value != 0).unwrap_or(first);
            (left, right) = (left.min(first as u32), right.max(last as u32 + 1));
        }
        Some([(left, top), (right, bottom + 1)])
    }

    /// The same for images of another size: a pixel is left out if the nearest one is.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        if (width, height) == (self.width(), self.height()) || self.picture.is_empty() {
            return self.clone();
        }
        let nearest = |at: u32, from: u32, to: u32| {
            (u64::from(2 * at + 1) * u64::from(from) / (2 * u64::from(to))).min(u64::from(from) - 1) as u32
        };
        Self::from_fn(width, height, |x, y| {
            self.leaves_out(nearest(x, self.width(), width), nearest(y, self.height(), height))
        })
    }
}
