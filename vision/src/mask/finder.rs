//! Finds what is not the scene: what stays where it is in the image while the scene moves.

use super::evidence::Evidence;
use super::small::{SmallImage, reduction};
use super::{Mask, regions};
use crate::GrayImage;

/// How a mask is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskFinderConfig {
    /// A black border is believed after so many images between which the scene has moved. Default 8: what is
    /// dark in the scene has moved on.
    pub min_images_of_border: u32,
    /// The same for anything else that stays. Default 24.
    pub min_images: u32,
    /// A border is black where it was never brighter than this, gray levels. Default 20: black of video is
    /// 16.
    pub black: u8,
    /// Share of the images that must show an edge for it to be one that stays. Default 0.8.
    pub min_edge_share: f32,
    /// The same once it is masked. Default 0.5.
    pub min_edge_share_while_masked: f32,
    /// How far the scene must have moved across an edge that stays, pixels of the image it is found in, at
    /// most 320 wide. Default 24: no edge of the scene stays by chance; a kerb that a car follows, which
    /// moves along itself, does for seconds.
    pub min_crossing: f32,
    /// Share of the border of a part of the image that keeps its values that must be edges which stay for the
    /// whole of it to be left out: the sky keeps them too, but what stands before it moves. Default 0.6.
    pub min_edge_share_of_border: f64,
    /// Edges that stay are left out in pieces of at least so many pixels of the image it is found in, at most
    /// 320 wide. Default 6.
    pub min_piece: usize,
    /// Once a border would have been found, every so many frames are looked at. Default 2.
    pub first_interval: u32,
    /// Images between which the scene has moved after which `later_interval` holds. Default 64.
    pub n_images_at_first: u32,
    /// Two frames in a row of so many are looked at then. Default 16.
    pub later_interval: u32,
}

impl Default for MaskFinderConfig {
    fn default() -> Self {
        Self {
            min_images_of_border: 8,
            min_images: 24,
            black: 20,
            min_edge_share: 0.8,
            min_edge_share_while_masked: 0.5,
            min_crossing: 24.0,
            min_edge_share_of_border: 0.6,
            min_piece: 6,
            first_interval: 2,
            n_images_at_first: 64,
            later_interval: 16,
        }
    }
}

/// A decision is made anew after so many images.
const DECISION_INTERVAL: u32 = 4;
/// A black border is left out if at least this share of its inner edge is an edge in most images.
const MIN_BLACK_EDGE_SHARE: f64 = 0.6;
/// How often an edge must be there for that.
const BLACK_EDGE: f32 = 0.6;
/// Black borders smaller than this share of the image are left to the other rule.
const MIN_BORDER_SHARE: f64 = 0.002;
/// The values on the two sides of an edge that stays are compared this far from it, pixels.
const SIDE_DISTANCE: f32 = 3.0;
/// The scene's side varies by this many times as much as the other, at least,
const SIDE_RATIO: f32 = 3.0;
/// and by this, gray levels.
const SIDE_DEVIATION: f32 = 8.0;
/// Edges that stay are made thicker by this before what they enclose is looked at, pixels.
const WALL_GROWTH: usize = 2;
/// A mask that differs from the one before in less than this share of the image is not another.
const MIN_CHANGE: f64 = 0.001;

/// Finds what is not the scene in a stream of images. Deterministic; costs nothing while the camera stands.
#[derive(Clone, Debug)]
pub struct MaskFinder {
    config: MaskFinderConfig,
    small: SmallImage,
    evidence: Evidence,
    n_looked_at: u32,
    /// Of the images.
    size: (u32, u32),
    n_decided: u32,
    /// What is left out at present, in the small image.
    left_out: Vec<bool>,
}

impl MaskFinder {
    /// Nothing is known at first.
    pub fn new(config: MaskFinderConfig) -> Self {
        Self {
            config,
            small: SmallImage::default(),
            evidence: Evidence::default(),
            n_looked_at: 0,
            size: (0, 0),
            n_decided: 0,
            left_out: Vec::new(),
        }
    }

