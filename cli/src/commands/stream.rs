//! `monoslam stream`: streams a recording into a session.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Result, bail, ensure};
use clap::{Args, ValueEnum};
use client::{
    FrameSource, Pacing, Placement, SessionEnd, SlamClient, StreamPlan, StreamSummary, camera_message,
    stream_frames,
};
use proto::v1;
use recordings::{Layout, Recording, find_folder};

use super::progress::Progress;
use super::{ServerArgs, positive, report, session_id};

/// What to stream, where to, and how.
#[derive(Debug, Args)]
pub struct StreamArgs {
    /// Folder of the recording; also looked for in the folder that MONOSLAM_DATA names
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    #[command(flatten)]
    server: ServerArgs,
    /// The session; it is made if there is none of this name [default: a new one, named by the server]
    #[arg(long, value_name = "NAME", value_parser = session_id)]
    session: Option<String>,
    /// What the server does when frames come faster than it tracks: hold them back, or drop the oldest
    #[arg(long, value_enum, default_value = "lossless")]
    policy: Policy,
    /// Frames per second [default: as fast as they are taken, or as recorded if realtime]
    #[arg(long, value_name = "N", value_parser = positive)]
    fps: Option<f64>,
    /// First frame to stream, counted from zero
    #[arg(long, value_name = "N", default_value_t = 0)]
    start: usize,
    /// Frame to stop before
    #[arg(long, value_name = "N")]
    end: Option<usize>,
    #[command(flatten)]
    options: OptionArgs,
    /// Layout of the recording: folder, euroc, kitti, tum or icl [default: recognized]
    #[arg(long, value_name = "L")]
    layout: Option<Layout>,
    /// End the stream of another client that is streaming into the session
    #[arg(long)]
    take_over: bool,
    /// Stream a recording again that the session has already, behind what is there
    #[arg(long)]
    again: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Policy {
    Lossless,
    Realtime,
}

/// Options of a new session.
#[derive(Clone, Debug, Default, Args)]
pub struct OptionArgs {
    /// Do not use lines
    #[arg(long)]
    no_lines: bool,
    /// Do not use global primitives
    #[arg(long)]
    no_primitives: bool,
    /// Do not close loops
    #[arg(long)]
    no_loops: bool,
    /// Take the calibration as it is given, whatever the images say
    #[arg(long)]
    no_calibration: bool,
    /// Run every stage in turn: the same frames and seed give the same map
    #[arg(long)]
    pub deterministic: bool,
    /// Seed of everything random
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Features to extract per frame
    #[arg(long, value_name = "N")]
    n_features: Option<u32>,
}

impl OptionArgs {
    /// As the contract has them; what is not asked for is left to the server.
    pub fn message(&self) -> v1::SessionOptions {
        v1::SessionOptions {
            deterministic: self.deterministic.then_some(true),
            seed: self.seed,
            n_features: self.n_features,
            lines: self.no_lines.then_some(false),
            global_primitives: self.no_primitives.then_some(false),
            loop_closing: self.no_loops.then_some(false),
            refine_calibration: self.no_calibration.then_some(false),
            ..v1::SessionOptions::default()
        }
    }
}

/// Streams it.
pub async fn run(args: StreamArgs) -> Result<()> {
    let recording = Recording::open(&find_folder(&args.dataset)?, args.layout)?;
    let range = args.start..args.end.unwrap_or(usize::MAX).min(recording.frames.len());
    ensure!(
        !range.is_empty(),
        "no frames from {} on before {}: the recording has {}",
        range.start,
        range.end,
        recording.frames.len()
    );
    let mut client = args.server.connect().await?;
    let session = open_session(&mut client, &args, &recording).await?;
    let source: Arc<dyn FrameSource> = Arc::new(recording);
    let placement = place(&session, source.as_ref(), &range, args.again);
    let range = remaining(&session, placement, range);
    let plan = StreamPlan {
        session_id: session.id.clone(),
        policy: match args.policy {
            Policy::Lossless => v1::StreamPolicy::Lossless,
            Policy::Realtime => v1::StreamPolicy::Realtime,
        },
        pacing: match (args.fps, args.policy) {
            (Some(rate), _) => Pacing::FramesPerSecond(rate),
            (None, Policy::Realtime) => Pacing::Recorded,
            (None, Policy::Lossless) => Pacing::Unpaced,
        },
        range,
        placement,
        take_over: args.take_over,
    };
    let summary = stream_with_progress(&mut client, &source, &plan).await?;
    if args.json {
        println!("{}", serde_json::to_string(&summary)?);
    } else {
        print!("{}", report::summary(&summary));
    }
    ensure!(summary.rejected == 0, "{} of {} frames were rejected", summary.rejected, summary.frames);
    Ok(())
}

/// Streams the frames of a plan under a progress bar.
pub async fn stream_with_progress(
    client: &mut SlamClient,
    source: &Arc<dyn FrameSource>,
    plan: &StreamPlan,
) -> Result<StreamSummary> {
    let mut progress = Progress::new(plan.range.start, plan.range.len());
    let streamed = stream_frames(client, source, plan, |event| progress.show(&event)).await;
    progress.finish();
    Ok(streamed?)
}

/// The session of that name, made if there is none.
async fn open_session(
    client: &mut SlamClient,
    args: &StreamArgs,
    recording: &Recording,
) -> Result<v1::Session> {
    let camera = camera_message(recording.camera.parameters());
    if let Some(name) = &args.session
        && let Some(session) = client.session(name).await?
    {
        if session.camera.as_ref() != Some(&camera) {
            bail!("the session `{name}` was made for another camera than that of {}", args.dataset.display());
        }
        if args.options.message() != v1::SessionOptions::default() {
            eprintln!("the session `{name}` is there already and keeps the options it was made with");
        }
        return Ok(session);
    }
    let name = args.session.as_deref().unwrap_or_default();
    Ok(client.create_session(name, recording.camera.parameters(), args.options.message()).await?)
}

/// Where in the session the recording goes.
fn place(session: &v1::Session, source: &dyn FrameSource, range: &Range<usize>, again: bool) -> Placement {
    let last_sequence = session.next_sequence.checked_sub(1);
    let last_frame = last_sequence.zip(session.last_timestamp_ns);
    let end = SessionEnd { next_sequence: session.next_sequence, last_frame };
    Placement::in_session(end, source, range, again)
}

/// The frames of the range that the session does not have yet.
fn remaining(session: &v1::Session, placement: Placement, range: Range<usize>) -> Range<usize> {
    let next_idx = placement.frame_idx(session.next_sequence);
    let remaining = range.start.max(next_idx).min(range.end)..range.end;
    if remaining.start > range.start {
        eprintln!(
            "the session `{}` has {} of these {} frames already and goes on behind them",
            session.id,
            remaining.start - range.start,
            range.len()
        );
    }
    remaining
}
