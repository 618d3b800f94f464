//! Locating one image in a stored map.
//!
//! The image goes through an engine of its own, made of the map's last commit and thrown away afterwards. So
//! nothing of the session changes, a connected writer is neither in the way nor disturbed, and the same image
//! gives the same answer whatever was asked before.

use super::decoder;
use super::frame::{FrameOutcome, SentImage};
use super::load::{self, LoadContext};
use crate::error::{ApiError, ErrorCode};
use std::time::Instant;
use tokio::sync::OwnedSemaphorePermit;
use tokio_util::sync::CancellationToken;
use vision::decode::{DecodeLimits, SampleDepth};

/// Where an image was taken, or why that is not known.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// What came of the image.
    pub report: FrameOutcome,
    /// Metres per map unit; `None` while the scale is free.
    pub metres_per_unit: Option<f64>,
    /// The map is as of this frame.
    pub durable_sequence: Option<u64>,
    /// Nanoseconds to read the map and to make it ready.
    pub load_ns: u64,
    /// Nanoseconds to locate the image in it.
    pub locate_ns: u64,
}

/// Locates an image. The `turn` is kept for as long as that is worked at; who gives the future up, ends the
/// work at its next stage.
///
/// # Errors
/// If the image cannot be used, or the session not be read. A place that is not found is no error.
pub async fn localize(
    context: &LoadContext<'_>,
    image: SentImage,
    limits: DecodeLimits,
    turn: OwnedSemaphorePermit,
) -> Result<Located, ApiError> {
    let begin = Instant::now();
    let given_up = CancellationToken::new();
    let _give_up = given_up.clone().drop_guard();
    let go_on = move || if given_up.is_cancelled() { Err(given_up_by_client()) } else { Ok(()) };
    let stored = load::read(context).await?;
    let (metres_per_unit, last_frame) = (stored.metres_per_unit, stored.last_frame());
    let locate = move || {
        let _turn = turn;
        go_on()?;
        let image = decoder::decode_image(&image, &limits, &mut SampleDepth::default())
            .map_err(|refusal| ApiError::invalid(refusal.field, refusal.reason))?;
        go_on()?;
        let mut pipeline = load::resume_to_locate(stored)?;
        go_on()?;
        let load_ns = begin.elapsed().as_nanos() as u64;
        let brightest = decoder::brightest(&image);
        let frame = slam::Frame { sequence: 0, timestamp_ns: 0, image };
        let report = pipeline.process_frame(frame).map_err(|error| {
            let refusal = decoder::rejection_of(&error, 0);
            ApiError::invalid(refusal.field, refusal.reason)
        })?;
        let report = FrameOutcome { report, brightest };
        let locate_ns = (begin.elapsed().as_nanos() as u64).saturating_sub(load_ns);
        let durable_sequence = last_frame.map(|(sequence, _)| sequence);
        Ok(Located { report, metres_per_unit, durable_sequence, load_ns, locate_ns })
    };
    // A panic of the engine is an internal error of this call.
    tokio::task::spawn_blocking(locate).await.map_err(ApiError::internal)?
}

/// Nobody hears it.
fn given_up_by_client() -> ApiError {
    ApiError::new(ErrorCode::TookTooLong, "nobody waits for the place of this image any more")
}
