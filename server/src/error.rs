//! What goes wrong, once for both interfaces: a code, a sentence for the caller, and a cause for the log.

use axum::http::StatusCode;
use std::time::Duration;
use store::{Owner, StoreError};
use tonic::Code;

/// The kinds of error. Their names are stable: clients may match on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ErrorCode {
    /// A field of the request cannot be used; the violations say which.
    InvalidArgument,
    /// There is no session with this id.
    SessionNotFound,
    /// The session has no keyframe with this id.
    KeyframeNotFound,
    /// The session has no global primitive with this id.
    PrimitiveNotFound,
    /// The keyframe's image was not kept.
    ImageNotFound,
    /// The frame is not kept, or no longer.
    FrameNotFound,
    /// There is no such path.
    NotFound,
    /// The path does not take this method.
    MethodNotAllowed,
    /// The chosen session id is taken.
    SessionExists,
    /// Another client streams into the session.
    WriterConnected,
    /// An operation works on the session.
    SessionBusy,
    /// There is no such operation.
    OperationNotFound,
    /// Other sessions' cameras extend the session's map, or it extends another's.
    MapShared,
    /// The two sessions cannot be joined.
    CannotMerge,
    /// The scale cannot be found from what was given.
    ScaleUndetermined,
    /// Another client took the session over.
    TakenOver,
    /// There are as many sessions as the server keeps.
    TooManySessions,
    /// As many sessions are in memory as the server takes.
    TooManyLoadedSessions,
    /// As many such requests are under way as the server takes.
    TooBusy,
    /// The answer was not there in the time that the server spends on one.
    TookTooLong,
    /// A message is larger than the server takes.
    MessageTooLarge,
    /// The body is of a type that is not taken here.
    UnsupportedMediaType,
    /// The database cannot grow.
    StorageFull,
    /// The database cannot be used now.
    StorageFailed,
    /// The object store of images cannot be used now.
    ObjectsFailed,
    /// The stored map cannot be used.
    DataLoss,
    /// What is stored of the session is damaged; others are not affected.
    SessionDamaged,
    /// Another server works with the session; the error says where it is reached.
    OwnedElsewhere,
    /// Another server works with the session and cannot be reached now.
    OwnerUnreachable,
    /// This server stood still for too long, so that another may work with the session by now.
    LeaseLost,
    /// The server is about to stop.
    ShuttingDown,
    /// The session's worker failed.
    SessionFailed,
    /// Nobody knows who asks: a token is needed, or this one is not good.
    Unauthenticated,
    /// Who asks may not do that.
    Forbidden,
    /// The server was called by a name that is not its own.
    WrongHost,
    /// A page of somebody else asks.
    ForeignOrigin,
    /// One caller asks too often.
    RateLimited,
    /// One caller uses as much as it may.
    QuotaExceeded,
    /// As many connections are in use as the server takes.
    TooManyConnections,
    /// A stream that was opened and not used made way for another.
    IdleStream,
    /// Our own fault.
    Internal,
}

