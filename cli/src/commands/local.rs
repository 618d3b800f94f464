//! A server inside this process, for commands that bring their own.

use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use client::{FrameSource, HttpClient, SlamClient, StreamPlan, StreamSummary};
use geometry::CameraParameters;
use geometry::nalgebra::Vector3;
use proto::v1;
use recordings::{Evaluation, EvaluationOptions, Trajectory, evaluate};
use server::{Config, Running, Server};
use tempfile::TempDir;

use super::picture::{MapLine, Scene};
use super::report::{Known, Report};
use super::stream::stream_with_progress;

/// The one session of a server inside.
const SESSION: &str = "local";

/// Keyframes whose pictures are in a report.
const N_PICTURES: usize = 12;

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
#[derive(Clone)]
pub struct LocalRun<'a> {
    /// The camera that took them.
    pub camera: CameraParameters,
    /// The session's options.
    pub options: v1::SessionOptions,
    /// The frames.
    pub source: Arc<dyn FrameSource>,
    /// Their truth, if it is known.
    pub truth: Option<&'a Trajectory>,
    /// Whether they come as recorded and the server drops those it has no time for, or as fast as it takes
    /// them.
    pub is_realtime: bool,
}

/// What came of them.
pub struct LocalOutcome {
    /// What became of the frames.
    pub summary: StreamSummary,
    /// The estimated trajectory.
    pub trajectory: Trajectory,
    /// The share of the frames that have a pose in the trajectory.
    pub coverage: f64,
    /// How far the trajectory is from the truth; absent without a truth or with too few poses.
    pub evaluation: Option<Evaluation>,
}

impl LocalServer {
    /// Streams all frames by gRPC, fetches the trajectory by HTTP, and compares it with the truth.
    pub async fn run(&self, run: LocalRun<'_>) -> Result<LocalOutcome> {
        self.run_as(SESSION, run).await
    }

    /// [`LocalServer::run`] with as many sessions at once, each by a client of its own.
    pub async fn run_streams(&self, run: &LocalRun<'_>, n_streams: usize) -> Result<Vec<LocalOutcome>> {
        let name = |stream| if stream == 0 { SESSION.to_owned() } else { format!("{SESSION}-{stream}") };
        let streams = (0..n_streams).map(|stream| {
            let run = run.clone();
            async move { self.run_as(&name(stream), run).await }
        });
        futures_util::future::try_join_all(streams).await
    }

    async fn run_as(&self, session: &str, run: LocalRun<'_>) -> Result<LocalOutcome> {
        let mut client = SlamClient::connect(&self.grpc()).await?;
        let LocalRun { camera, options, source, truth, is_realtime } = run;
        let session = client.create_session(session, &camera, options).await?;
        let plan = if is_realtime { StreamPlan::realtime } else { StreamPlan::lossless };
        let plan = plan(session.id, source.as_ref());
        let summary = stream_with_progress(&mut client, &source, &plan).await?;
        let estimate = HttpClient::new(self.http())?.trajectory(&plan.session_id).await?;
        let options = EvaluationOptions { n_frames: Some(summary.frames), ..EvaluationOptions::default() };
        let evaluation = match truth.map(|truth| evaluate(truth, &estimate, &options)) {
            Some(Ok(evaluation)) => Some(evaluation),
            Some(Err(error)) => {
                eprintln!("the trajectory cannot be evaluated: {error}");
                None
            }
            None => None,
        };
        let coverage = estimate.len() as f64 / summary.frames.max(1) as f64;
        Ok(LocalOutcome { summary, trajectory: estimate, coverage, evaluation })
    }

    /// Everything about the session on one page.
    pub async fn report(&self, known: Known) -> Result<Report> {
        Report::of(&HttpClient::new(self.http())?, SESSION, known, N_PICTURES).await
    }

    /// The map with the trajectories, to be drawn.
    pub async fn scene(&self, title: String, truth: Trajectory, estimate: Trajectory) -> Result<Scene> {
        let mut client = SlamClient::connect(&self.grpc()).await?;
        let vector = |v: v1::Vector3| Vector3::new(v.x, v.y, v.z);
        let points = client.points(SESSION).await?;
        let points = points.into_iter().filter_map(|point| point.position.map(vector)).collect();
        let line = |line: v1::Line| {
            let ends = [vector(line.start?), vector(line.end?)];
            Some(MapLine { ends, primitive: line.primitive_id })
        };
        let lines = client.lines(SESSION).await?.into_iter().filter_map(line).collect();
        Ok(Scene { title, truth: Some(truth), estimate, points, lines })
    }
}
