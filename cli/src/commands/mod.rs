//! One module for each command.

mod bench;
mod calibration;
mod demo;
mod evaluate;
mod export;
mod local;
mod output;
mod picture;
mod progress;
mod report;
mod sessions;
mod stream;
mod summary;
mod trajectory;

use anyhow::Result;
use clap::{Args, Subcommand};
use client::{HttpClient, SlamClient};

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Stream a recording into a session
    Stream(stream::StreamArgs),
    /// Fetch the trajectory of a session
    Trajectory(trajectory::TrajectoryArgs),
    /// Write the camera of a session, as it was found, as a calibration file
    Calibration(calibration::CalibrationArgs),
    /// Save the map of a session as files of other programs
    Export(export::ExportArgs),
    /// Write everything about a session on one page that needs no server
    Report(report::ReportArgs),
    /// Compare an estimated trajectory with the true one
    Evaluate(evaluate::EvaluateArgs),
    /// Stream recordings through a server of its own and measure accuracy, time and memory
    Bench(bench::BenchArgs),
    /// One run of a bench, in a process of its own so that its figures are its own
    #[command(hide = true)]
    BenchRun(bench::RunArgs),
    /// Stream a synthetic room through a server of its own
    Demo(demo::DemoArgs),
    /// List, show or delete sessions
    Sessions(sessions::SessionsArgs),
}

impl Command {
    /// Does it.
    pub async fn run(self) -> Result<()> {
        match self {
            Self::Stream(args) => stream::run(args).await,
            Self::Trajectory(args) => trajectory::run(args).await,
            Self::Calibration(args) => calibration::run(args).await,
            Self::Export(args) => export::run(args).await,
            Self::Report(args) => report::run(args).await,
            Self::Evaluate(args) => evaluate::run(&args),
            Self::Bench(args) => bench::run(args).await,
            Self::BenchRun(args) => bench::run_once(args).await,
            Self::Demo(args) => demo::run(args).await,
            Self::Sessions(args) => sessions::run(args).await,
        }
    }
}

/// Which server.
#[derive(Debug, Args)]
pub struct ServerArgs {
    /// gRPC address of the server
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:50051", env = "MONOSLAM_SERVER")]
    server: String,
    /// HTTP address of the server [default: the same host, at the port the server tells]
    #[arg(long, value_name = "URL")]
    http: Option<String>,
}

impl ServerArgs {
    async fn connect(&self) -> Result<SlamClient> {
        Ok(SlamClient::connect(&self.server).await?)
    }

    async fn http(&self) -> Result<HttpClient> {
        let address = match &self.http {
            Some(address) => address.clone(),
            None => self.connect().await?.http_address().await?,
        };
        Ok(HttpClient::new(address))
    }
}

/// A session's id: letters, digits, `-` and `_`, up to 64.
fn session_id(text: &str) -> Result<String, String> {
    let is_valid = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if (1..=64).contains(&text.len()) && text.chars().all(is_valid) {
        Ok(text.to_owned())
    } else {
        Err("a session's name is 1 to 64 letters, digits, `-` and `_`".to_owned())
    }
}

/// A positive, finite number.
fn positive(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|x: &f64| x.is_finite() && *x > 0.0)
        .ok_or_else(|| "a positive number expected".to_owned())
}
