//! Streaming against a server that misbehaves: breaks connections, forgets frames, drops and rejects them.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

use client::{
    ClientError, FrameError, FrameSource, Pacing, Placement, Sequential, SlamClient, SourceFrame,
    StreamEvent, StreamPlan, StreamSummary, stream_frames,
};
use proto::v1::slam_service_server::{SlamService, SlamServiceServer};
use proto::v1::stream_frames_request::Message as Sent;
use proto::v1::stream_frames_response::Message as Received;
use proto::v1::{self, TrackingState};
use recordings::{FileError, FrameImage, FrameReader, TimedFrame};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_stream::wrappers::{ReceiverStream, TcpListenerStream};
use tonic::{Code, Request, Response, Status, Streaming};
use tonic_types::{ErrorDetails, StatusExt};

const N_FRAMES: usize = 40;

/// Frames a millisecond apart.
struct Frames;

impl FrameSource for Frames {
    fn n_frames(&self) -> Option<usize> {
        Some(N_FRAMES)
    }

    fn frame(&self, frame_idx: usize) -> Result<Option<SourceFrame>, FrameError> {
        Ok((frame_idx < N_FRAMES).then(|| SourceFrame {
            timestamp_ns: timestamp_ns(frame_idx),
            image: v1::Image { data: vec![frame_idx as u8].into(), ..Default::default() },
        }))
    }
}

fn timestamp_ns(frame_idx: usize) -> i64 {
    1_000_000 * (frame_idx as i64 + 1)
}

/// What the server does wrong.
#[derive(Clone, Default)]
struct Faults {
    /// Breaks the stream when it has taken this many frames, each once.
    break_after: Vec<usize>,
    /// Frames forgotten when the stream breaks, as by a crash before they were saved.
    n_forgotten: u64,
    /// Refuses every stream as if the session were broken.
    refuse: bool,
    /// Refuses every stream because the server at this address works with the session.
    owner: Option<String>,
    /// Sequence numbers that are dropped and rejected.
    dropped: Option<u64>,
    rejected: Option<u64>,
}

/// A session that tracks by counting.
#[derive(Default)]
struct State {
    faults: Faults,
    /// Sequence number, time and image of each frame that the session has.
    frames: Vec<(u64, i64, u8)>,
    n_taken: usize,
    take_overs: Vec<bool>,
}

impl State {
    fn session(&self) -> v1::Session {
        let last = self.frames.last().map(|frame| frame.0);
        v1::Session {
            id: "s".into(),
            next_sequence: last.map_or(0, |last| last + 1),
            durable_sequence: last,
            n_keyframes: 3,
            ..Default::default()
        }
    }

    fn answer(&mut self, frame: &v1::Frame) -> Received {
        let sequence = frame.sequence;
        if self.faults.dropped == Some(sequence) {
            return Received::Dropped(v1::FrameDropped { sequence, reason: "busy".into() });
        }
        if self.faults.rejected == Some(sequence) {
            let (field, reason, code) = ("image".into(), "is broken".into(), "UNDECODABLE".into());
            return Received::Rejected(v1::FrameRejected { sequence, field, reason, code });
        }
        let repeated = self.frames.last().is_some_and(|last| last.0 >= sequence);
        if !repeated {
            let image = frame.image.as_ref().map_or(0, |image| image.data[0]);
            self.frames.push((sequence, frame.timestamp_ns, image));
        }
        Received::Result(v1::FrameResult {
            sequence,
            timestamp_ns: frame.timestamp_ns,
            state: if repeated { TrackingState::Unspecified } else { TrackingState::Tracked }.into(),
            pose_world_from_camera: (!repeated).then(v1::Pose::default),
            repeated,
            ..Default::default()
        })
    }

    /// Whether the stream breaks now; frames not saved are then gone.
    fn breaks(&mut self) -> bool {
        self.n_taken += 1;
        let n_taken = self.n_taken;
        let before = self.faults.break_after.len();
        self.faults.break_after.retain(|n| *n != n_taken);
        let breaks = self.faults.break_after.len() < before;
        if breaks {
            let n_kept = self.frames.len().saturating_sub(self.faults.n_forgotten as usize);
            self.frames.truncate(n_kept);
        }
        breaks
    }
}

#[derive(Clone)]
struct Server(Arc<Mutex<State>>);

#[tonic::async_trait]
impl SlamService for Server {
    type StreamFramesStream = ReceiverStream<Result<v1::StreamFramesResponse, Status>>;

