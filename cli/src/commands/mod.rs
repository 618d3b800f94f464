//! One module for each command.

mod bench;
mod calibrate;
mod calibration;
mod demo;
mod evaluate;
mod export;
mod flags;
mod local;
mod localize;
mod operations;
mod output;
mod picture;
mod progress;
mod report;
mod scale;
mod sessions;
mod stream;
mod summary;
mod trajectory;

pub use flags::in_flags;

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use client::{Credentials, HttpClient, SlamClient};

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Stream a recording into a session
    Stream(stream::StreamArgs),
    /// Fetch the trajectory of a session
    Trajectory(trajectory::TrajectoryArgs),
    /// Write the camera of a session, as it was found, as a calibration file
    Calibration(calibration::CalibrationArgs),
    /// Find the calibration of a camera from pictures of a chessboard
    Calibrate(calibrate::CalibrateArgs),
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
    /// Say how many metres a map unit of a session is, or measure it
    Scale(scale::ScaleArgs),
    /// Tell where images were taken, by the maps of sessions
    Localize(localize::LocalizeArgs),
    /// Adjust the whole map of a session (global bundle adjustment)
    Optimize(operations::OptimizeArgs),
    /// Join two sessions of one camera where their maps show the same place
    Merge(operations::MergeArgs),
    /// List, show, wait for or cancel what takes long on the server
    Operations(operations::OperationsArgs),
}

impl Command {
    /// Does it.
    pub async fn run(self) -> Result<()> {
        match self {
            Self::Stream(args) => stream::run(args).await,
            Self::Trajectory(args) => trajectory::run(args).await,
            Self::Calibration(args) => calibration::run(args).await,
            Self::Calibrate(args) => calibrate::run(&args),
            Self::Export(args) => export::run(args).await,
            Self::Report(args) => report::run(args).await,
            Self::Evaluate(args) => evaluate::run(&args),
            Self::Bench(args) => bench::run(args).await,
            Self::BenchRun(args) => bench::run_once(args).await,
            Self::Demo(args) => demo::run(args).await,
            Self::Sessions(args) => sessions::run(args).await,
            Self::Scale(args) => scale::run(args).await,
            Self::Localize(args) => localize::run(args).await,
            Self::Optimize(args) => operations::optimize(args).await,
            Self::Merge(args) => operations::merge(args).await,
            Self::Operations(args) => operations::run(args).await,
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
    /// Token for the server, as `monoslam-server token create` printed it
    #[arg(long, value_name = "TOKEN", env = "MONOSLAM_TOKEN", hide_env_values = true)]
    token: Option<String>,
    /// Certificates, PEM, that the server's must be or be vouched for by [default: the system's]
    #[arg(long, value_name = "FILE", env = "MONOSLAM_CA")]
    ca: Option<PathBuf>,
}

impl ServerArgs {
    async fn connect(&self) -> Result<SlamClient> {
        Ok(SlamClient::connect_with(&self.server, self.credentials()?).await?)
    }

    async fn http(&self) -> Result<HttpClient> {
        let credentials = self.credentials()?;
        Ok(match &self.http {
            Some(address) => HttpClient::with(address.clone(), &credentials)?,
            None => HttpClient::told(self.connect().await?.http_address().await?, &credentials)?,
        })
    }

    fn credentials(&self) -> Result<Credentials> {
        let read = |file: &PathBuf| {
            std::fs::read(file).with_context(|| format!("cannot read the certificates in {}", file.display()))
        };
        let token = self.token.clone().filter(|token| !token.is_empty());
        Ok(Credentials { token, ca_pem: self.ca.as_ref().map(read).transpose()? })
    }
}

/// A session's id: letters, digits, `-` and `_`, up to 64; for administrators after its owner and `~`.
fn session_id(text: &str) -> Result<String, String> {
    let is_valid = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    let is_name = |name: &str| (1..=64).contains(&name.len()) && name.chars().all(is_valid);
    if text.split_once('~').map_or(is_name(text), |(owner, name)| is_name(owner) && is_name(name)) {
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
