//! `monoslam bench`: streams recordings through a server of its own and measures accuracy, time and memory.

mod ablation;
mod child;
mod machine;
mod markdown;
mod peers;
mod playback;
mod reference;
mod section;
mod setup;
mod statistics;
mod table;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use recordings::{Layout, Recording, find_folder};
use serde_json::json;

pub use child::{RunArgs, run_once};

use child::RunResult;
use machine::Machine;
use playback::PlaybackArgs;
use section::Section;
use setup::{Configuration, Pace};
use statistics::Row;
use table::Place;

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
    /// Sessions at once, each fed the whole recording: how many streams this machine carries. Figures are of
    /// the slowest
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    streams: u32,
    #[command(flatten)]
    playback: PlaybackArgs,
    /// Table of other systems' figures to put beside ours
    #[arg(long, value_name = "FILE")]
    peers: Option<PathBuf>,
    /// Layout of the recordings [default: recognized]
    #[arg(long, value_name = "L")]
    layout: Option<Layout>,
    /// Folder to write a report of each run into
    #[arg(long, value_name = "DIR")]
    reports: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Document to put the tables into, between its lines `<!-- begin: bench NAME -->` and `<!-- end: bench
    /// NAME -->`
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Section of that document [default: ablation with --ablation, else lossless or realtime, as the pace
    /// is]
    #[arg(long, value_name = "NAME", requires = "output")]
    section: Option<String>,
}

/// Measures.
pub async fn run(args: BenchArgs) -> Result<()> {
    // A mistake is better known before hours are spent on measuring.
    let section = args.output.as_deref().map(|path| Section::find(path, section_name(&args))).transpose()?;
    for dataset in &args.datasets {
        let recording =
            Recording::open(&find_folder(dataset)?, args.layout)?.played(&args.playback.playback())?;
        ensure!(recording.ground_truth.is_some(), "{} has no ground truth", dataset.display());
    }
    if let Some(folder) = &args.reports {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    let peers = args.peers.as_deref().map_or_else(|| Ok(Vec::new()), peers::read)?;
    let configurations: &[Configuration] =
        if args.ablation { &Configuration::ABLATION } else { &[Configuration::Default] };
    let reference_before = reference::reference_ms();
    let mut rows = Vec::new();
    for dataset in &args.datasets {
        for configuration in configurations {
            rows.push(measure(&args, dataset, *configuration).await?);
        }
    }
    let machine = Machine::this([reference_before, reference::reference_ms()]);
    if let Some(section) = section {
        let command = command_line(&args);
        section.write(&markdown::section(section.name(), &command, &machine, &rows, &peers))?;
    }
    if args.json {
        println!(
            "{}",
            json!({ "machine": machine, "pace": args.pace.name(), "sequences": rows, "peers": peers })
        );
    } else {
        print!("{}", markdown::tables(Place::Alone, &rows, &peers));
        let [before, after] = machine.reference_ms;
        println!("The reference job took {before:.0} ms before and {after:.0} ms after.");
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
            streams: args.streams,
            seed,
            playback: args.playback,
            report: args
                .reports
                .as_deref()
                .map(|folder| folder.join(report_name(dataset, configuration, seed))),
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

/// The file of a run's report.
fn report_name(dataset: &Path, configuration: Configuration, seed: u64) -> String {
    let name = dataset.file_name().unwrap_or_default().to_string_lossy();
    format!("{name}-{}-{seed}.html", configuration.name())
}

/// The section that the figures belong into.
fn section_name(args: &BenchArgs) -> &str {
    match (&args.section, args.ablation, args.pace) {
        (Some(name), ..) => name,
        (None, true, _) => "ablation",
        (None, false, Pace::Fast) => "lossless",
        (None, false, Pace::Realtime) => "realtime",
    }
}

/// The command as the user would repeat it: files and recordings by their names alone, since folders differ.
fn command_line(args: &BenchArgs) -> String {
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let datasets: Vec<String> = args.datasets.iter().filter_map(|path| name(path)).collect();
    let mut words = vec![format!("--runs {} --pace {}", args.runs, args.pace.name())];
    words.extend(args.ablation.then(|| "--ablation".to_owned()));
    words.extend(args.deterministic.then(|| "--deterministic".to_owned()));
    words.extend((args.streams > 1).then(|| format!("--streams {}", args.streams)));
    words.extend(args.layout.map(|layout| format!("--layout {layout}")));
    words.extend(args.playback.words());
    words.extend(args.peers.as_deref().and_then(name).map(|peers| format!("--peers {peers}")));
    format!("monoslam bench \\\n  {} \\\n  {}", datasets.join(" "), words.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: BenchArgs,
    }

    fn parsed(line: &str) -> BenchArgs {
        Line::parse_from(["bench"].into_iter().chain(line.split(' '))).args
    }

    #[test]
    fn the_commands_above_the_tables_of_the_repository_are_written_by_themselves() {
        let document = include_str!("../../../../docs/results.md");
        let datasets =
            "d/7scenes_redkitchen d/euroc_v1_01_part_b d/icl_of_kt0_first101 d/kitti_snippet_2 d/pov_office";
        for (name, rest) in [
            ("lossless", "--runs 5 --peers d/peers.csv"),
            ("realtime", "--runs 3 --pace realtime --peers d/peers.csv"),
            ("ablation", "--runs 15 --ablation --peers d/peers.csv"),
        ] {
            let args = parsed(&format!("{datasets} {rest}"));
            assert_eq!(section_name(&args), name);
            let begin = format!(
                "<!-- begin: bench {name} -->\n\nWritten by\n\n```sh\n{}\n```\n",
                command_line(&args)
            );
            assert!(document.contains(&begin), "{name}:\n{begin}");
        }
    }

    #[test]
    fn a_section_may_be_named() {
        assert_eq!(section_name(&parsed("d/room -o results.md --section rooms")), "rooms");
        assert!(Line::try_parse_from(["bench", "room", "--section", "rooms"]).is_err(), "of which document?");
    }
}
