//! `monoslam bench`: streams recordings through a server of its own and measures accuracy, time and memory.

mod ablation;
mod child;
mod machine;
mod markdown;
mod peers;
mod playback;
mod statistics;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use recordings::{Layout, Recording, find_folder};
use serde_json::json;

pub use child::{RunArgs, run_once};

use child::RunResult;
use machine::Machine;
use playback::PlaybackArgs;
use statistics::Row;

/// What to measure.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Folders of recordings with ground truth; also looked for in the folder that MONOSLAM_DATA names
    #[arg(value_name = "DATASET", required = true)]
    datasets: Vec<PathBuf>,
    /// Runs of each; every run has a seed of its own
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// Measure points (P), points and lines (LP), and points, lines and global primitives (GP) side by side
    #[arg(long)]
    ablation: bool,
    /// Frames as fast as every one is tracked, or as recorded with the server dropping those it has no time
    /// for
    #[arg(long, value_enum, default_value = "fast")]
    pace: Pace,
    /// Run every stage in turn on one thread
    #[arg(long)]
    deterministic: bool,
    #[command(flatten)]
    playback: PlaybackArgs,
    /// Table of other systems' figures to put beside ours
    #[arg(long, value_name = "FILE")]
    peers: Option<PathBuf>,
    /// Layout of the recordings [default: recognized]
    #[arg(long, value_name = "L")]
    layout: Option<Layout>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Write a document with all figures
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// How fast frames come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Pace {
    /// As fast as every one is tracked.
    Fast,
    /// As recorded.
    Realtime,
}

impl Pace {
    fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Realtime => "realtime",
        }
    }
}

/// Which features are on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Configuration {
    /// The default options of a session.
    Default,
    /// Points.
    P,
    /// Points and lines.
    Lp,
    /// Points, lines and global primitives.
    Gp,
}

impl Configuration {
    const ABLATION: [Self; 3] = [Self::P, Self::Lp, Self::Gp];

    fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::P => "P",
            Self::Lp => "LP",
            Self::Gp => "GP",
        }
    }
}

/// Measures.
pub async fn run(args: BenchArgs) -> Result<()> {
    // A mistake in the last recording is better known before hours are spent on the others.
    for dataset in &args.datasets {
        let recording =
            Recording::open(&find_folder(dataset)?, args.layout)?.played(&args.playback.playback())?;
        ensure!(recording.ground_truth.is_some(), "{} has no ground truth", dataset.display());
    }
    let peers = args.peers.as_deref().map_or_else(|| Ok(Vec::new()), peers::read)?;
    let configurations: &[Configuration] =
        if args.ablation { &Configuration::ABLATION } else { &[Configuration::Default] };
    let mut rows = Vec::new();
    for dataset in &args.datasets {
        for configuration in configurations {
            rows.push(measure(&args, dataset, *configuration).await?);
        }
    }
    let machine = Machine::this();
    if let Some(path) = &args.output {
        let document = markdown::document(&command_line(&args), &machine, args.pace, &rows, &peers);
        std::fs::write(path, document).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        println!(
            "{}",
            json!({ "machine": machine, "pace": args.pace.name(), "sequences": rows, "peers": peers })
        );
    } else {
        print!("{}", markdown::tables(&rows, &peers));
    }
    Ok(())
}

/// All runs of one recording.
async fn measure(args: &BenchArgs, dataset: &Path, configuration: Configuration) -> Result<Row> {
    let mut runs: Vec<RunResult> = Vec::new();
    for seed in 0..u64::from(args.runs) {
        let run = RunArgs {
            dataset: dataset.to_owned(),
            layout: args.layout,
            configuration,
            pace: args.pace,
            deterministic: args.deterministic,
            seed,
            playback: args.playback,
        };
        let result = run.in_child().await?;
        eprintln!(
            "{} {} run {}/{}: coverage {:.3}, ATE RMSE {}",
            result.sequence,
            configuration.name(),
            seed + 1,
            args.runs,
            result.coverage,
            result.evaluation.as_ref().map_or("-".to_owned(), |e| format!("{:.4}", e.ate_rmse))
        );
        runs.push(result);
    }
    Row::new(configuration.name(), runs).context("no runs")
}

/// The command as the user would repeat it: recordings by their names alone, since folders differ.
fn command_line(args: &BenchArgs) -> String {
    let mut words = vec!["monoslam bench".to_owned()];
    words.extend(
        args.datasets.iter().filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned())),
    );
    words.push(format!("--runs {} --pace {}", args.runs, args.pace.name()));
    words.extend(args.ablation.then(|| "--ablation".to_owned()));
    words.extend(args.deterministic.then(|| "--deterministic".to_owned()));
    words.extend(args.playback.words());
    words.join(" ")
}
