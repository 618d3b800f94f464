//! A server inside this process, for commands that bring their own.

use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use client::evaluation::{Evaluation, EvaluationOptions, evaluate};
use client::{FrameSource, HttpClient, Pacing, Placement, SlamClient, StreamPlan, StreamSummary, Trajectory};
use proto::v1;
use server::{Config, Running, Server};
use tempfile::TempDir;

use super::stream::stream_with_progress;

/// The one session of a server inside.
const SESSION: &str = "local";

/// A server at free ports of this machine, its database in a temporary folder that goes when it does.
pub struct LocalServer {
    running: Running,
    _folder: TempDir,
}

impl LocalServer {
    /// Starts one.
    pub async fn start() -> Result<Self> {
        let folder = tempfile::Builder::new()
            .prefix("monoslam-")
            .tempdir()
            .context("cannot make a temporary folder")?;
        let running = Server::start(Config::local(folder.path())).await.context("cannot start a server")?;
        Ok(Self { running, _folder: folder })
    }

    /// Where its gRPC interface is.
    pub fn grpc(&self) -> String {
        format!("http://{}", self.running.grpc_addr)
    }

    /// Where its HTTP interface is.
    pub fn http(&self) -> String {
        format!("http://{}", self.running.http_addr)
    }

    /// Stops it in order.
    pub async fn stop(self) -> Result<()> {
        let ending = self.running.shutdown().await;
        ensure!(ending == server::Shutdown::Complete, "the server did not stop in time");
        Ok(())
    }
}

/// How frames go into a server inside.
pub struct LocalRun<'a> {
    /// The camera that took them.
    pub camera: v1::Camera,
    /// What the session runs with.
    pub options: v1::SessionOptions,
    /// The frames.
    pub source: Arc<dyn FrameSource>,
    /// Their truth, if it is known.
    pub truth: Option<&'a Trajectory>,
    /// Whether they come as recorded and the server drops those it has no time for, or as fast as it takes them.
    pub is_realtime: bool,
}

/// What came of them.
pub struct LocalOutcome {
    /// What became of the frames.
    pub summary: StreamSummary,
    /// The share of the frames that have a pose in the trajectory.
    pub coverage: f64,
    /// How far the trajectory is from the truth; absent without a truth or with too few poses.
    pub evaluation: Option<Evaluation>,
}

impl LocalServer {
    /// Streams all frames by gRPC, fetches the trajectory by HTTP, and compares it with the truth.
    pub async fn run(&self, run: LocalRun<'_>) -> Result<LocalOutcome> {
        let mut client = SlamClient::connect(&self.grpc()).await?;
        let LocalRun { camera, options, source, truth, is_realtime } = run;
        let request = v1::CreateSessionRequest {
            session_id: SESSION.to_owned(),
            camera: Some(camera),
            options: Some(options),
        };
        let session = client.create_session(request).await?;
        let plan = StreamPlan {
            session_id: session.id,
            policy: if is_realtime { v1::StreamPolicy::Realtime } else { v1::StreamPolicy::Lossless },
            pacing: if is_realtime { Pacing::Recorded } else { Pacing::Unpaced },
            range: 0..source.len(),
            placement: Placement::AS_RECORDED,
            take_over: false,
        };
        let summary = stream_with_progress(&mut client, &source, &plan).await?;
        let estimate = HttpClient::new(self.http()).trajectory(&plan.session_id).await?;
        let options = EvaluationOptions { n_frames: Some(source.len()), ..EvaluationOptions::default() };
        let evaluation = match truth.map(|truth| evaluate(truth, &estimate, &options)) {
            Some(Ok(evaluation)) => Some(evaluation),
            Some(Err(error)) => {
                eprintln!("the trajectory cannot be evaluated: {error}");
                None
            }
            None => None,
        };
        Ok(LocalOutcome { summary, coverage: estimate.len() as f64 / source.len().max(1) as f64, evaluation })
    }
}
