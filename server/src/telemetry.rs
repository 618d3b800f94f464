//! Logs and metrics.

use crate::config::{Config, LogFormat};
use crate::traces::{self, Exporter};
use crate::{measures, process};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use std::io::IsTerminal;
use std::sync::OnceLock;
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::layer::{Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, fmt, reload};

/// Upper bounds of the time histograms, seconds: from a fast stage to a frame that is far too slow.
const TIME_BUCKETS_S: [f64; 12] = [0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.033, 0.05, 0.1, 0.25, 1.0, 5.0];

/// Changes what is in the log.
type Refilter = Box<dyn Fn(EnvFilter) + Send + Sync>;

/// Set once the log has been started here.
static REFILTER: OnceLock<Refilter> = OnceLock::new();

/// Writes the log to standard error: what `RUST_LOG` says, else the configuration, else `info` and above.
/// Sends traces for as long as what is returned is kept, if they are to go anywhere; then call it within a
/// runtime.
///
/// # Errors
/// If traces cannot go where they are to.
pub fn start_log(config: &Config) -> anyhow::Result<Option<Exporter>> {
    let exporter = Exporter::start(&config.traces)?;
    let is_traced = filter_fn(|metadata| metadata.is_span() && metadata.target() == traces::TARGET);
    let spans = exporter
        .as_ref()
        .map(|exporter| tracing_opentelemetry::layer().with_tracer(exporter.tracer()).with_filter(is_traced));
    let (filter, handle) = reload::Layer::new(filter_of(config));
    let lines = fmt::layer().with_writer(std::io::stderr).with_ansi(std::io::stderr().is_terminal());
    let lines = match config.log {
        LogFormat::Text => lines.boxed(),
        LogFormat::Json => lines.json().boxed(),
    };
    // A log that is already set up, as in a test, stays.
    if tracing_subscriber::registry().with(lines.with_filter(filter)).with(spans).try_init().is_ok() {
        let _ = REFILTER.set(Box::new(move |filter| drop(handle.reload(filter))));
    }
    Ok(exporter)
}

/// Has a changed configuration's filter hold for the log.
pub fn refilter_log(config: &Config) {
    if let Some(refilter) = REFILTER.get() {
        refilter(filter_of(config));
    }
}

fn filter_of(config: &Config) -> EnvFilter {
    let configured = config.log_filter.as_deref().and_then(|filter| EnvFilter::try_new(filter).ok());
    let fallback = || configured.unwrap_or_else(|| EnvFilter::new("info"));
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| fallback());
    // Spans for a collector are not what the log's lines stand in.
    match format!("{}=off", traces::TARGET).parse() {
        Ok(without_traces) => filter.add_directive(without_traces),
        Err(_) => filter,
    }
}

/// The process's metrics, as Prometheus reads them. Servers in one process share them.
pub fn metrics() -> PrometheusHandle {
    static METRICS: OnceLock<PrometheusHandle> = OnceLock::new();
    METRICS.get_or_init(install_metrics).clone()
}

fn install_metrics() -> PrometheusHandle {
    let seconds = Matcher::Suffix("_seconds".into());
    let builder = PrometheusBuilder::new();
    let builder =
        builder.set_buckets_for_metric(seconds, &TIME_BUCKETS_S).unwrap_or_else(|_| PrometheusBuilder::new());
    let recorder = builder.build_recorder();
    let handle = recorder.handle();
    if metrics::set_global_recorder(recorder).is_err() {
        tracing::warn!("another recorder of metrics is installed: /metrics will be empty");
    }
    measures::describe();
    process::started_at_s();
    handle
}
