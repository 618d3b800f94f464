//! The gRPC skin: decode, call the service, encode.

mod convert;
mod deadline;
#[cfg(fuzzing)]
pub mod fuzzing;
mod maps;
mod questions;
mod stream;

use crate::access::{self, Caller, Door};
use crate::budget::Charges;
use crate::connections::{self, Interface, Opening, Port};
use crate::error::ApiError;
use crate::options::SessionOptions;
use crate::outage::Outage;
use crate::page::PageRequest;
use crate::relay::{self, Relay, RelayLayer};
use crate::service::Service;
use crate::session::SessionId;
use crate::watch::watch;
use axum::Router;
use axum::middleware::from_fn_with_state;
use proto::v1;
use proto::v1::slam_service_server::{SlamService, SlamServiceServer};
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use tokio_util::sync::CancellationToken;
use tonic::codec::CompressionEncoding;
use tonic::codegen::http::{HeaderName, HeaderValue};
use tonic::service::Routes;
use tonic::{Request, Response, Status};
use tonic_health::server::HealthReporter;
use tower_http::set_header::SetResponseHeaderLayer;

/// Every answer says on which port the same host serves HTTP, so that a client needs to know one address
/// only.
const HTTP_PORT_HEADER: HeaderName = HeaderName::from_static("x-monoslam-http-port");

/// How often the health service learns whether what clients bring is saved.
const HEALTH_EVERY: Duration = Duration::from_secs(1);

/// The call whose client may pause in the middle of what it sends, and which the sessions end in a shutdown.
const PATIENT: &[&str] = &["/monoslam.v1.SlamService/StreamFrames"];

/// Serves gRPC until `closing`, then lets what is under way end.
pub(crate) async fn serve(
    service: Arc<Service>,
    relay: Relay,
    opening: Opening,
    http_port: u16,
    closing: CancellationToken,
) -> anyhow::Result<()> {
    let (reporter, health) = tonic_health::server::health_reporter();
    reporter.set_serving::<SlamServiceServer<Handler>>().await;
    tokio::spawn(report_health(service.clone(), reporter, closing.clone()));
    let door = Door { access: service.access().clone(), interface: Interface::Grpc };
    let leaving = service.registry().leaving();
    let router = routes(service)?
        .add_service(health)
        .into_axum_router()
        .layer(from_fn_with_state(RelayLayer { relay, interface: Interface::Grpc }, relay::pass))
        .layer(axum::middleware::from_fn(deadline::keep))
        .layer(from_fn_with_state(door, access::check))
        .layer(from_fn_with_state(Interface::Grpc, connections::trace))
        .layer(SetResponseHeaderLayer::overriding(HTTP_PORT_HEADER, HeaderValue::from(http_port)));
    let Opening { listener, tls, table, meter } = opening;
    let interface = Interface::Grpc;
    let port = Port { listener, interface, tls, table, meter, patient_paths: PATIENT, leaving };
    connections::serve(port, router, closing).await;
    Ok(())
}

/// Says by the health service whether calls are taken and what they bring is saved, until `closing`.
async fn report_health(service: Arc<Service>, reporter: HealthReporter, closing: CancellationToken) {
    let mut log = Outage::new("nothing can be saved");
    while tokio::time::timeout(HEALTH_EVERY, closing.cancelled()).await.is_err() {
        let storage = service.check_storage().await;
        log.note(&storage);
        match storage {
            Ok(()) if !service.registry().is_leaving() => {
                reporter.set_serving::<SlamServiceServer<Handler>>().await
            }
            _ => reporter.set_not_serving::<SlamServiceServer<Handler>>().await,
        }
    }
    reporter.set_not_serving::<SlamServiceServer<Handler>>().await;
}

