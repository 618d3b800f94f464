//! The ways of a request before it reaches the service, for the fuzz targets (`server/fuzz`).

use super::convert;
use crate::access::Caller;
use crate::error::ApiError;
use crate::options::check_camera;
use crate::options::engine_config;
use crate::page::PageRequest;
use crate::session::decode_image;
use prost::Message as _;
use proto::v1;
use proto::v1::stream_frames_request::Message;
use vision::decode::{DecodeLimits, SampleDepth};

/// Small enough that a run is quick.
const LIMITS: DecodeLimits =
    DecodeLimits { max_bytes: 1 << 16, max_pixels: 1 << 16, min_width: 2, min_height: 2 };

/// Takes a request of one of the kinds as far as the service would before it asks the database or a session.
/// An error must say something.
pub fn take(kind: u8, message: &[u8]) {
    let outcome = match kind % 4 {
        0 => v1::CreateSessionRequest::decode(message).map(create_session),
        1 => v1::StreamFramesRequest::decode(message).map(stream_frames),
        2 => v1::LocalizeRequest::decode(message).map(localize),
        _ => v1::ListSessionsRequest::decode(message).map(list_sessions),
    };
    if let Ok(Err(error)) = outcome {
        assert!(!error.message.is_empty());
    }
}

fn create_session(request: v1::CreateSessionRequest) -> Result<(), ApiError> {
    let new = convert::new_session(&Caller::open(), request)?;
    let config = engine_config(&new.options)?;
    if let Ok(camera) = check_camera(new.camera) {
        // What the engine sizes its grids by.
        let (least, greatest) = camera.undistorted_bounds();
        assert!(least.iter().chain(&greatest).all(|value| value.is_finite()), "{:?}", camera.parameters());
        config.working_camera(&camera);
    }
    Ok(())
}

fn stream_frames(request: v1::StreamFramesRequest) -> Result<(), ApiError> {
    match request.message {
        Some(Message::Open(open)) => convert::open_request(&Caller::open(), open).map(drop),
        Some(Message::Frame(frame)) => {
            match convert::frame(frame, None) {
                Ok(frame) => decode(&frame.image),
                Err(rejection) => assert!(!rejection.reason.is_empty() && !rejection.code.is_empty()),
            }
            Ok(())
        }
        None => Ok(()),
    }
}

fn localize(request: v1::LocalizeRequest) -> Result<(), ApiError> {
    Caller::open().session(&request.session_id, "session_id")?;
    decode(&convert::image_to_locate(request.image)?);
    Ok(())
}

fn list_sessions(request: v1::ListSessionsRequest) -> Result<(), ApiError> {
    let v1::ListSessionsRequest { page_size, page_token } = request;
    let page = PageRequest::new(page_size, page_token)?;
    page.after::<slam::map::KeyframeId>()?;
    Ok(())
}

/// The decoder's panics, which the server survives, are found here too.
fn decode(image: &crate::session::SentImage) {
    if let Err(refusal) = decode_image(image, &LIMITS, &mut SampleDepth::default()) {
        assert!(!refusal.reason.is_empty());
        assert_ne!(refusal.code, "DECODER_FAILED");
    }
}
