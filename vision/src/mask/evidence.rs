//! What is known of each pixel from images between which the scene has moved.

use super::motion::{self, EDGE_STRENGTH, Profiles, REGIONS};
use super::small::SmallImage;
use crate::vectorized;

/// Images after which older ones begin to be forgotten.
const MEMORY: u32 = 24;
/// A pixel whose value is off from its mean by less than this, in the mean, is of something that stays, gray
/// levels.
const STEADY: f32 = 3.0;
/// Where the scene varies much, something that mirrors it varies as well: by less than this share of that,
const STEADY_SHARE: f32 = 0.25;
/// and by less than this, gray levels.
const MAX_STEADY: f32 = 8.0;
/// Directions across an edge that are told apart, over half a turn.
const N_DIRECTIONS: usize = 8;
/// The scene has moved across an edge when it moved by this, pixels of the small image,
const MIN_CROSSING: f32 = 1.0;
/// and at an angle to the edge whose sine is this at least: an edge that moves along itself seems to stay.
const MIN_CROSSING_SINE: f32 = 0.8;
/// Edges that fewer images show than this are not watched.
const WATCHED_SHARE: f32 = 0.5;

/// Running means for every pixel of the small image.
#[derive(Clone, Debug, Default)]
pub(super) struct Evidence {
    pub width: usize,
    pub height: usize,
    /// Images seen.
    pub n_images: u32,
    /// How far a gray level may be from its mean for a pixel to be steady.
    steady: f32,
    means: Means,
    /// The brightest each pixel ever was.
    brightest: Vec<u8>,
    /// How far the scene has moved across the edge there while it stayed, pixels.
    crossed: Vec<f32>,
    last: SmallImage,
    profiles: Profiles,
}

/// Means over the images, the latest ones.
#[derive(Clone, Debug, Default)]
struct Means {
    /// Gray level.
    value: Vec<f32>,
    /// How far the gray level is from its mean.
    deviation: Vec<f32>,
    /// Direction across the edge there as a unit vector of twice the angle, zero where there is none: as long
    /// as the share of images that show an edge of this direction here, on whichever side it is brighter.
    axis_x: Vec<f32>,
    axis_y: Vec<f32>,
    /// The same towards the brighter side.
    towards_x: Vec<f32>,
    towards_y: Vec<f32>,
}

impl Means {
    fn begin(image: &SmallImage) -> Self {
        let zeros = || vec![0.0; image.values.len()];
        Self {
            value: image.values.iter().map(|value| f32::from(*value)).collect(),
            deviation: zeros(),
            axis_x: zeros(),
            axis_y: zeros(),
            towards_x: zeros(),
            towards_y: zeros(),
        }
    }

    /// Moves every mean towards an image by this share of the way.
    #[inline(always)]
    fn add(&mut self, image: &SmallImage, rate: f32) {
        let n = image.values.len();
        let (values, gradient_x, gradient_y) =
            (&image.values[..n], &image.gradient_x[..n], &image.gradient_y[..n]);
        let (value, deviation) = (&mut self.value[..n], &mut self.deviation[..n]);
        let (axis_x, axis_y) = (&mut self.axis_x[..n], &mut self.axis_y[..n]);
        let (towards_x, towards_y) = (&mut self.towards_x[..n], &mut self.towards_y[..n]);
        for at in 0..n {
            let off = f32::from(values[at]) - value[at];
            value[at] += rate * off;
            deviation[at] += rate * (off.abs() - deviation[at]);
            let (x, y) = (f32::from(gradient_x[at]), f32::from(gradient_y[at]));
            let is_edge = x.abs() + y.abs() >= f32::from(EDGE_STRENGTH);
            let inverse = if is_edge { 1.0 / (x * x + y * y).sqrt() } else { 0.0 };
            let (x, y) = (x * inverse, y * inverse);
            axis_x[at] += rate * (x * x - y * y - axis_x[at]);
            axis_y[at] += rate * (2.0 * x * y - axis_y[at]);
            towards_x[at] += rate * (x - towards_x[at]);
            towards_y[at] += rate * (y - towards_y[at]);
        }
    }
}

impl Evidence {
    /// Whether an image differs from the last that was added as it does when the camera moves; `is_used` says
    /// which pixels are asked.
    pub fn has_moved(&self, image: &SmallImage, left_out: &[bool]) -> bool {
        self.n_images == 0
            || (self.last.width, self.last.height) != (image.width, image.height)
            || motion::has_moved(&self.last, image, left_out)
    }

