//! One run in a process of its own: peak memory and the state of caches and threads are then that run's
//! alone.

use std::path::PathBuf;
use std::process::Stdio;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use clap::Args;
use client::StreamSummary;
use proto::v1;
use recordings::{Evaluation, Layout, Recording, find_folder};
use serde::{Deserialize, Serialize};

use super::machine;
use super::playback::PlaybackArgs;
use super::setup::{Configuration, Pace};
use crate::commands::local::{LocalOutcome, LocalRun, LocalServer};
use crate::commands::report::Known;

/// One run.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Folder of the recording
    pub dataset: PathBuf,
    /// Its layout
    #[arg(long)]
    pub layout: Option<Layout>,
    /// Which features are on
    #[arg(long, value_enum)]
    pub configuration: Configuration,
    /// How fast frames come
    #[arg(long, value_enum)]
    pub pace: Pace,
    /// Run every stage in turn on one thread
    #[arg(long)]
    pub deterministic: bool,
    /// Seed of everything random
    #[arg(long)]
    pub seed: u64,
    /// Sessions at once
    #[arg(long, default_value_t = 1)]
    pub streams: u32,
    /// Which frames
    #[command(flatten)]
    pub playback: PlaybackArgs,
    /// File to write a report into
    #[arg(long)]
    pub report: Option<PathBuf>,
}

/// What came of one run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunResult {
    /// The recording's name.
    pub sequence: String,
    /// The share of the frames that have a pose in the trajectory.
    pub coverage: f64,
    /// How far the trajectory is from the truth; absent with too few poses.
    pub evaluation: Option<Evaluation>,
    /// What became of the frames.
    pub summary: StreamSummary,
    /// Peak of resident memory of server and client together, MiB; absent where the system does not tell.
    pub peak_memory_mib: Option<f64>,
    /// Processor time of server and client together for a frame, all threads, user and system, milliseconds;
    /// absent where the system does not tell.
    pub process_cpu_ms: Option<f64>,
}

impl RunArgs {
    /// Runs this in a new process and reads what it prints.
    pub async fn in_child(&self) -> Result<RunResult> {
        let program = std::env::current_exe().context("cannot find this program")?;
        let mut command = tokio::process::Command::new(program);
        command.arg("bench-run").arg(&self.dataset);
        command.args(["--configuration", &self.configuration.name().to_lowercase()]);
        command.args(["--pace", self.pace.name(), "--seed", &self.seed.to_string()]);
        if let Some(layout) = self.layout {
            command.args(["--layout", layout.name()]);
        }
        command.args(["--streams", &self.streams.to_string()]);
        if self.deterministic {
            command.arg("--deterministic");
        }
        command.args(self.playback.words());
        if let Some(report) = &self.report {
            command.arg("--report").arg(report);
        }
        let output =
            command.stdin(Stdio::null()).stderr(Stdio::inherit()).kill_on_drop(true).output().await?;
        ensure!(output.status.success(), "a run of {} failed: {}", self.dataset.display(), output.status);
        let text = String::from_utf8_lossy(&output.stdout);
        let last = text.lines().last().context("a run printed nothing")?;
        serde_json::from_str(last).context("what a run printed cannot be read")
    }

    fn options(&self) -> v1::SessionOptions {
        let (lines, global_primitives) = match self.configuration {
            Configuration::Default => (None, None),
            Configuration::P => (Some(false), Some(false)),
            Configuration::Lp => (Some(true), Some(false)),
            Configuration::Gp => (Some(true), Some(true)),
        };
        v1::SessionOptions {
            deterministic: Some(self.deterministic),
            seed: Some(self.seed),
            points: (self.configuration != Configuration::Default).then_some(true),
            lines,
            global_primitives,
            ..v1::SessionOptions::default()
        }
    }
}

/// The process of one run: prints its result as one line.
pub async fn run_once(args: RunArgs) -> Result<()> {
    let recording =
        Recording::open(&find_folder(&args.dataset)?, args.layout)?.played(&args.playback.playback())?;
    let sequence = recording.name.clone();
    let truth = recording.ground_truth.clone();
    let server = LocalServer::start().await?;
    let run = LocalRun {
        camera: recording.camera.parameters().clone(),
        options: args.options(),
        source: Arc::new(recording),
        truth: truth.as_ref(),
        is_realtime: args.pace == Pace::Realtime,
    };
    let n_streams = args.streams.max(1) as usize;
    let cpu_before_ms = machine::process_cpu_ms();
    let outcomes = server.run_streams(&run, n_streams).await?;
    let cpu_ms = machine::process_cpu_ms().zip(cpu_before_ms).map(|(after, before)| after - before);
    let n_frames: usize = outcomes.iter().map(|outcome| outcome.summary.frames).sum();
    let outcome = together(outcomes)?;
    if let Some(path) = &args.report {
        server.report(Known { truth, summary: Some(outcome.summary.clone()) }).await?.write(path)?;
    }
    server.stop().await?;
    let result = RunResult {
        sequence,
        coverage: outcome.coverage,
        evaluation: outcome.evaluation,
        summary: outcome.summary,
        peak_memory_mib: machine::peak_memory_mib(),
        process_cpu_ms: cpu_ms.map(|ms| ms / n_frames.max(1) as f64),
    };
    println!("{}", serde_json::to_string(&result)?);
    Ok(())
}

/// Of several streams at once: the one whose frames were slowest (95th percentile), with the least coverage
/// and the most frames dropped of any.
fn together(outcomes: Vec<LocalOutcome>) -> Result<LocalOutcome> {
    let coverage = outcomes.iter().map(|outcome| outcome.coverage).fold(f64::INFINITY, f64::min);
    let dropped = outcomes.iter().map(|outcome| outcome.summary.dropped).max().unwrap_or(0);
    let p95 = |outcome: &LocalOutcome| outcome.summary.wall_ms.map_or(0.0, |wall| wall.p95);
    let slowest = outcomes.into_iter().max_by(|a, b| p95(a).total_cmp(&p95(b))).context("no streams")?;
    let summary = StreamSummary { dropped, ..slowest.summary };
    Ok(LocalOutcome { coverage, summary, ..slowest })
}
