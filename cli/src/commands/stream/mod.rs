//! `monoslam stream`: streams a recording, a video or a camera into a session.

mod input;

use std::ops::Range;
use std::sync::Arc;

use anyhow::{Result, anyhow, bail, ensure};
use clap::{Args, ValueEnum};
use client::{
    FrameSource, Pacing, Placement, SessionEnd, SlamClient, StreamPlan, StreamSummary, camera_message,
    stream_frames,
};
use input::{Input, InputArgs};
use proto::v1;

use super::progress::Progress;
use super::{ServerArgs, positive, session_id, summary};

/// What to stream, where to, and how.
#[derive(Debug, Args)]
pub struct StreamArgs {
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    server: ServerArgs,
    /// The session; it is made if there is none of this name [default: a new one, named by the server]
    #[arg(long, value_name = "NAME", value_parser = session_id)]
    session: Option<String>,
    /// Have the new session's camera extend the map of this session, beside that one's camera and at the same
    /// time, instead of making a map of its own
    #[arg(long, value_name = "NAME", value_parser = session_id)]
    map: Option<String>,
    /// What the server does when frames come faster than it tracks: hold them back, or drop the oldest
    /// [default: lossless; realtime for a camera]
    #[arg(long, value_enum)]
    policy: Option<Policy>,
    /// Frames per second [default: as fast as they are taken, or as recorded if realtime]. Of images without
    /// times, on standard input or in a folder without a list, it is what their times are made from
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
    /// End the stream of another client that is streaming into the session
    #[arg(long)]
    take_over: bool,
    /// Begin a new segment of the session: the times of its frames may be any, as after a clock was set back
    #[arg(long)]
    new_segment: bool,
    /// Stream a recording again that the session has already, behind what is there
    #[arg(long)]
    again: bool,
    /// Only locate the frames in the session's map, which must be there and stays as it is
    #[arg(long, requires = "session")]
    localize_only: bool,
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
    /// Give the calibration up for the camera that the images show, where they contradict it
    #[arg(long, conflicts_with = "no_calibration")]
    wide_calibration: bool,
    /// Do not look for what stays in the image while the scene moves, such as borders and watermarks
    #[arg(long)]
    no_mask: bool,
    /// Rolling shutter: milliseconds from the first row of an image to the last; phones take 8 to 35, 0 is a
    /// global shutter. Left out it is found where the motion shows it
    #[arg(long, value_name = "MS")]
    readout_ms: Option<f64>,
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
            give_up_calibration: self.wide_calibration.then_some(true),
            find_mask: self.no_mask.then_some(false),
            readout_ms: self.readout_ms,
            ..v1::SessionOptions::default()
        }
    }
}

/// Streams it.
pub async fn run(args: StreamArgs) -> Result<()> {
    let input = input::open(&args.input, args.fps)?;
    let source = input.source.clone();
    let n_frames = source.n_frames();
    let range = args.start..args.end.unwrap_or(usize::MAX).min(n_frames.unwrap_or(usize::MAX));
    ensure!(
        !range.is_empty(),
        "no frames from {} on before {}: {} has {}",
        range.start,
        range.end,
        input.name,
        n_frames.map_or_else(|| "more".to_owned(), |n| n.to_string())
    );
    let mut client = args.server.connect().await?;
    let session = open_session(&mut client, &args, &input).await?;
    // The source may have to read up to the frame at which the session ends.
    let placing = {
        let (session, source, range, again) = (session.clone(), source.clone(), range.clone(), args.again);
        tokio::task::spawn_blocking(move || place(&session, source.as_ref(), &range, again))
    };
    let placement = placing.await??;
    let range = remaining(&session, placement, range);
    let fps = args.fps.filter(|_| !input.is_timed_by_rate);
    let plan = plan(&args, fps, &session, source.as_ref(), range, placement);
    input.stop_on_interrupt();
    let streamed = stream_with_progress(&mut client, &source, &plan).await?;
    if let Some(remark) = input.remark() {
        eprintln!("{remark}");
    }
    if args.json {
        println!("{}", serde_json::to_string(&streamed)?);
    } else {
        print!("{}", summary::table(&streamed));
    }
    ensure!(streamed.rejected == 0, "{} of {} frames were rejected", streamed.rejected, streamed.frames);
    Ok(())
}

