//! The decoding stage: beside the tracking thread, one frame ahead of it, in order.

use super::frame::{Rejection, SentFrame, SentImage};
use super::queue::{FrameQueue, Queued};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::SyncSender;
use std::time::Instant;
use vision::GrayImage;
use vision::decode::{DecodeError, DecodeLimits, SampleDepth, decode_gray_alike};

/// What tracking takes, in the order of arrival.
#[derive(Debug)]
pub enum Decoded {
    /// A frame ready to be tracked.
    Frame {
        /// The frame for the engine.
        frame: slam::Frame,
        /// The gray of its brightest pixel.
        brightest: u8,
        /// The image as it was sent, to be kept with a keyframe.
        sent: SentImage,
        /// When it arrived.
        arrived: Instant,
    },
    /// A frame that newer ones pushed out.
    Dropped(u64),
    /// A frame that cannot be used.
    Rejected(Rejection),
}

/// Decodes what the queue holds until it ends or nobody listens any more. Samples of 16 bits are scaled as in
/// the session's images before, of which `depth` knows.
pub fn run(
    queue: &FrameQueue,
    limits: &DecodeLimits,
    depth: &mut SampleDepth,
    decoded: &SyncSender<Decoded>,
) {
    while let Some(item) = queue.pop_blocking() {
        let item = match item {
            Queued::Frame(frame) => decode(frame, limits, depth),
            Queued::Dropped(sequence) => Decoded::Dropped(sequence),
            Queued::Rejected(rejection) => Decoded::Rejected(rejection),
        };
        if decoded.send(item).is_err() {
            break;
        }
    }
}

fn decode(frame: SentFrame, limits: &DecodeLimits, depth: &mut SampleDepth) -> Decoded {
    // What is kept of the image beyond here is bounded elsewhere.
    let SentFrame { sequence, timestamp_ns, image: sent, arrived, charge: _charge } = frame;
    match decode_image(&sent, limits, depth) {
        Ok(image) => {
            let brightest = brightest(&image);
            let frame = slam::Frame { sequence, timestamp_ns, image };
            Decoded::Frame { frame, brightest, sent, arrived }
        }
        Err(ImageRefusal { field, reason, code }) => {
            Decoded::Rejected(Rejection { sequence, field, reason, code })
        }
    }
}

/// Why an image cannot be decoded.
#[derive(Debug)]
pub struct ImageRefusal {
    /// Which part of the message is wrong.
    pub field: &'static str,
    /// What is wrong with it, in a plain sentence.
    pub reason: String,
    /// Stable name of the kind of error.
    pub code: &'static str,
}

/// The gray of an image's brightest pixel.
pub fn brightest(image: &GrayImage) -> u8 {
    image.as_raw().iter().copied().max().unwrap_or(0)
}

/// The gray image that was sent.
///
/// # Errors
/// If it cannot be decoded or is larger than is accepted.
pub fn decode_image(
    sent: &SentImage,
    limits: &DecodeLimits,
    depth: &mut SampleDepth,
) -> Result<GrayImage, ImageRefusal> {
    // The decoders promise not to panic; a file that breaks the promise costs its own frame, not the session.
    match catch_unwind(AssertUnwindSafe(|| decode_gray_alike(&sent.as_encoded(), limits, depth))) {
        Ok(Ok(image)) => Ok(image),
        Ok(Err(error)) => {
            let (field, code) = blame(&error);
            Err(ImageRefusal { field, reason: error.to_string(), code })
        }
        Err(_panic) => {
            tracing::error!("the decoder panicked on an image");
            let reason = "the image cannot be decoded".to_owned();
            Err(ImageRefusal { field: "image.data", reason, code: "DECODER_FAILED" })
        }
    }
}

/// The field at fault and the stable name of an error.
fn blame(error: &DecodeError) -> (&'static str, &'static str) {
    match error {
        DecodeError::TooManyBytes { .. } => ("image.data", "TOO_MANY_BYTES"),
        DecodeError::Empty { .. } => ("image", "EMPTY_IMAGE"),
        DecodeError::TooSmall { .. } => ("image", "IMAGE_TOO_SMALL"),
        DecodeError::TooLarge { .. } => ("image", "IMAGE_TOO_LARGE"),
        DecodeError::StrideTooShort { .. } => ("image.row_stride", "STRIDE_TOO_SHORT"),
        DecodeError::WrongLength { .. } => ("image.data", "WRONG_DATA_LENGTH"),
        DecodeError::UnknownFormat | DecodeError::OtherFormat { .. } => ("image.data", "UNKNOWN_FORMAT"),
        DecodeError::WrongFormat { .. } => ("image.encoding", "WRONG_FORMAT"),
        DecodeError::Truncated { .. } => ("image.data", "TRUNCATED_IMAGE"),
        DecodeError::Malformed { .. } => ("image.data", "MALFORMED_IMAGE"),
    }
}