    /// Adds an image, and takes its buffers for those of an older one.
    pub fn add(&mut self, image: &mut SmallImage) {
        if (self.width, self.height) != (image.width, image.height) {
            *self = Self::default();
        }
        if self.n_images == 0 {
            (self.width, self.height) = (image.width, image.height);
            self.means = Means::begin(image);
            self.brightest = vec![0; image.values.len()];
            self.crossed = vec![0.0; image.values.len()];
            self.steady = STEADY;
        }
        // Of what stays nothing is learnt about the motion of the rest.
        let steady = if self.n_images > 3 { self.steady } else { -1.0 };
        let profiles = Profiles::of(image, &self.means.deviation, steady);
        let shifts = self.profiles.shifts(&profiles);
        self.n_images += 1;
        let rate = 1.0 / self.n_images.min(MEMORY) as f32;
        let means = &mut self.means;
        vectorized(
            #[inline(always)]
            || means.add(image, rate),
        );
        for (brightest, value) in self.brightest.iter_mut().zip(&image.values) {
            *brightest = (*brightest).max(*value);
        }
        let scene = mean(&self.means.deviation);
        self.steady = (STEADY_SHARE * scene).clamp(STEADY, MAX_STEADY);
        self.add_crossings(&crossings(&shifts));
        self.profiles = profiles;
        std::mem::swap(&mut self.last, image);
    }

    /// Adds up, for the edges that have been here all along, how far the scene moved across them.
    fn add_crossings(&mut self, crossed: &[[f32; N_DIRECTIONS]]) {
        let watched = WATCHED_SHARE * WATCHED_SHARE;
        let (axis_x, axis_y) = (&self.means.axis_x, &self.means.axis_y);
        for ((crossed, x), y) in self.crossed.iter_mut().zip(axis_x).zip(axis_y) {
            *crossed = if x * x + y * y < watched { 0.0 } else { *crossed };
        }
        let is_crossed: Vec<bool> = crossed.iter().map(|across| across.iter().any(|px| *px > 0.0)).collect();
        for y in 0..self.height {
            for x in 0..self.width {
                let region = motion::region_of(x, y, self.width, self.height);
                let at = y * self.width + x;
                let (axis_x, axis_y) = (axis_x[at], axis_y[at]);
                if is_crossed[region] && axis_x * axis_x + axis_y * axis_y >= watched {
                    self.crossed[at] += crossed[region][direction(axis_x, axis_y)];
                }
            }
        }
    }

    /// Whether the pixel keeps its value.
    #[inline]
    pub fn is_steady(&self, at: usize) -> bool {
        self.means.deviation[at] <= self.steady
    }

    /// How far the value is from its mean, on average.
    #[inline]
    pub fn deviation(&self, at: usize) -> f32 {
        self.means.deviation[at]
    }

    /// The brightest the pixel ever was.
    #[inline]
    pub fn brightest(&self, at: usize) -> u8 {
        self.brightest[at]
    }

    /// The share of images that show an edge of one direction here.
    #[inline]
    pub fn edge_share(&self, at: usize) -> f32 {
        let (x, y) = (self.means.axis_x[at], self.means.axis_y[at]);
        (x * x + y * y).sqrt()
    }

    /// The same, always with the same side brighter.
    #[inline]
    pub fn signed_edge_share(&self, at: usize) -> f32 {
        let (x, y) = (self.means.towards_x[at], self.means.towards_y[at]);
        (x * x + y * y).sqrt()
    }

    /// Unit vector across the edge here.
    #[inline]
    pub fn normal(&self, at: usize) -> [f32; 2] {
        let angle = 0.5 * self.means.axis_y[at].atan2(self.means.axis_x[at]);
        [angle.cos(), angle.sin()]
    }

    /// How far the scene moved across the edge here while it stayed, pixels of the small image.
    #[inline]
    pub fn crossed(&self, at: usize) -> f32 {
        self.crossed[at]
    }
}

/// Which of the directions, over half a turn, a vector of twice its angle has.
#[inline]
fn direction(axis_x: f32, axis_y: f32) -> usize {
    let turns = axis_y.atan2(axis_x) / std::f32::consts::TAU;
    ((turns + 1.0) * N_DIRECTIONS as f32 + 0.5) as usize % N_DIRECTIONS
}

/// How far each region's scene has moved across edges of each direction, pixels; 0 if too nearly along them.
fn crossings(shifts: &[[f32; 2]]) -> Vec<[f32; N_DIRECTIONS]> {
    let across = |shift: &[f32; 2], direction: usize| {
        let angle = direction as f32 / N_DIRECTIONS as f32 * std::f32::consts::PI;
        let across = (shift[0] * angle.cos() + shift[1] * angle.sin()).abs();
        let counts = across >= MIN_CROSSING && across >= MIN_CROSSING_SINE * shift[0].hypot(shift[1]);
        if counts { across } else { 0.0 }
    };
    let of = |shift: &[f32; 2]| std::array::from_fn(|direction| across(shift, direction));
    debug_assert_eq!(shifts.len(), REGIONS * REGIONS);
    shifts.iter().map(of).collect()
}

/// The mean, summed in lanes.
fn mean(values: &[f32]) -> f32 {
    let (lanes, rest) = values.as_chunks::<8>();
    let mut sums = [0.0f32; 8];
    for lane in lanes {
        sums.iter_mut().zip(lane).for_each(|(sum, value)| *sum += value);
    }
    (sums.iter().sum::<f32>() + rest.iter().sum::<f32>()) / values.len().max(1) as f32
}