impl ErrorCode {
    /// The stable name of the code.
    pub fn name(self) -> &'static str {
        match self {
            Self::InvalidArgument => "INVALID_ARGUMENT",
            Self::SessionNotFound => "SESSION_NOT_FOUND",
            Self::KeyframeNotFound => "KEYFRAME_NOT_FOUND",
            Self::PrimitiveNotFound => "PRIMITIVE_NOT_FOUND",
            Self::ImageNotFound => "IMAGE_NOT_FOUND",
            Self::FrameNotFound => "FRAME_NOT_FOUND",
            Self::TooBusy => "TOO_BUSY",
            Self::TookTooLong => "TOOK_TOO_LONG",
            Self::NotFound => "NOT_FOUND",
            Self::MethodNotAllowed => "METHOD_NOT_ALLOWED",
            Self::SessionExists => "SESSION_EXISTS",
            Self::WriterConnected => "WRITER_CONNECTED",
            Self::SessionBusy => "SESSION_BUSY",
            Self::OperationNotFound => "OPERATION_NOT_FOUND",
            Self::MapShared => "MAP_SHARED",
            Self::CannotMerge => "CANNOT_MERGE",
            Self::ScaleUndetermined => "SCALE_UNDETERMINED",
            Self::TakenOver => "TAKEN_OVER",
            Self::TooManySessions => "TOO_MANY_SESSIONS",
            Self::TooManyLoadedSessions => "TOO_MANY_LOADED_SESSIONS",
            Self::MessageTooLarge => "MESSAGE_TOO_LARGE",
            Self::UnsupportedMediaType => "UNSUPPORTED_MEDIA_TYPE",
            Self::StorageFull => "STORAGE_FULL",
            Self::StorageFailed => "STORAGE_FAILED",
            Self::ObjectsFailed => "OBJECTS_FAILED",
            Self::DataLoss => "DATA_LOSS",
            Self::SessionDamaged => "SESSION_DAMAGED",
            Self::OwnedElsewhere => "OWNED_ELSEWHERE",
            Self::OwnerUnreachable => "OWNER_UNREACHABLE",
            Self::LeaseLost => "LEASE_LOST",
            Self::ShuttingDown => "SHUTTING_DOWN",
            Self::SessionFailed => "SESSION_FAILED",
            Self::Unauthenticated => "UNAUTHENTICATED",
            Self::Forbidden => "FORBIDDEN",
            Self::WrongHost => "WRONG_HOST",
            Self::ForeignOrigin => "FOREIGN_ORIGIN",
            Self::RateLimited => "RATE_LIMITED",
            Self::QuotaExceeded => "QUOTA_EXCEEDED",
            Self::TooManyConnections => "TOO_MANY_CONNECTIONS",
            Self::IdleStream => "IDLE_STREAM",
            Self::Internal => "INTERNAL",
        }
    }

    /// A short title in plain words, the same for every error of this kind.
    pub fn title(self) -> &'static str {
        match self {
            Self::InvalidArgument => "The request cannot be used",
            Self::SessionNotFound => "No such session",
            Self::KeyframeNotFound => "No such keyframe",
            Self::PrimitiveNotFound => "No such global primitive",
            Self::ImageNotFound => "There is no such image, or it was not kept",
            Self::FrameNotFound => "The frame is not kept, or no longer",
            Self::TooBusy => "Too much is asked at once",
            Self::TookTooLong => "It took too long",
            Self::NotFound => "No such path",
            Self::MethodNotAllowed => "The path does not take this method",
            Self::SessionExists => "The session exists already",
            Self::WriterConnected => "A writer is connected",
            Self::SessionBusy => "An operation works on the session",
            Self::OperationNotFound => "No such operation",
            Self::MapShared => "Several sessions share the map",
            Self::CannotMerge => "The sessions cannot be joined",
            Self::ScaleUndetermined => "The scale cannot be found",
            Self::TakenOver => "Another client took the session over",
            Self::TooManySessions => "Too many sessions",
            Self::TooManyLoadedSessions => "Too many sessions are in use",
            Self::MessageTooLarge => "The message is too large",
            Self::UnsupportedMediaType => "The body is of a type that is not taken here",
            Self::StorageFull => "The storage is full",
            Self::StorageFailed => "The storage failed",
            Self::ObjectsFailed => "The object store failed",
            Self::DataLoss | Self::SessionDamaged => "The stored map is damaged",
            Self::OwnedElsewhere => "Another server works with the session",
            Self::OwnerUnreachable => "The session's server cannot be reached",
            Self::LeaseLost => "The session was given up",
            Self::ShuttingDown => "The server is shutting down",
            Self::SessionFailed => "The session failed",
            Self::Unauthenticated => "A token is needed",
            Self::Forbidden => "Not allowed",
            Self::WrongHost => "Not a name of this server",
            Self::ForeignOrigin => "A page of somebody else",
            Self::RateLimited => "Too many requests",
            Self::QuotaExceeded => "The quota is used up",
            Self::TooManyConnections => "Too many connections",
            Self::IdleStream => "The stream was not used",
            Self::Internal => "Internal error",
        }
    }

    /// The code's gRPC status.
    pub fn grpc(self) -> Code {
        match self {
            Self::InvalidArgument | Self::UnsupportedMediaType => Code::InvalidArgument,
            Self::SessionNotFound
            | Self::KeyframeNotFound
            | Self::PrimitiveNotFound
            | Self::ImageNotFound
            | Self::FrameNotFound
            | Self::OperationNotFound
            | Self::NotFound => Code::NotFound,
            Self::MethodNotAllowed => Code::Unimplemented,
            Self::SessionExists => Code::AlreadyExists,
            Self::WriterConnected
            | Self::SessionBusy
            | Self::MapShared
            | Self::CannotMerge
            | Self::ScaleUndetermined => Code::FailedPrecondition,
            Self::TakenOver | Self::IdleStream => Code::Aborted,
            Self::Unauthenticated => Code::Unauthenticated,
            Self::Forbidden | Self::WrongHost | Self::ForeignOrigin => Code::PermissionDenied,
            Self::TooManySessions
            | Self::TooManyLoadedSessions
            | Self::TooBusy
            | Self::RateLimited
            | Self::QuotaExceeded
            | Self::TooManyConnections
            | Self::MessageTooLarge
            | Self::StorageFull => Code::ResourceExhausted,
            Self::TookTooLong => Code::DeadlineExceeded,
            Self::StorageFailed
            | Self::ObjectsFailed
            | Self::OwnedElsewhere
            | Self::OwnerUnreachable
            | Self::LeaseLost
            | Self::ShuttingDown => Code::Unavailable,
            Self::DataLoss | Self::SessionDamaged => Code::DataLoss,
            Self::SessionFailed | Self::Internal => Code::Internal,
        }
    }

    /// The code's HTTP status.
    pub fn http(self) -> StatusCode {
        match self {
            Self::InvalidArgument => StatusCode::BAD_REQUEST,
            Self::SessionNotFound
            | Self::KeyframeNotFound
            | Self::PrimitiveNotFound
            | Self::ImageNotFound
            | Self::FrameNotFound
            | Self::OperationNotFound
            | Self::NotFound => StatusCode::NOT_FOUND,
            Self::MethodNotAllowed => StatusCode::METHOD_NOT_ALLOWED,
            Self::SessionExists
            | Self::WriterConnected
            | Self::SessionBusy
            | Self::MapShared
            | Self::CannotMerge
            | Self::TakenOver
            | Self::OwnedElsewhere
            | Self::IdleStream => StatusCode::CONFLICT,
            Self::ScaleUndetermined => StatusCode::UNPROCESSABLE_ENTITY,
            Self::Unauthenticated => StatusCode::UNAUTHORIZED,
            Self::Forbidden | Self::ForeignOrigin => StatusCode::FORBIDDEN,
            Self::WrongHost => StatusCode::MISDIRECTED_REQUEST,
            Self::TooManySessions
            | Self::TooManyLoadedSessions
            | Self::TooBusy
            | Self::RateLimited
            | Self::QuotaExceeded => StatusCode::TOO_MANY_REQUESTS,
            Self::MessageTooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            Self::UnsupportedMediaType => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            Self::StorageFull => StatusCode::INSUFFICIENT_STORAGE,
            Self::StorageFailed
            | Self::ObjectsFailed
            | Self::OwnerUnreachable
            | Self::LeaseLost
            | Self::ShuttingDown
            | Self::TooManyConnections
            | Self::TookTooLong => StatusCode::SERVICE_UNAVAILABLE,
            Self::DataLoss | Self::SessionDamaged | Self::SessionFailed | Self::Internal => {
                StatusCode::INTERNAL_SERVER_ERROR
            }
        }
    }
}

