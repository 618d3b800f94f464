//! Traces reach a collector that speaks OTLP, here the protocol's own generated server.

use crate::crash;
use crate::program::ServerProcess;
use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{
    TraceService, TraceServiceServer,
};
use opentelemetry_proto::tonic::collector::trace::v1::{
    ExportTraceServiceRequest, ExportTraceServiceResponse,
};
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use opentelemetry_proto::tonic::trace::v1::Span;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use tests::{FrameStream, SmallWorld, create_session, open_message};
use tonic::transport::server::TcpIncoming;
use tonic::{Request, Response, Status};

/// A trace that a request names.
const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";

#[derive(Clone, Default)]
struct Collector(Arc<Mutex<Vec<ExportTraceServiceRequest>>>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        self.0.lock().unwrap().push(request.into_inner());
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

impl Collector {
    /// Collects on a free port.
    fn start() -> (Self, SocketAddr) {
        let collector = Self::default();
        let incoming = TcpIncoming::bind((std::net::Ipv4Addr::LOCALHOST, 0).into()).unwrap();
        let addr = incoming.local_addr().unwrap();
        let service = TraceServiceServer::new(collector.clone());
        let serving = tonic::transport::Server::builder().add_service(service).serve_with_incoming(incoming);
        tokio::spawn(async move { serving.await.unwrap() });
        (collector, addr)
    }

    fn spans(&self) -> Vec<Span> {
        let requests = self.0.lock().unwrap();
        let resources = requests.iter().flat_map(|request| &request.resource_spans);
        resources.flat_map(|resource| &resource.scope_spans).flat_map(|scope| scope.spans.clone()).collect()
    }

    fn names_of_services(&self) -> Vec<String> {
        let requests = self.0.lock().unwrap();
        let resources = requests.iter().flat_map(|request| &request.resource_spans);
        let attributes =
            resources.filter_map(|resource| resource.resource.as_ref()).flat_map(|r| &r.attributes);
        let names = attributes.filter(|attribute| attribute.key == "service.name");
        names.filter_map(|name| text_of(name.value.as_ref()?.value.as_ref()?)).collect()
    }
}

fn text_of(value: &Value) -> Option<String> {
    match value {
        Value::StringValue(text) => Some(text.clone()),
        _ => None,
    }
}

fn value<'a>(span: &'a Span, key: &str) -> Option<&'a Value> {
    span.attributes.iter().find(|attribute| attribute.key == key)?.value.as_ref()?.value.as_ref()
}

fn text(span: &Span, key: &str) -> Option<String> {
    text_of(value(span, key)?)
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_frames_and_commits_are_told_to_a_collector() {
    let (collector, addr) = Collector::start();
    let folder = tempfile::tempdir().unwrap();
    let server = ServerProcess::start_with(folder.path(), |command| {
        command.env("MONOSLAM_TRACES__ENDPOINT", format!("http://{addr}"));
        command.env("MONOSLAM_TRACES__SAMPLED", "1");
    });
    let world = SmallWorld::new(1);
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let answers = crash::stream(&mut frames, &world, 0, 5).await;
    drop(frames);
    let url = format!("http://{}/v1/sessions/nobody", server.http_addr);
    let asked =
        reqwest::Client::new().get(url).header("traceparent", format!("00-{TRACE}-00f067aa0ba902b7-01"));
    assert_eq!(asked.send().await.unwrap().status(), 404);
    assert!(server.terminate(), "the server ends well");

    let spans = collector.spans();
    let named = |name: &str| spans.iter().filter(|span| span.name == name).collect::<Vec<_>>();
    assert!(collector.names_of_services().iter().all(|name| name == "monoslam-server"));
    assert_eq!(named("monoslam.v1.SlamService/CreateSession").len(), 1, "{spans:?}");
    assert_eq!(named("monoslam.v1.SlamService/StreamFrames").len(), 1);
    let missed = named("GET /v1/sessions/{id}");
    assert_eq!(missed.len(), 1);
    assert_eq!(missed[0].trace_id.iter().map(|byte| format!("{byte:02x}")).collect::<String>(), TRACE);
    assert_eq!(value(missed[0], "http.response.status_code"), Some(&Value::IntValue(404)));

    let tracked = named("frame");
    assert!(tracked.len() >= answers.len(), "{} of {}", tracked.len(), answers.len());
    for frame in &tracked {
        assert_eq!(text(frame, "session.id").as_deref(), Some("room"));
        assert!(text(frame, "frame.state").is_some() && frame.parent_span_id.is_empty(), "{frame:?}");
        assert!(matches!(value(frame, "frame.points"), Some(Value::IntValue(0..))), "{frame:?}");
        assert!(frame.attributes.iter().any(|attribute| attribute.key.starts_with("stage.")), "{frame:?}");
        assert!(frame.end_time_unix_nano > frame.start_time_unix_nano);
    }
    assert!(!named("commit").is_empty(), "what was tracked was saved");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_collector_that_is_not_there_holds_nothing_up() {
    let folder = tempfile::tempdir().unwrap();
    // Nobody listens on port 1.
    let server = ServerProcess::start_with(folder.path(), |command| {
        command.env("MONOSLAM_TRACES__ENDPOINT", "http://127.0.0.1:1").env("MONOSLAM_TRACES__SAMPLED", "1");
    });
    let world = SmallWorld::new(1);
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    assert_eq!(crash::stream(&mut frames, &world, 0, 3).await.len(), 3);
    drop(frames);
    let begin = std::time::Instant::now();
    assert!(server.terminate());
    assert!(begin.elapsed() < std::time::Duration::from_secs(20), "{:?}", begin.elapsed());
}