    /// Looks at the next image, and says what is left out if that has changed.
    pub fn look(&mut self, image: &GrayImage) -> Option<Mask> {
        self.n_looked_at = self.n_looked_at.wrapping_add(1);
        if !self.is_looked_at(self.n_looked_at) {
            return None;
        }
        self.size = (image.width(), image.height());
        self.small.take(image);
        self.left_out.resize(self.small.width * self.small.height, false);
        if self.small.width < 32
            || self.small.height < 32
            || !self.evidence.has_moved(&self.small, &self.left_out)
        {
            return None;
        }
        self.evidence.add(&mut self.small);
        let n_images = self.evidence.n_images;
        if n_images < self.config.min_images_of_border || n_images < self.n_decided + DECISION_INTERVAL {
            return None;
        }
        self.n_decided = n_images;
        self.decide().then(|| self.mask_for(image.width(), image.height()))
    }

    /// Images looked at between which the scene had moved.
    pub fn n_images(&self) -> u32 {
        self.evidence.n_images
    }

    /// Whether a frame is looked at: each, while a border may have to be found before the map begins; later
    /// two in a row now and then, for between more distant ones it cannot be told which way the scene moved.
    fn is_looked_at(&self, frame: u32) -> bool {
        let MaskFinderConfig {
            min_images_of_border, n_images_at_first, first_interval, later_interval, ..
        } = self.config;
        let n_images = self.evidence.n_images;
        if n_images < min_images_of_border {
            true
        } else if n_images < n_images_at_first {
            frame.is_multiple_of(first_interval.max(1))
        } else {
            frame % later_interval.max(1) < 2
        }
    }

    /// Whether it has seen enough to say that there is nothing else to be left out.
    pub fn is_settled(&self) -> bool {
        self.n_decided >= 2 * self.config.min_images
    }

    /// Whether something else is left out now than before.
    fn decide(&mut self) -> bool {
        let width = self.evidence.width;
        let mut found = self.black_border();
        if self.evidence.n_images >= self.config.min_images {
            let edges = self.staying_edges();
            let parts = self.steady_parts(&edges);
            for at in 0..found.len() {
                found[at] |= edges[at] || parts[at];
            }
        }
        regions::grow(&mut found, width, 1);
        let n_changed = found.iter().zip(&self.left_out).filter(|(now, before)| now != before).count();
        let is_other = n_changed as f64 > MIN_CHANGE * found.len() as f64;
        if is_other {
            self.left_out = found;
        }
        is_other
    }

    /// Parts at the image's border that were black in all images, with an edge towards the scene that stays.
    fn black_border(&self) -> Vec<bool> {
        let Evidence { width, height, .. } = self.evidence;
        let is_black = |at: usize| self.evidence.brightest(at) <= self.config.black;
        let (labels, n_parts) = regions::label(width, height, is_black);
        let mut touches = vec![false; n_parts as usize + 1];
        let mut sizes = vec![0usize; n_parts as usize + 1];
        let mut edges = vec![[0usize; 2]; n_parts as usize + 1];
        for at in 0..width * height {
            let label = labels[at] as usize;
            if label == 0 {
                continue;
            }
            sizes[label] += 1;
            let (x, y) = (at % width, at / width);
            touches[label] |= x == 0 || y == 0 || x + 1 == width || y + 1 == height;
            for next in regions::sides(at, width, height).filter(|next| labels[*next] == 0) {
                let there = self.evidence.edge_share(at).max(self.evidence.edge_share(next));
                edges[label][0] += 1;
                edges[label][1] += usize::from(there >= BLACK_EDGE);
            }
        }
        let min_size = MIN_BORDER_SHARE * (width * height) as f64;
        let is_border: Vec<bool> = (0..=n_parts as usize)
            .map(|label| {
                let [n, n_edges] = edges[label];
                label > 0
                    && touches[label]
                    && sizes[label] as f64 >= min_size
                    && n > 0
                    && n_edges as f64 >= MIN_BLACK_EDGE_SHARE * n as f64
            })
            .collect();
        labels.iter().map(|label| is_border[*label as usize]).collect()
    }