/// One field that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldViolation {
    /// Path of the field, such as `camera.fx`.
    pub field: String,
    /// What is wrong with it, in a plain sentence.
    pub description: String,
}

/// An error on its way to a caller. Its `Display` is the sentence the caller reads.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{message}")]
pub struct ApiError {
    /// What kind of error.
    pub code: ErrorCode,
    /// What happened and what to do about it, in a plain sentence.
    pub message: String,
    /// The fields that are wrong, for [`ErrorCode::InvalidArgument`].
    pub violations: Vec<FieldViolation>,
    /// After how long the same request may be taken, where that is known.
    pub retry_after: Option<Duration>,
    /// The server that works with the session, for [`ErrorCode::OwnedElsewhere`].
    pub owner: Option<Box<Owner>>,
}

impl ApiError {
    /// An error of this kind.
    pub fn new(code: ErrorCode, message: impl Into<String>) -> Self {
        Self { code, message: message.into(), violations: Vec::new(), retry_after: None, owner: None }
    }

    /// A request with one wrong field.
    pub fn invalid(field: impl Into<String>, description: impl Into<String>) -> Self {
        Self::invalid_fields(vec![FieldViolation { field: field.into(), description: description.into() }])
    }

    /// A request with these wrong fields; its message is about the first.
    pub fn invalid_fields(violations: Vec<FieldViolation>) -> Self {
        let first = violations.first().map(|first| format!("{}: {}", first.field, first.description));
        Self { violations, ..Self::new(ErrorCode::InvalidArgument, first.unwrap_or_default()) }
    }

    /// The same error, with the time after which the request may be taken.
    pub fn retry_after(self, wait: Duration) -> Self {
        Self { retry_after: Some(wait), ..self }
    }

