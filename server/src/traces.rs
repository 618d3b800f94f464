//! Traces: what requests, frames and commits spent their time on, sent to an OpenTelemetry collector on
//! request.
//!
//! The spans are those of `tracing` whose target is [`TARGET`]. Without a collector nobody listens to them,
//! and they cost a comparison each.

use anyhow::{Context as _, ensure};
use opentelemetry::trace::TracerProvider;
use opentelemetry_otlp::{SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{Sampler, SdkTracer, SdkTracerProvider};
use serde::{Deserialize, Serialize};
use slam::FrameReport;
use tracing::{Span, field};
use tracing_opentelemetry::OpenTelemetrySpanExt;

/// Target of the spans that are sent.
pub const TARGET: &str = "monoslam::trace";

/// What the collector knows this program by, unless `OTEL_SERVICE_NAME` says otherwise.
const SERVICE_NAME: &str = "monoslam-server";

/// Where traces go.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TraceConfig {
    /// Address of a collector that takes OTLP over gRPC, such as `http://localhost:4317`. Default none:
    /// nothing is traced.
    pub endpoint: Option<String>,
    /// Share of the traces that are sent, 0 to 1; where a request brings a trace, its sender has decided.
    /// Default 0.1: thirty frames a second of one camera are three traces a second.
    pub sampled: f64,
}

impl Default for TraceConfig {
    fn default() -> Self {
        Self { endpoint: None, sampled: 0.1 }
    }
}

impl TraceConfig {
    /// Checks that every field can be used.
    ///
    /// # Errors
    /// A sentence that names the field that cannot.
    pub fn validate(&self) -> anyhow::Result<()> {
        let Self { endpoint, sampled } = self;
        ensure!((0.0..=1.0).contains(sampled), "traces.sampled is {sampled} but must be 0 to 1");
        let is_address =
            |endpoint: &String| endpoint.starts_with("http://") || endpoint.starts_with("https://");
        if let Some(endpoint) = endpoint {
            ensure!(
                is_address(endpoint) && endpoint.parse::<axum::http::Uri>().is_ok(),
                "traces.endpoint is {endpoint:?} but must be an address such as http://localhost:4317"
            );
        }
        Ok(())
    }
}

/// Sends spans until it is told to stop.
pub struct Exporter(SdkTracerProvider);

impl Exporter {
    /// Sends spans to the configured collector; `None` without one. Call within a runtime. A collector that
    /// is not there holds nothing up: its spans are lost, which the log says.
    ///
    /// # Errors
    /// If no connection can be made to such an address.
    pub fn start(config: &TraceConfig) -> anyhow::Result<Option<Self>> {
        let Some(endpoint) = &config.endpoint else { return Ok(None) };
        let exporter = SpanExporter::builder().with_tonic().with_endpoint(endpoint).build();
        let exporter = exporter.with_context(|| format!("traces cannot be sent to {endpoint}"))?;
        let resource = match std::env::var_os("OTEL_SERVICE_NAME") {
            Some(_) => Resource::builder().build(),
            None => Resource::builder().with_service_name(SERVICE_NAME).build(),
        };
        let sampler = Sampler::ParentBased(Box::new(Sampler::TraceIdRatioBased(config.sampled)));
        let provider = SdkTracerProvider::builder()
            .with_batch_exporter(exporter)
            .with_sampler(sampler)
            .with_resource(resource);
        Ok(Some(Self(provider.build())))
    }

    /// Makes spans.
    pub fn tracer(&self) -> SdkTracer {
        self.0.tracer(SERVICE_NAME)
    }
}

impl Drop for Exporter {
    /// Sends what is left, for some seconds at most.
    fn drop(&mut self) {
        if let Err(error) = self.0.shutdown() {
            tracing::warn!("the last traces were not sent: {error}");
        }
    }
}

/// A span of a frame in its session's engine, a trace of its own: a stream may last for days.
pub fn frame(session: &str, sequence: u64) -> Span {
    tracing::info_span!(
        target: TARGET, parent: None, "frame", session.id = session, frame.sequence = sequence,
        frame.state = field::Empty, frame.keyframe = field::Empty, frame.points = field::Empty,
        frame.lines = field::Empty, frame.queued_ms = field::Empty
    )
}

/// Says in a frame's span what came of it, and the milliseconds of each stage.
pub fn describe_frame(span: &Span, report: &FrameReport, state: &str, queued_ns: u64) {
    if span.is_disabled() {
        return;
    }
    let milliseconds = |nanoseconds: u64| nanoseconds as f64 * 1e-6;
    span.record("frame.state", state);
    span.record("frame.keyframe", report.is_keyframe);
    span.record("frame.points", report.n_inlier_points as i64);
    span.record("frame.lines", report.n_inlier_lines as i64);
    span.record("frame.queued_ms", milliseconds(queued_ns));
    for stage in &report.stages {
        span.set_attribute(format!("stage.{}_ms", stage.name), milliseconds(stage.wall_ns));
    }
}

/// A span of what is done with a session: saving, adjusting, joining.
macro_rules! session_span {
    ($name:literal, $session:expr) => {
        tracing::info_span!(target: $crate::traces::TARGET, $name, session.id = $session)
    };
}
pub(crate) use session_span;
