//! The front end of the SLAM system, point part: from the bytes a client sent to described, matchable keypoints.
//!
//! - [`GrayImage`]: what everything here works on; [`decode::decode_gray`] makes one from PNG, JPEG or raw pixels
//!   sent by somebody we do not trust.
//! - [`OrbExtractor`]: scale pyramid, FAST corners spread over the image, orientation, steered BRIEF; gives [`Features`].
//! - [`KeypointGrid`] and [`matching`]: windowed and exhaustive matching; [`place::PlaceIndex`]: which stored image
//!   shows the same place.
//! - [`vanishing`]: vanishing points of segments, found and followed, and the rotation they give.
//!
//! The crate knows nothing of cameras, maps or files: coordinates are pixels of the image as given (distorted, if the
//! lens distorts), pixel centres at integers, the origin at the centre of the top-left pixel, x right, y down.
//! Everything is deterministic and single-threaded.
//!
//! ```
//! use vision::{GrayImage, OrbConfig, OrbExtractor, matching};
//!
//! // A checkerboard-like texture, and the same texture moved by (4, 2) pixels.
//! let texture = |dx: u32, dy: u32| {
//!     let hash = |x: u32, y: u32| ((x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77)) >> 13) as u8;
//!     let data = (0..240u32).flat_map(|y| (0..320u32).map(move |x| hash((x + dx) / 9, (y + dy) / 9))).collect();
//!     GrayImage::from_raw(320, 240, data).unwrap()
//! };
//! let mut extractor = OrbExtractor::new(OrbConfig::default()).unwrap();
//! let first = extractor.extract(&texture(0, 0));
//! let second = extractor.extract(&texture(4, 2));
//! let matches = matching::match_brute_force(&first, &second, &matching::MatchConfig::default());
//! assert!(matches.len() > 100);
//! ```

pub mod decode;
mod grid;
mod image;
pub mod lines;
pub mod matching;
pub mod orb;
pub mod place;
mod pyramid;
pub mod scale;
#[cfg(test)]
mod test_images;
pub mod vanishing;

pub use crate::grid::{GridBounds, KeypointGrid};
pub use crate::image::{GrayImage, ImageError, ImageStatistics};
pub use crate::orb::{Descriptor, Features, Keypoint, OrbConfig, OrbConfigError, OrbExtractor};
pub use crate::pyramid::Pyramid;
