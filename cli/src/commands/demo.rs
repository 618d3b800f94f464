//! `monoslam demo`: a synthetic room, streamed through a server of its own.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result};
use clap::Args;
use client::{FrameError, FrameSource, SourceFrame, StreamSummary};
use proto::v1;
use recordings::{StampedPose, Trajectory};
use synthetic::{Preset, Sequence, SequenceConfig};

use super::local::{LocalRun, LocalServer};
use super::report::Known;
use super::summary;

/// What to show.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Leave the server up until Ctrl-C
    #[arg(long)]
    keep: bool,
    /// Frames to render
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    frames: u32,
    /// Seed of the room and of everything random
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Draw map and trajectories, seen from above, into an SVG file
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Write everything about the session on one page that needs no server
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// A sequence whose frames are rendered when they are sent.
struct Rendered(Sequence);

impl FrameSource for Rendered {
    fn n_frames(&self) -> Option<usize> {
        Some(self.0.len())
    }

    fn frame(&self, frame_idx: usize) -> Result<Option<SourceFrame>, FrameError> {
        if frame_idx >= self.0.len() {
            return Ok(None);
        }
        let image = self.0.frame(frame_idx).image;
        let (width, height) = (image.width(), image.height());
        let image = v1::Image {
            encoding: v1::ImageEncoding::Gray8.into(),
            width,
            height,
            row_stride: 0,
            data: image.pixels().to_vec().into(),
        };
        Ok(Some(SourceFrame { timestamp_ns: self.0.timestamp_ns(frame_idx), image }))
    }

    fn timestamp_ns(&self, frame_idx: usize) -> Result<Option<i64>, FrameError> {
        Ok((frame_idx < self.0.len()).then(|| self.0.timestamp_ns(frame_idx)))
    }
}

/// Shows it.
pub async fn run(args: DemoArgs) -> Result<()> {
    let mut config = SequenceConfig::preset(Preset::RoomRich, args.seed);
    config.n_frames = Some(args.frames as usize);
    let sequence = Sequence::new(config)?;
    let true_pose = |(timestamp_ns, world_from_camera)| StampedPose { timestamp_ns, world_from_camera };
    let truth = Trajectory::new(sequence.ground_truth().into_iter().map(true_pose).collect());
    let server = LocalServer::start().await?;
    println!("A server is up: gRPC at {}, HTTP at {}", server.grpc(), server.http());
    println!("Rendering a room and streaming {} frames of it…", sequence.len());
    let run = LocalRun {
        camera: sequence.camera().parameters().clone(),
        options: v1::SessionOptions { seed: Some(args.seed), ..v1::SessionOptions::default() },
        source: Arc::new(Rendered(sequence)),
        truth: Some(&truth),
        is_realtime: false,
    };
    let outcome = server.run(run).await?;
    println!("\n{}", summary::table(&outcome.summary).trim_end());
    println!("{:<26} {:.1} % of the frames have a pose", "trajectory", 100.0 * outcome.coverage);
    let evaluation =
        outcome.evaluation.context("the trajectory is too short to be compared with the truth")?;
    println!(
        "{:<26} {:.4} of a path of {:.2} ({:.2} %)",
        "ATE RMSE",
        evaluation.ate_rmse,
        evaluation.path,
        evaluation.ate_percent_of_path.unwrap_or_default()
    );
    if let Some(path) = &args.report {
        let known = Known { truth: Some(truth.clone()), summary: Some(outcome.summary.clone()) };
        server.report(known).await?.write(path)?;
        println!("{:<26} {}", "report", path.display());
    }
    if let Some(path) = &args.picture {
        let title = format!(
            "A rendered room and the path of the camera through it, seen from above ({})",
            sizes(&outcome.summary)
        );
        server.scene(title, truth, outcome.trajectory).await?.write(path)?;
        println!("{:<26} {}", "picture", path.display());
    }
    if args.keep {
        println!("\nThe map is at {} until you press Ctrl-C.", server.http());
        tokio::signal::ctrl_c().await?;
    } else {
        println!("\nWith --keep the map stays, to be looked at in a browser at the HTTP address.");
    }
    server.stop().await
}

fn sizes(summary: &StreamSummary) -> String {
    let StreamSummary { points, lines, primitives, .. } = summary;
    format!("{points} points, {lines} lines, {primitives} primitives")
}
