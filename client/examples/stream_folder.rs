//! Maps a folder of images and prints the trajectory.
//!
//! `cargo run -p client --example stream_folder -- http://127.0.0.1:50051 FOLDER [SESSION]`

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use client::{FrameAnswer, FrameSource, Recording, SlamClient, StreamEvent, StreamPlan, stream_frames, v1};

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [server, folder, rest @ ..] = words.as_slice() else {
        return Err("usage: stream_folder SERVER FOLDER [SESSION]".into());
    };
    let recording = Recording::open(Path::new(folder), None)?;
    let mut client = SlamClient::connect(server).await?;
    // Without a name the server chooses one.
    let name = rest.first().map_or("", String::as_str);
    let session =
        client.create_session(name, recording.camera.parameters(), v1::SessionOptions::default()).await?;

    let source: Arc<dyn FrameSource> = Arc::new(recording);
    let plan = StreamPlan::lossless(&session.id, source.as_ref());
    let summary = stream_frames(&mut client, &source, &plan, |event| match event {
        StreamEvent::Answered { frame_idx, answer: FrameAnswer::Result(result) } => {
            eprintln!("frame {frame_idx}: {} {}", result.state().as_str_name(), result.reason);
        }
        StreamEvent::Answered { frame_idx, answer } => eprintln!("frame {frame_idx}: {answer:?}"),
        StreamEvent::Reconnecting { error, after } => eprintln!("{error}; again in {after:?}"),
    })
    .await?;
    eprintln!("{}: {} of {} frames tracked", session.id, summary.tracked, summary.frames);

    let trajectory = client.http().await?.trajectory(&session.id).await?;
    print!("{}", trajectory.to_tum());
    Ok(())
}
