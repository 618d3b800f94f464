//! Pictures of what of a session's images is not the scene.

use super::pictures;
use crate::error::{ApiError, ErrorCode};
use crate::session::SessionId;
use bytes::Bytes;
use geometry::nalgebra::Vector2;
use geometry::{Camera, CameraParameters};
use slam::SceneMask;
use std::sync::Arc;
use vision::decode::{DecodeLimits, EncodedImage, decode_alpha, decode_gray};
use vision::mask::Mask;

/// A mask that leaves less of the image than this is a mistake, such as one that is white where nothing is to
/// be used.
const MIN_USED_SHARE: f64 = 0.05;

/// The mask that somebody gives for a camera's images, as a picture of their size: dark where nothing is to
/// be used, or, if some of it is transparent, transparent there.
///
/// # Errors
/// If it is no picture, of another size, or leaves nothing.
pub async fn read(
    file: Bytes,
    camera: &CameraParameters,
    limits: DecodeLimits,
) -> Result<SceneMask, ApiError> {
    let decode = move || {
        if let Some(opacity) = decode_alpha(&file, &limits) {
            return Ok(Mask::from_picture(&opacity));
        }
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

/// What of a camera's images is left out, as a PNG file: a mask, and where the lens leads no ray to a pixel
/// or one too far from the axis. `None` if nothing is.
///
/// # Errors
/// If it cannot be written, which is a defect.
pub async fn picture(known: Option<SceneMask>, camera: Camera) -> Result<Option<Bytes>, ApiError> {
    let encode = move || {
        let lens = beyond_the_lens(&camera);
        let mask = match (known, lens) {
            (None, None) => return Ok(None),
            (Some(known), None) => known.mask.as_ref().clone(),
            (None, Some(lens)) => lens,
            (Some(known), Some(lens)) => {
                let known = known.mask.resized(lens.width(), lens.height());
                Mask::from_fn(lens.width(), lens.height(), |x, y| {
                    known.leaves_out(x, y) || lens.leaves_out(x, y)
                })
            }
        };
        let png = pictures::encode(mask.picture());
        png.map(Some).ok_or_else(|| ApiError::internal("a mask cannot be written as PNG"))
    };
    tokio::task::spawn_blocking(encode).await.map_err(ApiError::internal)?
}

/// The pixels that a lens leaves without a ray that is used, if there are any.
fn beyond_the_lens(camera: &Camera) -> Option<Mask> {
    if camera.folded_share() == 0.0 && camera.share_beyond_reach() == 0.0 {
        return None;
    }
    let is_beyond = |x: u32, y: u32| camera.undistort(&Vector2::new(x, y).cast()).is_none();
    Some(Mask::from_fn(camera.width(), camera.height(), is_beyond))
}

/// The error where nothing is left out.
pub fn none_of(id: &SessionId) -> ApiError {
    ApiError::new(ErrorCode::ImageNotFound, format!("nothing of the images of session {id} is left out"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::CameraModel;

    #[tokio::test]
    async fn what_a_lens_folds_over_is_part_of_the_mask_that_is_shown() {
        let parameters = CameraParameters::of_focal_length(200, 150, 100.0);
        let straight = Camera::new(parameters.clone()).unwrap();
        assert_eq!(picture(None, straight.clone()).await.unwrap(), None);
        let folding = CameraParameters {
            model: CameraModel::Radtan,
            distortion: vec![-0.3, 0.0, 0.0, 0.0],
            ..parameters
        };
        let folding = Camera::new(folding).unwrap();
        let left = Mask::from_fn(200, 150, |x, _| x < 20);
        let known = SceneMask { mask: Arc::new(left), is_given: true };
        let shown = picture(Some(known), folding).await.unwrap().unwrap();
        let shown = decode_gray(&EncodedImage::Auto(&shown), &DecodeLimits::default()).unwrap();
        assert_eq!([shown.get(10, 75), shown.get(100, 75)], [Some(0), Some(255)]);
        assert_eq!(shown.get(199, 149), Some(0), "the corner folds back");
    }

    #[tokio::test]
    async fn a_picture_with_transparent_parts_is_a_mask() {
        let mut file = std::io::Cursor::new(Vec::new());
        let opacity = |x: u32, _| image::Rgba([255, 255, 255, if x < 40 { 0 } else { 255 }]);
        image::RgbaImage::from_fn(200, 150, opacity).write_to(&mut file, image::ImageFormat::Png).unwrap();
        let camera = CameraParameters::of_focal_length(200, 150, 100.0);
        let mask = read(file.into_inner().into(), &camera, DecodeLimits::default()).await.unwrap();
        assert!((mask.mask.share() - 0.2).abs() < 1e-9, "{}", mask.mask.share());
    }
}