    /// Edges that were there all along while the scene moved across them.
    fn staying_edges(&self) -> Vec<bool> {
        let Evidence { width, height, .. } = self.evidence;
        let stays = |at: usize| {
            let share = self.evidence.edge_share(at);
            let is_masked = self.left_out[at];
            let least =
                if is_masked { self.config.min_edge_share_while_masked } else { self.config.min_edge_share };
            share >= least
                && self.evidence.crossed(at) >= self.config.min_crossing
                && (self.evidence.signed_edge_share(at) >= least || self.divides(at))
        };
        let (labels, n_parts) = regions::label(width, height, stays);
        let mut sizes = vec![0usize; n_parts as usize + 1];
        for label in &labels {
            sizes[*label as usize] += 1;
        }
        labels.iter().map(|label| *label != 0 && sizes[*label as usize] >= self.config.min_piece).collect()
    }

    /// Whether values vary on one side of an edge and stay on the other.
    fn divides(&self, at: usize) -> bool {
        let Evidence { width, height, .. } = self.evidence;
        let normal = self.evidence.normal(at);
        let (x, y) = ((at % width) as f32, (at / width) as f32);
        let beside = |sign: f32| {
            let (x, y) = (x + sign * SIDE_DISTANCE * normal[0], y + sign * SIDE_DISTANCE * normal[1]);
            let x = x.round().clamp(0.0, width as f32 - 1.0) as usize;
            let y = y.round().clamp(0.0, height as f32 - 1.0) as usize;
            self.evidence.deviation(y * width + x)
        };
        let (a, b) = (beside(1.0), beside(-1.0));
        a.max(b) >= SIDE_DEVIATION && a.max(b) >= SIDE_RATIO * a.min(b)
    }

    /// Parts that keep their values, and whose borders are mostly edges that stay.
    fn steady_parts(&self, edges: &[bool]) -> Vec<bool> {
        let Evidence { width, height, .. } = self.evidence;
        if !edges.contains(&true) {
            return vec![false; edges.len()];
        }
        // Gaps between edges are closed.
        let mut walls = edges.to_vec();
        regions::grow(&mut walls, width, WALL_GROWTH);
        let edges = &walls;
        let is_steady = |at: usize| self.evidence.is_steady(at) && !edges[at];
        let (labels, n_parts) = regions::label(width, height, is_steady);
        let mut borders = vec![[0usize; 2]; n_parts as usize + 1];
        for at in 0..width * height {
            if labels[at] == 0 {
                continue;
            }
            for next in regions::sides(at, width, height).filter(|next| labels[*next] == 0) {
                let counts = &mut borders[labels[at] as usize];
                counts[0] += 1;
                counts[1] += usize::from(edges[next]);
            }
        }
        let is_left_out = |label: &u32| {
            let [n, n_edges] = borders[*label as usize];
            *label != 0 && n > 0 && n_edges as f64 >= self.config.min_edge_share_of_border * n as f64
        };
        labels.iter().map(is_left_out).collect()
    }

    /// What is left out at present, for images of the size that was looked at last; `None` before any.
    pub fn mask(&self) -> Option<Mask> {
        (self.n_decided > 0).then(|| self.mask_for(self.size.0, self.size.1))
    }

    /// What is left out, for images of this size.
    fn mask_for(&self, width: u32, height: u32) -> Mask {
        let by = reduction(width);
        let last = |side: usize| side as u32 - 1;
        Mask::from_fn(width, height, |x, y| {
            let (x, y) = ((x / by).min(last(self.evidence.width)), (y / by).min(last(self.evidence.height)));
            self.left_out[y as usize * self.evidence.width + x as usize]
        })
    }
}