fn plan(
    args: &StreamArgs,
    fps: Option<f64>,
    session: &v1::Session,
    source: &dyn FrameSource,
    range: Range<usize>,
    placement: Placement,
) -> StreamPlan {
    let is_live = source.is_live();
    let policy = args.policy.unwrap_or(if is_live { Policy::Realtime } else { Policy::Lossless });
    StreamPlan {
        session_id: session.id.clone(),
        policy: match policy {
            Policy::Lossless => v1::StreamPolicy::Lossless,
            Policy::Realtime => v1::StreamPolicy::Realtime,
        },
        pacing: match (fps, policy) {
            // A camera sets the pace itself.
            _ if is_live => Pacing::Unpaced,
            (Some(rate), _) => Pacing::FramesPerSecond(rate),
            (None, Policy::Realtime) => Pacing::Recorded,
            (None, Policy::Lossless) => Pacing::Unpaced,
        },
        range,
        placement,
        take_over: args.take_over,
        new_segment: args.new_segment,
        localize_only: args.localize_only,
    }
}

/// Streams the frames of a plan under a progress bar.
pub async fn stream_with_progress(
    client: &mut SlamClient,
    source: &Arc<dyn FrameSource>,
    plan: &StreamPlan,
) -> Result<StreamSummary> {
    let n_frames = (plan.range.end < usize::MAX).then(|| plan.range.len());
    let mut progress = Progress::new(plan.range.start, n_frames);
    let streamed = stream_frames(client, source, plan, |event| progress.show(&event)).await;
    progress.finish();
    Ok(streamed?)
}

/// The session of that name, made if there is none.
async fn open_session(client: &mut SlamClient, args: &StreamArgs, input: &Input) -> Result<v1::Session> {
    let camera = camera_message(&input.camera);
    if let Some(name) = &args.session
        && let Some(session) = client.session(name).await?
    {
        let is_same = |theirs: &v1::Camera| {
            // Of a camera that nobody knows the session has a guess.
            let is_unknown = camera.fx == 0.0 && camera.fy == 0.0;
            *theirs == camera || is_unknown && (theirs.width, theirs.height) == (camera.width, camera.height)
        };
        if !session.camera.as_ref().is_some_and(is_same) {
            bail!("the session `{name}` was made for another camera than that of {}", input.name);
        }
        if let Some(map) = args.map.as_ref().filter(|map| session.map.as_ref() != Some(*map)) {
            match &session.map {
                Some(other) => {
                    bail!("the session `{name}` extends the map of `{other}`, not that of `{map}`")
                }
                None => bail!(
                    "the session `{name}` has a map of its own; leave out --map, or name another session"
                ),
            }
        }
        if args.options.message() != v1::SessionOptions::default() {
            eprintln!("the session `{name}` is there already and keeps the options it was made with");
        }
        return Ok(session);
    }
    let name = args.session.as_deref().unwrap_or_default();
    ensure!(
        !args.localize_only,
        "there is no session `{name}` to locate frames in; leave out --localize-only to make one"
    );
    let mut options = args.options.message();
    let mask = input.mask.clone().unwrap_or_default();
    if let Some(map) = &args.map {
        // Of a camera that nobody knows the map knows more, if it is like its own.
        let is_known = camera.fx != 0.0 || camera.fy != 0.0;
        let (session_id, camera) = (name.to_owned(), is_known.then_some(camera));
        let (options, map) = (Some(options), map.clone());
        return Ok(client
            .create(v1::CreateSessionRequest { session_id, camera, options, mask, map })
            .await?);
    }
    if input.is_approximate {
        options.set_calibration(v1::Calibration::Approximate);
    }
    Ok(client.create_session_with_mask(name, &input.camera, options, mask).await?)
}

/// Where in the session the frames go.
fn place(
    session: &v1::Session,
    source: &dyn FrameSource,
    range: &Range<usize>,
    again: bool,
) -> Result<Placement> {
    let last_sequence = session.next_sequence.checked_sub(1);
    let last_frame = last_sequence.zip(session.last_timestamp_ns);
    let end = SessionEnd { next_sequence: session.next_sequence, last_frame };
    Placement::in_session(end, source, range, again).map_err(|refused| anyhow!("{refused}"))
}

/// The frames of the range that the session does not have yet.
fn remaining(session: &v1::Session, placement: Placement, range: Range<usize>) -> Range<usize> {
    let next_idx = placement.frame_idx(session.next_sequence);
    let remaining = range.start.max(next_idx).min(range.end)..range.end;
    if remaining.start > range.start {
        let n_there = remaining.start - range.start;
        eprintln!(
            "the session `{}` has {n_there} of these frames already and goes on behind them",
            session.id
        );
    }
    remaining
}
