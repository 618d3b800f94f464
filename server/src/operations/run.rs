//! Running an operation whose turn has come.

use super::Tools;
use super::queue::{Kind, Outcome, Turn};
use crate::error::ApiError;
use crate::session::{LoadContext, adjust, join};
use crate::traces::session_span;
use std::collections::BTreeSet;
use std::time::Instant;
use tracing::Instrument;

/// Runs it to its end.
pub(super) async fn run(tools: Tools, turn: Turn) -> Result<Outcome, ApiError> {
    let begin = Instant::now();
    let (id, kind) = (turn.id.clone(), turn.kind);
    let span = match kind {
        Kind::Optimize => session_span!("optimize", turn.session.as_str()),
        Kind::Merge => session_span!("merge", turn.session.as_str()),
    };
    let outcome = work(&tools, turn).instrument(span).await;
    let label = match &outcome {
        Ok(Outcome::Cancelled) => "cancelled",
        Ok(_) => "done",
        Err(_) => "failed",
    };
    let name = match kind {
        Kind::Optimize => "optimize",
        Kind::Merge => "merge",
    };
    metrics::counter!("monoslam_operations_total", "kind" => name, "outcome" => label).increment(1);
    let seconds = begin.elapsed().as_secs_f64();
    tracing::info!(operation = id, kind = name, outcome = label, seconds, "operation {id} ({name}): {label}");
    outcome
}

async fn work(tools: &Tools, turn: Turn) -> Result<Outcome, ApiError> {
    let Tools { registry, store } = tools;
    let Turn { session, from, work, .. } = turn;
    if work.is_cancelled() {
        return Ok(Outcome::Cancelled);
    }
    let into = LoadContext { store, id: &session };
    let ids: BTreeSet<_> = std::iter::once(&session).chain(&from).cloned().collect();
    let events = || registry.events_of(&session);
    match &from {
        None => {
            let adjusted = registry
                .occupy(&ids, "adjusting its map", || {
                    adjust(&into, events(), (work.clone(), registry.cores()))
                })
                .await?;
            Ok(adjusted.map_or(Outcome::Cancelled, Outcome::Adjusted))
        }
        Some(from) => {
            let from = LoadContext { store, id: from };
            let joined = registry
                .occupy(&ids, "joining it with another", || {
                    join(&into, &from, events(), (work.clone(), registry.cores()))
                })
                .await?;
            Ok(joined.map_or(Outcome::Cancelled, Outcome::Joined))
        }
    }
}
