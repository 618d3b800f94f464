//! How long the two stages of local bundle adjustment take.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tracing::span::{Attributes, Id};
use tracing::{Event, Metadata, Subscriber};

/// Adds up the time spent in each of the engine's spans, and counts what it reports.
#[derive(Default)]
pub struct SpanTimes(Mutex<Spans>);

#[derive(Default)]
struct Spans {
    names: Vec<&'static str>,
    entered: Vec<Option<Instant>>,
    seconds: Vec<f64>,
    counts: Vec<usize>,
    n_reports: usize,
}

impl SpanTimes {
    fn spans(&self) -> MutexGuard<'_, Spans> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn print(&self) {
        let spans = self.spans();
        for (name, (seconds, n)) in spans.names.iter().zip(spans.seconds.iter().zip(&spans.counts)) {
            println!("{name}: {n} times, {seconds:.3} s in all, {:.2} ms each", 1e3 * seconds / *n as f64);
        }
        println!("stage two refused {} times", spans.n_reports);
    }
}

impl Subscriber for SpanTimes {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target() == "slam::bundle::local"
    }

    fn new_span(&self, attributes: &Attributes<'_>) -> Id {
        let mut spans = self.spans();
        let name = attributes.metadata().name();
        let idx = spans.names.iter().position(|known| *known == name).unwrap_or_else(|| {
            spans.names.push(name);
            spans.entered.push(None);
            spans.seconds.push(0.0);
            spans.counts.push(0);
            spans.names.len() - 1
        });
        Id::from_u64(idx as u64 + 1)
    }

    fn enter(&self, span: &Id) {
        self.spans().entered[span.into_u64() as usize - 1] = Some(Instant::now());
    }

    fn exit(&self, span: &Id) {
        let (now, idx) = (Instant::now(), span.into_u64() as usize - 1);
        let mut spans = self.spans();
        if let Some(entered) = spans.entered[idx].take() {
            spans.seconds[idx] += (now - entered).as_secs_f64();
            spans.counts[idx] += 1;
        }
    }

    fn event(&self, _: &Event<'_>) {
        self.spans().n_reports += 1;
    }

    fn record(&self, _: &Id, _: &tracing::span::Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}
}