/// A frame the engine refused.
pub fn rejection_of(error: &slam::FrameError, sequence: u64) -> Rejection {
    use slam::FrameError;
    let (field, code) = match error {
        FrameError::WrongImageSize { .. } => ("image", "WRONG_IMAGE_SIZE"),
        FrameError::TimestampNotIncreasing { .. } => ("timestamp_ns", "TIMESTAMP_NOT_INCREASING"),
        FrameError::SequenceNotIncreasing { .. } => ("sequence", "SEQUENCE_NOT_INCREASING"),
    };
    Rejection { sequence, field, reason: format!("{error}{}", advice(error)), code }
}

/// A frame further back in time than this comes from a clock that was set, and not from a frame out of order,
/// nanoseconds.
const CLOCK_SET_BACK_NS: i64 = 500_000_000;

/// How to go on after a clock was set.
pub const NEW_SEGMENT: &str = "open the stream anew with `new_segment` (`monoslam stream --new-segment`), whose times \
                               may be any";

/// What to do about a frame the engine refused, where that is not plain.
fn advice(error: &slam::FrameError) -> String {
    match error {
        slam::FrameError::TimestampNotIncreasing { timestamp_ns, last_timestamp_ns } => {
            let back_ns = last_timestamp_ns.saturating_sub(*timestamp_ns);
            if back_ns < CLOCK_SET_BACK_NS {
                return "; frames must come in the order of their times".to_owned();
            }
            let back_s = back_ns as f64 * 1e-9;
            format!(
                "; the clock was set back by {back_s:.1} s: {NEW_SEGMENT}, take times from a clock that is not set (monotonic), \
                 or go on behind the last frame, as `monoslam stream --continue-times` does"
            )
        }
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::frame::Encoding;
    use crate::session::queue::Policy;
    use std::sync::mpsc::sync_channel;
    use vision::decode::PixelFormat;

    fn raw(sequence: u64, data: &[u8]) -> Queued {
        let encoding = Encoding::Raw(PixelFormat::Gray8);
        let data = bytes::Bytes::copy_from_slice(data);
        let image = SentImage { encoding, width: 160, height: 120, row_stride: 0, data };
        Queued::Frame(SentFrame { sequence, timestamp_ns: 0, image, arrived: Instant::now(), charge: None })
    }

    #[tokio::test]
    async fn what_was_queued_comes_out_in_order_decoded_or_blamed() {
        let queue = FrameQueue::new(Policy::Realtime, 2);
        queue.push(raw(0, &[7; 160 * 120])).await.unwrap();
        queue.push(raw(1, &[7; 160 * 120])).await.unwrap();
        queue.push(raw(2, &[7; 5])).await.unwrap();
        queue.close(Ok(()));
        let (sender, decoded) = sync_channel(8);
        run(&queue, &DecodeLimits::default(), &mut SampleDepth::default(), &sender);
        drop(sender);
        let [first, second, third] = <[Decoded; 3]>::try_from(decoded.iter().collect::<Vec<_>>()).unwrap();
        assert!(matches!(first, Decoded::Dropped(0)));
        assert!(
            matches!(second, Decoded::Frame { frame, .. } if frame.sequence == 1 && frame.image.get(0, 0) == Some(7))
        );
        let Decoded::Rejected(rejection) = third else { panic!("{third:?}") };
        assert_eq!(
            (rejection.sequence, rejection.field, rejection.code),
            (2, "image.data", "WRONG_DATA_LENGTH")
        );
    }

    #[test]
    fn a_clock_that_was_set_back_is_told_from_frames_out_of_order() {
        let reason = |timestamp_ns: i64| {
            let error =
                slam::FrameError::TimestampNotIncreasing { timestamp_ns, last_timestamp_ns: 10_000_000_000 };
            rejection_of(&error, 3).reason
        };
        assert!(
            reason(0).contains("set back by 10.0 s") && reason(0).contains("--continue-times"),
            "{}",
            reason(0)
        );
        assert!(reason(9_970_000_000).contains("in the order of their times"));
    }

    #[test]
    fn decoding_ends_when_nobody_listens() {
        let queue = FrameQueue::new(Policy::Lossless, 2);
        let (sender, decoded) = sync_channel(1);
        drop(decoded);
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(queue.push(raw(0, &[7; 160 * 120]))).unwrap();
        // The queue stays open: were the closed channel not noticed, this would wait for ever.
        run(&queue, &DecodeLimits::default(), &mut SampleDepth::default(), &sender);
    }
}
