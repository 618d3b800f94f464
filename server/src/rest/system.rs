//! Health, readiness and metrics.

use super::{App, ProblemDetails};
use crate::data::database_of;
use crate::error::{ApiError, ErrorCode};
use crate::process;
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use store::StoreError;

/// Whether the process lives.
#[utoipa::path(get, path = "/healthz", tag = "system", responses((status = 200, description = "It does", body = String)))]
pub(super) async fn healthz() -> &'static str {
    "ok\n"
}

/// Whether requests are taken: the database answers, what is saved lasts, and the server is not about to
/// stop. Further lines say whether the database is being looked at for damage, and what was found.
#[utoipa::path(get, path = "/readyz", tag = "system", responses(
    (status = 200, description = "They are", body = String),
    (status = 503, description = "They are not", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn readyz(State(app): State<App>) -> Result<String, ApiError> {
    app.service.registry().check_taking()?;
    app.service.check_storage().await.map_err(unsaved)?;
    Ok(format!("ready\n{}", app.service.soundness().summary()))
}

/// Not by way of the log: probes ask every few seconds, and the health service of gRPC logs what changes.
fn unsaved(error: StoreError) -> ApiError {
    let code =
        if let StoreError::DiskFull(_) = error { ErrorCode::StorageFull } else { ErrorCode::StorageFailed };
    ApiError::new(code, error.to_string())
}

/// Counters and times in the text format of Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "system", responses(
    (status = 200, description = "The metrics", body = String)
))]
pub(super) async fn metrics(State(app): State<App>) -> impl IntoResponse {
    let (n_loaded, n_writers) = app.service.registry().n_loaded();
    metrics::gauge!("monoslam_sessions_loaded").set(n_loaded as f64);
    metrics::gauge!("monoslam_bytes_in_flight").set(app.service.budget().n_taken_bytes() as f64);
    metrics::gauge!("monoslam_streams_open").set(n_writers as f64);
    let load = app.service.registry().own_load();
    metrics::gauge!("monoslam_streams_free").set(load.n_free as f64);
    if let Ok(servers) = app.service.fleet().await {
        metrics::gauge!("monoslam_fleet_servers").set(servers.len() as f64);
    }
    let is_ready = app.service.check_storage().await.is_ok();
    metrics::gauge!("monoslam_storage_ready").set(if is_ready { 1.0 } else { 0.0 });
    let database = database_of(&app.service.config());
    // It looks at files.
    let _ = tokio::task::spawn_blocking(move || process::measure(&database)).await;
    ([(CONTENT_TYPE, "text/plain; version=0.0.4")], app.metrics.render())
}
