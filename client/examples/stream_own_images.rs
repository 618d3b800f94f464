//! Maps images that a program makes itself and prints each pose as it comes.
//!
//! `cargo run -p client --example stream_own_images -- http://127.0.0.1:50051 [SESSION]`
//!
//! Here the images are drawn: a wall of squares that a camera moves along. In their place may be those of a
//! camera's library. What gives them in turn implements `FrameReader`; `Sequential` keeps the latest, so that
//! a connection may break.

use std::error::Error;
use std::sync::Arc;

use client::{
    CameraModel, CameraParameters, FileError, FrameAnswer, FrameImage, FrameReader, FrameSource, PixelFormat,
    RawImage, Sequential, SlamClient, StreamEvent, StreamPlan, TimedFrame, stream_frames, v1,
};

const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;
const N_FRAMES: u32 = 60;

/// A camera that moves to the right along two walls, at 30 frames a second.
struct Drawn {
    next: u32,
}

impl FrameReader for Drawn {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, FileError> {
        if self.next == N_FRAMES {
            return Ok(None);
        }
        let way = 0.02 * f64::from(self.next);
        let data = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| gray(x, y, way))).collect();
        let image =
            RawImage { format: PixelFormat::Gray8, width: WIDTH, height: HEIGHT, row_stride: WIDTH, data };
        let timestamp_ns = i64::from(self.next) * 1_000_000_000 / 30;
        self.next += 1;
        Ok(Some(TimedFrame { timestamp_ns, image: FrameImage::Raw(image) }))
    }
}

/// Squares of random gray on a wall 3 units away, and on one 2 units away in the lower half.
fn gray(x: u32, y: u32, way: f64) -> u8 {
    let depth = if y > HEIGHT / 2 { 2.0 } else { 3.0 };
    let on_wall = |pixel: u32, center: f64| (f64::from(pixel) - center) / 250.0 * depth;
    let square = |length: f64| (length * 8.0).floor() as i64 as u64;
    let (column, row) = (square(on_wall(x, 159.5) + way), square(on_wall(y, 119.5)));
    let mixed = (column.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ row).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (mixed >> 56) as u8
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [server, rest @ ..] = words.as_slice() else {
        return Err("usage: stream_own_images SERVER [SESSION]".into());
    };
    let camera = CameraParameters {
        model: CameraModel::Pinhole,
        width: WIDTH,
        height: HEIGHT,
        fx: 250.0,
        fy: 250.0,
        cx: 159.5,
        cy: 119.5,
        distortion: Vec::new(),
    };
    let mut client = SlamClient::connect(server).await?;
    let name = rest.first().map_or("", String::as_str);
    let session = client.create_session(name, &camera, v1::SessionOptions::default()).await?;
    let source: Arc<dyn FrameSource> = Arc::new(Sequential::live(Box::new(Drawn { next: 0 })));
    let plan = StreamPlan::lossless(&session.id, source.as_ref());
    let summary = stream_frames(&mut client, &source, &plan, |event| match event {
        StreamEvent::Answered { frame_idx, answer: FrameAnswer::Result(result) } => {
            println!("{frame_idx} {} {:?}", result.state().as_str_name(), result.pose_world_from_camera);
        }
        StreamEvent::Answered { frame_idx, answer } => println!("{frame_idx} {answer:?}"),
        StreamEvent::Reconnecting { error, after } => eprintln!("{error}; again in {after:?}"),
    })
    .await?;
    println!("{}: {} of {} frames have a pose", session.id, summary.tracked + summary.weak, summary.frames);
    Ok(())
}
