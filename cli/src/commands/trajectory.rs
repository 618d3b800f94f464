//! `monoslam trajectory`: fetches the trajectory of a session.

use std::io::{self, Write};
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use client::{Submaps, TrajectoryFormat, TrajectoryKind};

use super::output::OutputFile;
use super::{ServerArgs, session_id};

/// What to fetch.
#[derive(Debug, Args)]
pub struct TrajectoryArgs {
    /// The session
    #[arg(value_name = "NAME", value_parser = session_id)]
    session: String,
    #[command(flatten)]
    server: ServerArgs,
    /// tum, euroc, kitti, csv or json
    #[arg(long, default_value = "tum")]
    format: TrajectoryFormat,
    /// frames or keyframes
    #[arg(long, default_value = "frames")]
    kind: TrajectoryKind,
    /// Whose poses: all, largest or the number of a submap; submaps do not share a frame of reference
    /// [default: largest, and in csv and json all]
    #[arg(long, value_name = "all|largest|N")]
    submap: Option<Submaps>,
    /// File to write instead of standard output
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Fetches it.
pub async fn run(args: TrajectoryArgs) -> Result<()> {
    let http = args.server.http().await?;
    let submaps = args.submap.unwrap_or_default();
    match &args.output {
        Some(path) => {
            let mut file = OutputFile::create(path)?;
            let written =
                http.write_trajectory(&args.session, args.format, args.kind, submaps, &mut file).await;
            let n_left_out =
                written.with_context(|| format!("cannot fetch the trajectory into {}", path.display()))?;
            file.finish()?;
            tell_left_out(n_left_out);
        }
        None => {
            let mut out = io::stdout().lock();
            let n_left_out =
                http.write_trajectory(&args.session, args.format, args.kind, submaps, &mut out).await?;
            out.flush()?;
            tell_left_out(n_left_out);
        }
    }
    Ok(())
}

fn tell_left_out(n_poses: u64) {
    if n_poses > 0 {
        eprintln!(
            "{n_poses} poses are left out: they are in other submaps, with frames of reference of their own (--submap \
             chooses one, --format csv has all)"
        );
    }
}
