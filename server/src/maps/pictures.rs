//! Small pictures of sessions, for lists of them.

use super::MapQueries;
use super::shades::decode;
use crate::error::{ApiError, ErrorCode};
use crate::session::SessionId;
use bytes::Bytes;
use png::{BitDepth, ColorType, Encoder};
use slam::map::KeyframeId;
use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};
use vision::GrayImage;

/// Width of a small picture, pixels: sharp at half that on a dense screen.
const WIDTH_PX: u32 = 320;
/// Pictures kept, some 50 kB each.
const MAX_KEPT: usize = 64;

/// A small picture of a session: what its newest keyframe saw.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Changes when the picture does.
    pub tag: String,
    /// A PNG file, gray.
    pub png: Bytes,
}

/// The pictures that were asked for last, the oldest first.
#[derive(Default)]
pub(super) struct Pictures(Mutex<VecDeque<Picture>>);

impl MapQueries {
    /// A small picture of what a session saw last.
    ///
    /// # Errors
    /// If there is no such session, or none of its images was kept.
    pub async fn picture(&self, id: &SessionId) -> Result<Picture, ApiError> {
        let created_at_ns = self.store.get_session(id.as_str()).await?.created_at_ns;
        let newest = self.store.newest_image(id.as_str()).await?.ok_or_else(|| no_image(id))?;
        let tag = format!("{}-{created_at_ns}-{newest}", id.as_str());
        if let Some(picture) = self.pictures.kept(&tag) {
            return Ok(picture);
        }
        let png = self.small_image(id, newest).await?;
        let picture = Picture { tag, png };
        self.pictures.keep(picture.clone());
        Ok(picture)
    }

    async fn small_image(&self, id: &SessionId, keyframe: KeyframeId) -> Result<Bytes, ApiError> {
        // It may have been removed since.
        let image = self.store.keyframe_image(id.as_str(), keyframe).await?.ok_or_else(|| no_image(id))?;
        let limits = self.decode_limits;
        let shrink = move || encode(&shrunk(&decode(&image, &limits)?));
        let png = tokio::task::spawn_blocking(shrink).await.map_err(ApiError::internal)?;
        png.ok_or_else(|| no_image(id))
    }
}

impl Pictures {
    fn kept(&self, tag: &str) -> Option<Picture> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().find(|picture| picture.tag == tag).cloned()
    }

    fn keep(&self, picture: Picture) {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() == MAX_KEPT {
            kept.pop_front();
        }
        kept.push_back(picture);
    }
}

fn no_image(id: &SessionId) -> ApiError {
    ApiError::new(ErrorCode::ImageNotFound, format!("session {id} has no image that was kept"))
}

fn shrunk(image: &GrayImage) -> GrayImage {
    let width = image.width().min(WIDTH_PX);
    let height = (u64::from(image.height()) * u64::from(width) / u64::from(image.width().max(1))).max(1);
    vision::scale::resize_area(image, width, height as u32)
}

pub(super) fn encode(image: &GrayImage) -> Option<Bytes> {
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, image.width(), image.height());
    encoder.set_color(ColorType::Grayscale);
    encoder.set_depth(BitDepth::Eight);
    let mut writer = encoder.write_header().ok()?;
    writer.write_image_data(image.as_raw()).ok()?;
    writer.finish().ok()?;
    Some(file.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_small_and_in_proportion() {
        let large = GrayImage::from_fn(1280, 720, |x, _| (x / 5) as u8);
        let small = image::load_from_memory(&encode(&shrunk(&large)).unwrap()).unwrap().into_luma8();
        assert_eq!(small.dimensions(), (320, 180));
        assert_eq!(small.get_pixel(160, 90).0, [128]);
        assert_eq!(shrunk(&GrayImage::new(100, 50)).width(), 100, "never enlarged");
    }
}
