//! The servers of a fleet.

use super::{App, ProblemDetails};
use crate::error::ApiError;
use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

/// The servers that share a database.
#[derive(Serialize, ToSchema)]
pub(super) struct Fleet {
    /// Those that reported themselves lately, in the order of their names. Empty where the server is alone.
    servers: Vec<FleetServer>,
}

/// A server as it reported itself last, some seconds ago at most.
#[derive(Serialize, ToSchema)]
pub(super) struct FleetServer {
    /// What it is called: the machine's name and a number of its data folder.
    name: String,
    /// Where the others and clients reach its gRPC.
    grpc_url: String,
    /// The same of its HTTP.
    http_url: String,
    /// Its version.
    version: String,
    /// Sessions in its memory.
    n_loaded_sessions: u64,
    /// Streams of frames that are open.
    n_streams: u64,
    /// Streams it takes beyond these.
    n_free_streams: u64,
    /// Whether it hands its sessions over because it is about to stop.
    is_leaving: bool,
}

impl From<store::ServerRecord> for FleetServer {
    fn from(record: store::ServerRecord) -> Self {
        let store::ServerRecord { server, version, load } = record;
        Self {
            name: server.name,
            grpc_url: server.grpc_url,
            http_url: server.http_url,
            version,
            n_loaded_sessions: load.n_loaded,
            n_streams: load.n_streams,
            n_free_streams: load.n_free,
            is_leaving: load.is_leaving,
        }
    }
}

/// The servers that share this one's database, and how busy each is. For administrators.
#[utoipa::path(get, path = "/v1/fleet", tag = "system", responses(
    (status = 200, description = "The servers", body = Fleet),
    (status = 503, description = "The database cannot be used now", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn fleet(State(app): State<App>) -> Result<Json<Fleet>, ApiError> {
    let servers = app.service.fleet().await?;
    Ok(Json(Fleet { servers: servers.into_iter().map(FleetServer::from).collect() }))
}