/// The service with reflection, without a socket and without a door.
fn routes(service: Arc<Service>) -> anyhow::Result<Routes> {
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(proto::FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let slam = slam_service(service)
        .send_compressed(CompressionEncoding::Gzip)
        .send_compressed(CompressionEncoding::Zstd);
    // Many programs still ask by the older name.
    let older = reflection().build_v1alpha()?;
    Ok(Routes::new(slam).add_service(reflection().build_v1()?).add_service(older))
}

fn slam_service(service: Arc<Service>) -> SlamServiceServer<Handler> {
    let max_bytes = service.config().limits.max_message_bytes;
    // The limit is of what a message unpacks to as well.
    SlamServiceServer::new(Handler { service })
        .max_decoding_message_size(max_bytes)
        .accept_compressed(CompressionEncoding::Gzip)
        .accept_compressed(CompressionEncoding::Zstd)
}

/// The calls as pages in a browser make them, by gRPC-Web, for the port that pages come from: the door of
/// that port stands before it. Streams of the server work, those of the client do not, as browsers cannot
/// send them.
pub(crate) fn for_pages(service: Arc<Service>, relay: Relay) -> Router {
    Routes::new(slam_service(service))
        .into_axum_router()
        // Within the translation: another server is asked by gRPC itself.
        .layer(from_fn_with_state(RelayLayer { relay, interface: Interface::Grpc }, relay::pass))
        .layer(tonic_web::GrpcWebLayer::new())
        .layer(axum::middleware::from_fn(deadline::keep))
        .layer(axum::middleware::from_fn(only_from_pages))
}

/// Turns away what speaks gRPC itself: its messages are counted and timed on the gRPC port alone.
async fn only_from_pages(
    request: axum::extract::Request,
    next: axum::middleware::Next,
) -> axum::response::Response {
    let kind = request.headers().get(axum::http::header::CONTENT_TYPE).map(|kind| kind.as_bytes());
    let speaks_grpc = kind.is_some_and(|kind| {
        kind.starts_with(b"application/grpc") && !kind.starts_with(b"application/grpc-web")
    });
    if speaks_grpc {
        let message = "this is the HTTP port, which takes gRPC-Web alone: call the gRPC port";
        return Status::unimplemented(message).into_http();
    }
    next.run(request).await
}

/// The server's side of a watch.
type SessionEvents = Pin<Box<dyn Stream<Item = Result<v1::SessionEvent, Status>> + Send>>;

/// Answers the calls.
pub(crate) struct Handler {
    service: Arc<Service>,
}

#[tonic::async_trait]
impl SlamService for Handler {
    async fn create_session(
        &self,
        request: Request<v1::CreateSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        let caller = caller_of(&request)?;
        let new = convert::new_session(&caller, request.into_inner())?;
        Ok(Response::new(convert::session(&self.service.create_session(&caller, new).await?)))
    }

    async fn get_session(
        &self,
        request: Request<v1::GetSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        let caller = caller_of(&request)?;
        let id = session_id(&caller, &request.get_ref().session_id)?;
        Ok(Response::new(convert::session(&self.service.get_session(&id).await?)))
    }

    async fn list_sessions(
        &self,
        request: Request<v1::ListSessionsRequest>,
    ) -> Result<Response<v1::ListSessionsResponse>, Status> {
        let caller = caller_of(&request)?;
        let v1::ListSessionsRequest { page_size, page_token } = request.into_inner();
        let page = self.service.list_sessions(&caller, &PageRequest::new(page_size, page_token)?).await?;
        Ok(Response::new(v1::ListSessionsResponse {
            sessions: page.items.iter().map(convert::session).collect(),
            next_page_token: page.next_page_token.unwrap_or_default(),
        }))
    }

    async fn delete_session(
        &self,
        request: Request<v1::DeleteSessionRequest>,
    ) -> Result<Response<v1::DeleteSessionResponse>, Status> {
        let caller = caller_of(&request)?;
        let id = session_id(&caller, &request.get_ref().session_id)?;
        self.service.delete_session(&caller, &id).await?;
        Ok(Response::new(v1::DeleteSessionResponse {}))
    }

    async fn update_session(
        &self,
        request: Request<v1::UpdateSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        let caller = caller_of(&request)?;
        let v1::UpdateSessionRequest { session_id: id, options } = request.into_inner();
        let options = options.map(SessionOptions::from).unwrap_or_default();
        let view = self.service.update_session(&caller, &session_id(&caller, &id)?, options).await?;
        Ok(Response::new(convert::session(&view)))
    }

    async fn set_scale(
        &self,
        request: Request<v1::SetScaleRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        let caller = caller_of(&request)?;
        let request = request.into_inner();
        let id = session_id(&caller, &request.session_id)?;
        let (view, measured) =
            self.service.set_scale(&caller, &id, questions::scale_source(request)?).await?;
        let scale_measurement = measured.map(questions::measurement);
        Ok(Response::new(v1::Session { scale_measurement, ..convert::session(&view) }))
    }

    async fn localize(
        &self,
        request: Request<v1::LocalizeRequest>,
    ) -> Result<Response<v1::LocalizeResponse>, Status> {
        let caller = caller_of(&request)?;
        let request = request.into_inner();
        let sessions = if request.all_sessions {
            self.service.sessions_to_search(&caller).await?
        } else {
            questions::sessions(&caller, &request)?
        };
        let located = self.service.localize(questions::localize(sessions, request)?).await?;
        Ok(Response::new(questions::located(&located)))
    }

    async fn optimize_map(
        &self,
        request: Request<v1::OptimizeMapRequest>,
    ) -> Result<Response<v1::Operation>, Status> {
        let caller = caller_of(&request)?;
        let id = session_id(&caller, &request.get_ref().session_id)?;
        Ok(Response::new(questions::operation(&self.service.optimize(&caller, &id).await?)))
    }

    async fn merge_sessions(
        &self,
        request: Request<v1::MergeSessionsRequest>,
    ) -> Result<Response<v1::Operation>, Status> {
        let caller = caller_of(&request)?;
        let v1::MergeSessionsRequest { into, from } = request.into_inner();
        let into = caller.session(&into, "into")?;
        // Whether there is one is told before anything is said of the other.
        self.service.get_session(&into).await?;
        let from = caller.session(&from, "from")?;
        Ok(Response::new(questions::operation(&self.service.merge(&caller, &into, &from).await?)))
    }

    async fn get_operation(
        &self,
        request: Request<v1::GetOperationRequest>,
    ) -> Result<Response<v1::Operation>, Status> {
        let caller = caller_of(&request)?;
        let id = &request.get_ref().operation_id;
        Ok(Response::new(questions::operation(&self.service.operations().get(&caller, id)?)))
    }

    async fn list_operations(
        &self,
        request: Request<v1::ListOperationsRequest>,
    ) -> Result<Response<v1::ListOperationsResponse>, Status> {
        let caller = caller_of(&request)?;
        let session = Some(&request.get_ref().session_id).filter(|id| !id.is_empty());
        let session = session.map(|id| session_id(&caller, id)).transpose()?;
        if let Some(id) = &session {
            self.service.get_session(id).await?;
        }
        let operations = self.service.operations().list(&caller, session.as_ref());
        let operations = operations.iter().map(questions::operation).collect();
        Ok(Response::new(v1::ListOperationsResponse { operations }))
    }

    async fn cancel_operation(
        &self,
        request: Request<v1::CancelOperationRequest>,
    ) -> Result<Response<v1::Operation>, Status> {
        let caller = caller_of(&request)?;
        let id = &request.get_ref().operation_id;
        Ok(Response::new(questions::operation(&self.service.operations().cancel(&caller, id)?)))
    }

    type WatchMapStream = SessionEvents;

    async fn watch_map(
        &self,
        request: Request<v1::WatchMapRequest>,
    ) -> Result<Response<Self::WatchMapStream>, Status> {
        let caller = caller_of(&request)?;
        let id = session_id(&caller, &request.get_ref().session_id)?;
        let events = ReceiverStream::new(watch(self.service.clone(), id).await?);
        let events =
            events.filter_map(|event| event.map(convert::session_event).map_err(Status::from).transpose());
        Ok(Response::new(Box::pin(events)))
    }

    type ListKeyframesStream = maps::Rows<v1::ListKeyframesResponse>;

    async fn list_keyframes(
        &self,
        request: Request<v1::ListKeyframesRequest>,
    ) -> Result<Response<Self::ListKeyframesStream>, Status> {
        let caller = caller_of(&request)?;
        Ok(Response::new(maps::keyframes(self.service.maps(), &caller, request.into_inner()).await?))
    }

    type QueryPointsStream = maps::Rows<v1::QueryPointsResponse>;

    async fn query_points(
        &self,
        request: Request<v1::QueryPointsRequest>,
    ) -> Result<Response<Self::QueryPointsStream>, Status> {
        let caller = caller_of(&request)?;
        Ok(Response::new(maps::points(self.service.maps(), &caller, request.into_inner()).await?))
    }

    type QueryLinesStream = maps::Rows<v1::QueryLinesResponse>;

    async fn query_lines(
        &self,
        request: Request<v1::QueryLinesRequest>,
    ) -> Result<Response<Self::QueryLinesStream>, Status> {
        let caller = caller_of(&request)?;
        Ok(Response::new(maps::lines(self.service.maps(), &caller, request.into_inner()).await?))
    }

    type ListPrimitivesStream = maps::Rows<v1::ListPrimitivesResponse>;

    async fn list_primitives(
        &self,
        request: Request<v1::ListPrimitivesRequest>,
    ) -> Result<Response<Self::ListPrimitivesStream>, Status> {
        let caller = caller_of(&request)?;
        Ok(Response::new(maps::primitives(self.service.maps(), &caller, request.into_inner()).await?))
    }

    type GetTrajectoryStream = maps::Rows<v1::GetTrajectoryResponse>;

    async fn get_trajectory(
        &self,
        request: Request<v1::GetTrajectoryRequest>,
    ) -> Result<Response<Self::GetTrajectoryStream>, Status> {
        let caller = caller_of(&request)?;
        Ok(Response::new(maps::trajectory(self.service.maps(), &caller, request.into_inner()).await?))
    }

    type ExportMapStream = maps::Rows<v1::ExportMapResponse>;

    async fn export_map(
        &self,
        request: Request<v1::ExportMapRequest>,
    ) -> Result<Response<Self::ExportMapStream>, Status> {
        let caller = caller_of(&request)?;
        Ok(Response::new(maps::export(self.service.maps(), &caller, request.into_inner()).await?))
    }

    type StreamFramesStream = stream::Answers;

    async fn stream_frames(
        &self,
        request: Request<tonic::Streaming<v1::StreamFramesRequest>>,
    ) -> Result<Response<Self::StreamFramesStream>, Status> {
        let caller = caller_of(&request)?;
        // None where a request comes over no connection.
        let charges = request.extensions().get::<Charges>().cloned().unwrap_or_default();
        Ok(Response::new(stream::start(self.service.clone(), caller, request.into_inner(), charges)))
    }
}

/// Who asks, as the door found out.
fn caller_of<T>(request: &Request<T>) -> Result<Caller, ApiError> {
    let caller = request.extensions().get::<Caller>().cloned();
    caller.ok_or_else(|| ApiError::internal("a call is not behind the door"))
}

fn session_id(caller: &Caller, text: &str) -> Result<SessionId, ApiError> {
    caller.session(text, "session_id")
}
