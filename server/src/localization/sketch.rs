//! Which of many maps an image may show, by looks alone: a small index of the descriptors of each map's
//! points.

use crate::error::ApiError;
use slam::map::KeyframeId;
use std::collections::BTreeMap;
use std::sync::Arc;
use vision::place::PlaceIndex;
use vision::scale::{BilinearResizer, resize_area};
use vision::{Descriptor, GrayImage, OrbConfig, OrbExtractor};

/// Larger side of an image when its descriptors are compared with maps', pixels: that of most maps' images.
const LOOKS_SIDE_PX: f64 = 640.0;
/// Smallest side then, pixels: what the extractor needs.
const MIN_SIDE_PX: f64 = 96.0;
/// Parts of a map whose votes are counted: points that are seen together were mostly made by a few keyframes.
const N_PARTS: usize = 4;
/// Fewest votes with which a map is worth a look: chance gives some ten.
pub const MIN_VOTES: u32 = 16;
/// Bytes an indexed descriptor takes: in two trees, 40 each.
const BYTES_PER_POINT: usize = 80;

/// A map, as far as its looks go.
#[derive(Clone)]
pub struct Sketch {
    index: Arc<PlaceIndex>,
    n_points: usize,
}

impl Sketch {
    /// Of a map's points, by the keyframes that made them.
    pub fn of(points: &BTreeMap<KeyframeId, Vec<Descriptor>>) -> Self {
        let mut index = PlaceIndex::new();
        for (keyframe, descriptors) in points {
            index.insert(keyframe.get(), descriptors);
        }
        Self { index: Arc::new(index), n_points: points.values().map(Vec::len).sum() }
    }

    /// Memory it takes, about, bytes.
    pub fn n_bytes(&self) -> usize {
        self.n_points * BYTES_PER_POINT
    }

    /// How many descriptors speak for the image showing this map.
    pub fn votes(&self, descriptors: &[Descriptor]) -> u32 {
        self.index.query(descriptors, N_PARTS).iter().map(|part| part.n_votes).sum()
    }
}

/// What an image looks like, for [`Sketch::votes`].
///
/// # Errors
/// If the extractor cannot be made, which is our own fault.
pub fn looks_of(image: &GrayImage) -> Result<Vec<Descriptor>, ApiError> {
    let (width, height) = (f64::from(image.width()), f64::from(image.height()));
    let factor = (LOOKS_SIDE_PX / width.max(height)).max(MIN_SIDE_PX / width.min(height));
    let [new_width, new_height] = [width, height].map(|side| (side * factor).round().max(1.0) as u32);
    let resized = if factor < 1.0 {
        resize_area(image, new_width, new_height)
    } else {
        let mut larger = GrayImage::default();
        BilinearResizer::default().resize(image, new_width, new_height, &mut larger);
        larger
    };
    let mut extractor = OrbExtractor::new(OrbConfig::default()).map_err(ApiError::internal)?;
    Ok(extractor.extract(&resized).descriptors)
}
