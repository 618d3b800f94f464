//! `monoslam trajectory`: fetches the trajectory of a session.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use client::{HttpClient, TrajectoryFormat, TrajectoryKind};

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
        Some(path) => write_file(&http, &args, path).await,
        None => {
            let mut out = io::stdout().lock();
            http.write_trajectory(&args.session, args.format, args.kind, &mut out).await?;
            Ok(out.flush()?)
        }
    }
}

/// Writes beside the file and renames, so that a file of that name is always whole.
async fn write_file(http: &HttpClient, args: &TrajectoryArgs, path: &Path) -> Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".part");
    let partial = PathBuf::from(partial);
    let written = async {
        let mut out = BufWriter::new(File::create(&partial)?);
        http.write_trajectory(&args.session, args.format, args.kind, &mut out).await?;
        out.flush()?;
        fs::rename(&partial, path)?;
        anyhow::Ok(())
    };
    let outcome = written.await;
    if outcome.is_err() {
        // It may not have been made.
        let _ = fs::remove_file(&partial);
    }
    outcome.with_context(|| format!("cannot fetch the trajectory into {}", path.display()))
}
