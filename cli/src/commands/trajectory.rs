//! `monoslam trajectory`: fetches the trajectory of a session.

use std::io::{self, Write};
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use client::{TrajectoryFormat, TrajectoryKind};

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
    /// File to write instead of standard output
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Fetches it.
pub async fn run(args: TrajectoryArgs) -> Result<()> {
    let http = args.server.http().await?;
    match &args.output {
        Some(path) => {
            let mut file = OutputFile::create(path)?;
            let written = http.write_trajectory(&args.session, args.format, args.kind, &mut file).await;
            written.with_context(|| format!("cannot fetch the trajectory into {}", path.display()))?;
            file.finish()
        }
        None => {
            let mut out = io::stdout().lock();
            http.write_trajectory(&args.session, args.format, args.kind, &mut out).await?;
            Ok(out.flush()?)
        }
    }
}