    async fn create_session(
        &self,
        _: Request<v1::CreateSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn get_session(&self, _: Request<v1::GetSessionRequest>) -> Result<Response<v1::Session>, Status> {
        Ok(Response::new(self.0.lock().unwrap().session()))
    }

    async fn list_sessions(
        &self,
        _: Request<v1::ListSessionsRequest>,
    ) -> Result<Response<v1::ListSessionsResponse>, Status> {
        let mut response = Response::new(v1::ListSessionsResponse::default());
        response.metadata_mut().insert(client::HTTP_PORT_HEADER, "4321".parse().unwrap());
        Ok(response)
    }

    async fn delete_session(
        &self,
        _: Request<v1::DeleteSessionRequest>,
    ) -> Result<Response<v1::DeleteSessionResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn update_session(
        &self,
        _: Request<v1::UpdateSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn set_scale(&self, _: Request<v1::SetScaleRequest>) -> Result<Response<v1::Session>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn localize(
        &self,
        _: Request<v1::LocalizeRequest>,
    ) -> Result<Response<v1::LocalizeResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn optimize_map(
        &self,
        _: Request<v1::OptimizeMapRequest>,
    ) -> Result<Response<v1::Operation>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn merge_sessions(
        &self,
        _: Request<v1::MergeSessionsRequest>,
    ) -> Result<Response<v1::Operation>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn get_operation(
        &self,
        _: Request<v1::GetOperationRequest>,
    ) -> Result<Response<v1::Operation>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn list_operations(
        &self,
        _: Request<v1::ListOperationsRequest>,
    ) -> Result<Response<v1::ListOperationsResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn cancel_operation(
        &self,
        _: Request<v1::CancelOperationRequest>,
    ) -> Result<Response<v1::Operation>, Status> {
        Err(Status::unimplemented("not here"))
    }

    type WatchMapStream = ReceiverStream<Result<v1::SessionEvent, Status>>;

    async fn watch_map(
        &self,
        _: Request<v1::WatchMapRequest>,
    ) -> Result<Response<Self::WatchMapStream>, Status> {
        Err(Status::unimplemented("not here"))
    }

    type ListKeyframesStream = ReceiverStream<Result<v1::ListKeyframesResponse, Status>>;

    async fn list_keyframes(
        &self,
        _: Request<v1::ListKeyframesRequest>,
    ) -> Result<Response<Self::ListKeyframesStream>, Status> {
        Err(Status::unimplemented("not here"))
    }

    type QueryPointsStream = ReceiverStream<Result<v1::QueryPointsResponse, Status>>;

    async fn query_points(
        &self,
        _: Request<v1::QueryPointsRequest>,
    ) -> Result<Response<Self::QueryPointsStream>, Status> {
        Err(Status::unimplemented("not here"))
    }

    type QueryLinesStream = ReceiverStream<Result<v1::QueryLinesResponse, Status>>;

    async fn query_lines(
        &self,
        _: Request<v1::QueryLinesRequest>,
    ) -> Result<Response<Self::QueryLinesStream>, Status> {
        Err(Status::unimplemented("not here"))
    }

    type ListPrimitivesStream = ReceiverStream<Result<v1::ListPrimitivesResponse, Status>>;

    async fn list_primitives(
        &self,
        _: Request<v1::ListPrimitivesRequest>,
    ) -> Result<Response<Self::ListPrimitivesStream>, Status> {
        Err(Status::unimplemented("not here"))
    }

    type GetTrajectoryStream = ReceiverStream<Result<v1::GetTrajectoryResponse, Status>>;

    async fn get_trajectory(
        &self,
        _: Request<v1::GetTrajectoryRequest>,
    ) -> Result<Response<Self::GetTrajectoryStream>, Status> {
        Err(Status::unimplemented("not here"))
    }

    type ExportMapStream = ReceiverStream<Result<v1::ExportMapResponse, Status>>;

    async fn export_map(
        &self,
        _: Request<v1::ExportMapRequest>,
    ) -> Result<Response<Self::ExportMapStream>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn stream_frames(
        &self,
        request: Request<Streaming<v1::StreamFramesRequest>>,
    ) -> Result<Response<Self::StreamFramesStream>, Status> {
        let mut requests = request.into_inner();
        let state = self.0.clone();
        if state.lock().unwrap().faults.refuse {
            return Err(Status::failed_precondition("another client streams into the session"));
        }
        let owner = state.lock().unwrap().faults.owner.clone();
        if let Some(owner) = owner {
            let told = HashMap::from([("grpc_url".to_owned(), owner)]);
            let details = ErrorDetails::with_error_info("OWNED_ELSEWHERE", "monoslam", told);
            return Err(Status::with_error_details(Code::Unavailable, "ask the other", details));
        }
        let (answers, receiver) = mpsc::channel(4);
        tokio::spawn(async move {
            while let Ok(Some(request)) = requests.message().await {
                let (message, breaks) = {
                    let mut state = state.lock().unwrap();
                    match request.message.unwrap() {
                        Sent::Open(open) => {
                            state.take_overs.push(open.take_over);
                            (Received::Opened(v1::StreamOpened { session: Some(state.session()) }), false)
                        }
                        Sent::Frame(frame) => (state.answer(&frame), state.breaks()),
                    }
                };
                if breaks {
                    let _ = answers.send(Err(Status::unavailable("the connection broke"))).await;
                    return;
                }
                if answers.send(Ok(v1::StreamFramesResponse { message: Some(message) })).await.is_err() {
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

async fn serve(faults: Faults) -> (SocketAddr, Server) {
    let server = Server(Arc::new(Mutex::new(State { faults, ..Default::default() })));
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let service = SlamServiceServer::new(server.clone());
    let serving = tonic::transport::Server::builder()
        .add_service(service)
        .serve_with_incoming(TcpListenerStream::new(listener));
    tokio::spawn(serving);
    (address, server)
}

fn plan(placement: Placement) -> StreamPlan {
    StreamPlan {
        session_id: "s".into(),
        policy: v1::StreamPolicy::Lossless,
        pacing: Pacing::Unpaced,
        range: 0..N_FRAMES,
        placement,
        take_over: false,
        new_segment: false,
        localize_only: false,
    }
}

async fn streamed(faults: Faults, placement: Placement) -> (Result<StreamSummary, ClientError>, Server) {
    let (address, server) = serve(faults).await;
    let mut client = SlamClient::connect(&format!("http://{address}")).await.unwrap();
    let source: Arc<dyn FrameSource> = Arc::new(Frames);
    let outcome = stream_frames(&mut client, &source, &plan(placement), |_| {}).await;
    (outcome, server)
}

/// What the session must hold at the end, whatever happened in between.
fn assert_every_frame_is_there_once(server: &Server, placement: Placement) {
    let frames = server.0.lock().unwrap().frames.clone();
    let expected: Vec<(u64, i64, u8)> = (0..N_FRAMES)
        .map(|i| (placement.sequence(i), timestamp_ns(i) + placement.shift_ns, i as u8))
        .collect();
    assert_eq!(frames, expected);
}

#[tokio::test]
async fn a_stream_without_faults_is_answered_frame_by_frame() {
    let placement = Placement { first_idx: 0, first_sequence: 7, shift_ns: 5_000_000_000 };
    let (outcome, server) = streamed(Faults::default(), placement).await;
    let summary = outcome.unwrap();
    assert_eq!((summary.frames, summary.tracked, summary.reconnects), (N_FRAMES, N_FRAMES, 0));
    assert_eq!((summary.session.as_str(), summary.keyframes, summary.coverage), ("s", 3, 1.0));
    assert_every_frame_is_there_once(&server, placement);
}

#[tokio::test]
async fn a_broken_stream_goes_on_where_the_server_says() {
    let faults = Faults { break_after: vec![5, 20], ..Default::default() };
    let (outcome, server) = streamed(faults, Placement::AS_RECORDED).await;
    let summary = outcome.unwrap();
    assert_eq!(summary.reconnects, 2);
    // The answers to the frames at which the stream broke were lost; the frames are sent again and known.
    assert_eq!((summary.tracked, summary.repeated), (N_FRAMES - 2, 2));
    assert_every_frame_is_there_once(&server, Placement::AS_RECORDED);
    assert_eq!(server.0.lock().unwrap().take_overs, [false, true, true]);
}

#[tokio::test]
async fn a_stream_goes_to_the_server_that_works_with_the_session() {
    let (there, owner) = serve(Faults { break_after: vec![9], ..Default::default() }).await;
    let (here, named) = serve(Faults { owner: Some(format!("http://{there}")), ..Default::default() }).await;
    let mut client = SlamClient::connect(&format!("http://{here}")).await.unwrap();
    let source: Arc<dyn FrameSource> = Arc::new(Frames);
    let plan = plan(Placement::AS_RECORDED);
    let summary = stream_frames(&mut client, &source, &plan, |_| {}).await.unwrap();
    assert_eq!(summary.tracked + summary.repeated, N_FRAMES);
    assert_every_frame_is_there_once(&owner, Placement::AS_RECORDED);
    assert_eq!(client.server(), format!("http://{here}"), "the caller's connection is the one it made");
    assert!(named.0.lock().unwrap().frames.is_empty());

    // An owner that is gone is not asked for ever: the server that named it may have the session by now.
    let (here, named) =
        serve(Faults { owner: Some("http://127.0.0.1:1".into()), ..Default::default() }).await;
    let mut client = SlamClient::connect(&format!("http://{here}")).await.unwrap();
    let mut n_tries = 0;
    let later = |event: StreamEvent<'_>| {
        if let StreamEvent::Reconnecting { .. } = event {
            n_tries += 1;
            if n_tries == 2 {
                named.0.lock().unwrap().faults.owner = None;
            }
        }
    };
    let summary = stream_frames(&mut client, &source, &plan, later).await.unwrap();
    assert_eq!((summary.tracked, summary.reconnects), (N_FRAMES, 2));
    assert_every_frame_is_there_once(&named, Placement::AS_RECORDED);

    // Who is spoken to encrypted names nobody who is not.
    let refused = client.connect_to_owner("ftp://127.0.0.1:1").await.err().unwrap();
    assert!(matches!(refused, ClientError::Address { .. }), "{refused}");
}

#[tokio::test]
async fn frames_that_a_crash_lost_are_sent_again() {
    let faults = Faults { break_after: vec![17], n_forgotten: 6, ..Default::default() };
    let (outcome, server) = streamed(faults, Placement::AS_RECORDED).await;
    let summary = outcome.unwrap();
    assert_eq!((summary.tracked, summary.repeated, summary.reconnects), (N_FRAMES, 0, 1));
    assert_every_frame_is_there_once(&server, Placement::AS_RECORDED);
}

/// Frames as a camera gives them: one after the other, and nobody knows how many.
struct Camera(usize);

impl FrameReader for Camera {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, FileError> {
        let frame_idx = self.0;
        self.0 += 1;
        let image = FrameImage::Encoded(vec![frame_idx as u8]);
        Ok((frame_idx < N_FRAMES).then(|| TimedFrame { timestamp_ns: timestamp_ns(frame_idx), image }))
    }
}

#[tokio::test]
async fn a_camera_goes_on_after_a_break_and_ends_when_it_does() {
    let faults = Faults { break_after: vec![5, 20], n_forgotten: 3, ..Default::default() };
    let (address, server) = serve(faults).await;
    let mut client = SlamClient::connect(&format!("http://{address}")).await.unwrap();
    let source: Arc<dyn FrameSource> = Arc::new(Sequential::live(Box::new(Camera(0))));
    let plan = StreamPlan::lossless("s", source.as_ref());
    assert_eq!(plan.range, 0..usize::MAX);
    let summary = stream_frames(&mut client, &source, &plan, |_| {}).await.unwrap();
    assert_eq!((summary.frames, summary.tracked, summary.reconnects), (N_FRAMES, N_FRAMES, 2));
    assert!((summary.recorded_s - 1e-3 * N_FRAMES as f64).abs() < 1e-9, "{}", summary.recorded_s);
    assert_every_frame_is_there_once(&server, Placement::AS_RECORDED);
}

#[tokio::test]
async fn a_refusal_is_not_tried_again() {
    let (outcome, _) = streamed(Faults { refuse: true, ..Default::default() }, Placement::AS_RECORDED).await;
    assert_eq!(outcome.unwrap_err().to_string(), "another client streams into the session");
}

#[tokio::test]
async fn dropped_and_rejected_frames_are_counted_and_do_not_end_the_stream() {
    let (address, _) =
        serve(Faults { dropped: Some(3), rejected: Some(N_FRAMES as u64 - 1), ..Default::default() }).await;
    let mut client = SlamClient::connect(&format!("http://{address}")).await.unwrap();
    let source: Arc<dyn FrameSource> = Arc::new(Frames);
    let mut n_answers = 0;
    let count =
        |event: StreamEvent<'_>| n_answers += usize::from(matches!(event, StreamEvent::Answered { .. }));
    let summary = stream_frames(&mut client, &source, &plan(Placement::AS_RECORDED), count).await.unwrap();
    assert_eq!((summary.dropped, summary.rejected, summary.tracked), (1, 1, N_FRAMES - 2));
    assert_eq!(n_answers, N_FRAMES);
}

#[tokio::test]
async fn the_http_port_is_learnt_by_grpc() {
    let (address, _) = serve(Faults::default()).await;
    let mut client = SlamClient::connect(&format!("http://{address}")).await.unwrap();
    assert_eq!(client.http_address().await.unwrap(), "http://127.0.0.1:4321");
}

#[tokio::test]
async fn nobody_there_is_an_error_that_says_so() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    drop(listener);
    let error = SlamClient::connect(&format!("http://{address}")).await.unwrap_err();
    assert!(error.is_passing());
    assert!(
        error.to_string().starts_with(&format!("the server at http://{address} cannot be reached")),
        "{error}"
    );
}

#[tokio::test]
async fn frames_are_paced() {
    let (address, _) = serve(Faults::default()).await;
    let mut client = SlamClient::connect(&format!("http://{address}")).await.unwrap();
    let source: Arc<dyn FrameSource> = Arc::new(Frames);
    let plan =
        StreamPlan { pacing: Pacing::FramesPerSecond(100.0), range: 0..20, ..plan(Placement::AS_RECORDED) };
    let summary = stream_frames(&mut client, &source, &plan, |_| {}).await.unwrap();
    // Nineteen intervals of 10 ms; how much longer it takes depends on the machine.
    assert!(summary.elapsed_s >= 0.19, "{}", summary.elapsed_s);
}