    /// There is no session with this id.
    pub fn session_not_found(id: &str) -> Self {
        Self::new(ErrorCode::SessionNotFound, format!("there is no session {id:?}"))
    }

    /// Our own fault: the cause goes to the log and the caller reads a plain sentence.
    pub fn internal(cause: impl std::fmt::Display) -> Self {
        tracing::error!(cause = %cause, "internal error: {cause}");
        Self::new(ErrorCode::Internal, "something went wrong inside the server; its log says what")
    }
}

impl From<ApiError> for tonic::Status {
    fn from(error: ApiError) -> Self {
        use tonic_types::{ErrorDetails, StatusExt};
        let mut details = ErrorDetails::new();
        let mut told = std::collections::HashMap::<String, String>::new();
        if let Some(owner) = error.owner {
            told.insert("grpc_url".to_owned(), owner.grpc_url);
            told.insert("http_url".to_owned(), owner.http_url);
        }
        details.set_error_info(error.code.name(), "monoslam", told);
        if let Some(wait) = error.retry_after {
            details.set_retry_info(Some(wait));
        }
        for FieldViolation { field, description } in &error.violations {
            details.add_bad_request_violation(field, description);
        }
        Self::with_error_details(error.code.grpc(), error.message, details)
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        let code = match &error {
            StoreError::SessionNotFound { .. } => ErrorCode::SessionNotFound,
            StoreError::SessionExists { .. } => ErrorCode::SessionExists,
            StoreError::MapInUse { .. } => ErrorCode::MapShared,
            StoreError::OutOfRange { .. } => ErrorCode::InvalidArgument,
            StoreError::DiskFull(_) => ErrorCode::StorageFull,
            StoreError::Io(_)
            | StoreError::Busy(_)
            | StoreError::Gone { .. }
            | StoreError::Unreachable(_)
            | StoreError::Failing(_) => ErrorCode::StorageFailed,
            StoreError::Objects(_) => ErrorCode::ObjectsFailed,
            StoreError::OwnedElsewhere { .. } => ErrorCode::OwnedElsewhere,
            StoreError::LeaseLost { .. } => ErrorCode::LeaseLost,
            StoreError::Corrupt(_) | StoreError::Map(_) | StoreError::OtherSettings(_) => ErrorCode::DataLoss,
            _ => return Self::internal(with_causes(&error)),
        };
        if matches!(code, ErrorCode::StorageFailed | ErrorCode::DataLoss) {
            let cause = with_causes(&error);
            tracing::error!(cause, "the database failed: {cause}");
        }
        let message = match &error {
            // The key holds the owner, which callers do not say.
            StoreError::SessionNotFound { id } => return Self::session_not_found(name_in(id)),
            StoreError::SessionExists { id } => format!("there is already a session {:?}", name_in(id)),
            StoreError::MapInUse { id, by } => in_use(name_in(id), name_in(by)),
            StoreError::OwnedElsewhere { id, owner } => {
                let (name, Owner { grpc_url, http_url, .. }) = (name_in(id), owner);
                format!("another server works with session {name:?}: ask it, at {grpc_url} or {http_url}")
            }
            StoreError::LeaseLost { id } => format!(
                "this server could not keep session {:?}; open it again to go on from its last saved frame",
                name_in(id)
            ),
            _ => error.to_string(),
        };
        let owner = match error {
            StoreError::OwnedElsewhere { owner, .. } => Some(Box::new(owner)),
            _ => None,
        };
        Self { owner, ..Self::new(code, message) }
    }
}

fn in_use(id: &str, by: &str) -> String {
    format!("session {by:?} has its camera extend the map of session {id:?}; delete that one first")
}

/// What callers call the session of a key.
fn name_in(key: &str) -> &str {
    key.rsplit_once('~').map_or(key, |(_, name)| name)
}

/// An error with what caused it, for the log.
fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use tonic_types::StatusExt;

    #[test]
    fn a_wrong_field_reaches_a_grpc_client_as_a_bad_request_violation() {
        let status = tonic::Status::from(ApiError::invalid("camera.fx", "must be positive, is -1"));
        assert_eq!(status.code(), Code::InvalidArgument);
        assert_eq!(status.message(), "camera.fx: must be positive, is -1");
        let details = status.get_error_details();
        let violations = &details.bad_request().unwrap().field_violations;
        assert_eq!(violations[0].field, "camera.fx");
        assert_eq!(details.error_info().unwrap().reason, "INVALID_ARGUMENT");
    }
}
