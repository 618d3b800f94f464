//! The front end of visual SLAM: from the bytes that a client sent to features that can be matched and
//! tracked.
//!
//! ```text
//!                    ┌─► orb ────► Features ──► matching, KeypointGrid ──► matches
//!   bytes ─► decode ─┤              └─────────► place ──────────────────► images of the same place
//!            (gray)  └─► lines ──► TrackedLines ──► vanishing ──────────► vanishing points, rotation
//! ```
//!
//! * [`GrayImage`]: what everything here works on; [`decode::decode_gray`] makes one from PNG, JPEG or raw
//!   pixels sent by somebody we do not trust.
//! * Points: [`OrbExtractor`] gives [`Features`] (keypoints and descriptors); [`matching`] compares them in a
//!   list, in a window ([`KeypointGrid`]) or all against all.
//! * Lines: [`lines::detector()`] finds segments (edge drawing or LSD), [`lines::LineDescriber`] describes
//!   them (LBD), [`lines::LineFlow`] follows one by optical flow, and [`lines::LineTracker`] does all of it
//!   from image to image.
//! * [`vanishing`]: vanishing points of segments (J-Linkage), found and followed, and the rotation they give.
//! * [`mask`]: what of the images is not the scene, given or found, and how features keep away from it.
//! * [`place::PlaceIndex`]: which stored images show the same place, for loop closure and relocalization.
//!
//! The crate knows nothing of cameras, maps or files: coordinates are pixels of the image as given
//! (distorted, if the lens distorts), pixel centers at integers, the origin at the center of the top-left
//! pixel, x right, y down. Everything is single-threaded and deterministic: the same input gives the same
//! bytes.
//!
//! # Two images in miniature
//!
//! ```
//! use vision::lines::{self, LineDetectorConfig, LineTracker, LineTrackerConfig};
//! use vision::{GrayImage, OrbConfig, OrbExtractor, matching};
//!
//! // Bright and dark tiles of 40 px, on them a finer texture; then the same moved by (4, 2) pixels.
//! let view = |dx: u32, dy: u32| {
//!     let hash = |x: u32, y: u32| (x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77)) >> 13;
//!     GrayImage::from_fn(320, 240, |x, y| {
//!         let (x, y) = (x + dx, y + dy);
//!         let tile = if hash(x / 40, y / 40) % 2 == 0 { 40 } else { 180 };
//!         (tile + hash(x / 8, y / 8) % 40) as u8
//!     })
//! };
//! let (first, second) = (view(0, 0), view(4, 2));
//!
//! // Points: extract, describe, match.
//! let mut extractor = OrbExtractor::new(OrbConfig::default())?;
//! let (a, b) = (extractor.extract(&first), extractor.extract(&second));
//! let matches = matching::match_brute_force(&a, &b, &matching::MatchConfig::default());
//! let n_right = matches.iter().filter(|found| {
//!     let (p, q) = (a.keypoints[found.first_idx as usize], b.keypoints[found.second_idx as usize]);
//!     (p.x - q.x - 4.0).abs() < 1.5 && (p.y - q.y - 2.0).abs() < 1.5
//! });
//! assert!(n_right.count() > 100);
//!
//! // Lines: the same track is the same edge.
//! let mut detector = lines::detector(LineDetectorConfig::default())?;
//! let mut tracker = LineTracker::new(LineTrackerConfig::default())?;
//! let before = tracker.track(&first, detector.detect(&first), None);
//! let after = tracker.track(&second, detector.detect(&second), None);
//! let moved = after.lines.iter().filter_map(|line| {
//!     let old = before.lines.iter().find(|old| old.track == line.track)?;
//!     Some(line.segment.normal().dot(&(line.segment.midpoint() - old.segment.midpoint())))
//! });
//! let moved: Vec<f32> = moved.collect();
//! // Across itself a horizontal edge moved by 2 pixels, an upright one by 4.
//! let is_near = |px: &f32, expected: f32| (px.abs() - expected).abs() < 0.5;
//! assert!(moved.len() >= 5 && moved.iter().all(|px| is_near(px, 2.0) || is_near(px, 4.0)));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod contrast;
pub mod decode;
mod grid;
mod image;
pub mod lines;
pub mod mask;
pub mod matching;
pub mod orb;
pub mod place;
mod processor;
mod pyramid;
pub mod scale;
#[cfg(test)]
mod test_images;
pub mod vanishing;

pub use crate::grid::{GridBounds, KeypointGrid};
pub use crate::image::{GrayImage, ImageError, ImageStatistics};
pub use crate::orb::{Descriptor, Features, Keypoint, OrbConfig, OrbConfigError, OrbExtractor};
pub use crate::processor::vectorized;
pub use crate::pyramid::Pyramid;
