//! Pictures of what of a session's images is not the scene.

use super::pictures;
use crate::error::{ApiError, ErrorCode};
use crate::session::SessionId;
use bytes::Bytes;
use geometry::CameraParameters;
use slam::SceneMask;
use std::sync::Arc;
use vision::decode::{DecodeLimits, EncodedImage, decode_gray};
use vision::mask::Mask;

/// A mask that leaves less of the image than this is a mistake, such as one that is white where nothing is to
/// be used.
const MIN_USED_SHARE: f64 = 0.05;

/// The mask that somebody gives for a camera's images, as a picture of their size.
///
/// # Errors
/// If it is no picture, of another size, or leaves nothing.
pub async fn read(
    file: Bytes,
    camera: &CameraParameters,
    limits: DecodeLimits,
) -> Result<SceneMask, ApiError> {
    let decode = move || {
        let picture = decode_gray(&EncodedImage::Auto(&file), &limits)
            .map_err(|error| ApiError::invalid("mask", format!("the picture cannot be read: {error}")))?;
        Ok::<_, ApiError>(Mask::from_picture(&picture))
    };
    let mask = tokio::task::spawn_blocking(decode).await.map_err(ApiError::internal)??;
    let (width, height) = (camera.width, camera.height);
    if (mask.width(), mask.height()) != (width, height) {
        let sentence = format!(
            "is of {}x{} pixels, and the camera of {width}x{height}: they must be the same",
            mask.width(),
            mask.height()
        );
        return Err(ApiError::invalid("mask", sentence));
    }
    if mask.share() > 1.0 - MIN_USED_SHARE {
        let sentence = format!(
            "leaves out {:.1} % of the image: it must be white where the scene is, and black where nothing is used",
            100.0 * mask.share()
        );
        return Err(ApiError::invalid("mask", sentence));
    }
    Ok(SceneMask { mask: Arc::new(mask), is_given: true })
}

/// A mask as a PNG file.
///
/// # Errors
/// If it cannot be written, which is a defect.
pub async fn picture(known: SceneMask) -> Result<Bytes, ApiError> {
    let encode = move || pictures::encode(known.mask.picture());
    let png = tokio::task::spawn_blocking(encode).await.map_err(ApiError::internal)?;
    png.ok_or_else(|| ApiError::internal("a mask cannot be written as PNG"))
}

/// The error where nothing is left out.
pub fn none_of(id: &SessionId) -> ApiError {
    ApiError::new(ErrorCode::ImageNotFound, format!("nothing of the images of session {id} is left out"))
}
