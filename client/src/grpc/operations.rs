//! Long-running operations on whole maps.

use proto::v1;

use super::SlamClient;
use crate::error::ClientError;

impl SlamClient {
    /// Begins global bundle adjustment of an idle session's map; it goes on when the client leaves.
    ///
    /// # Errors
    /// `NOT_FOUND`, `FAILED_PRECONDITION` while a writer is connected or another operation works on it, or
    /// `RESOURCE_EXHAUSTED` where too many wait.
    pub async fn optimize_map(&mut self, session_id: &str) -> Result<v1::Operation, ClientError> {
        let answer =
            self.grpc.optimize_map(v1::OptimizeMapRequest { session_id: session_id.to_owned() }).await;
        self.unpack(answer)
    }

    /// Begins to join one session with another where their maps show the same place.
    ///
    /// # Errors
    /// As [`Self::optimize_map`].
    pub async fn merge_sessions(&mut self, into: &str, from: &str) -> Result<v1::Operation, ClientError> {
        let request = v1::MergeSessionsRequest { into: into.to_owned(), from: from.to_owned() };
        let answer = self.grpc.merge_sessions(request).await;
        self.unpack(answer)
    }

    /// How far an operation is.
    ///
    /// # Errors
    /// `NOT_FOUND` if there is none of this id, or no longer.
    pub async fn operation(&mut self, operation_id: &str) -> Result<v1::Operation, ClientError> {
        let request = v1::GetOperationRequest { operation_id: operation_id.to_owned() };
        let answer = self.grpc.get_operation(request).await;
        self.unpack(answer)
    }

    /// Operations on all sessions, or on one, the newest first.
    ///
    /// # Errors
    /// `NOT_FOUND` if there is no such session.
    pub async fn operations(&mut self, session_id: Option<&str>) -> Result<Vec<v1::Operation>, ClientError> {
        let session_id = session_id.unwrap_or_default().to_owned();
        let answer = self.grpc.list_operations(v1::ListOperationsRequest { session_id }).await;
        Ok(self.unpack(answer)?.operations)
    }

    /// Asks an operation to end without a result.
    ///
    /// # Errors
    /// `NOT_FOUND` if there is none of this id, or no longer.
    pub async fn cancel_operation(&mut self, operation_id: &str) -> Result<v1::Operation, ClientError> {
        let request = v1::CancelOperationRequest { operation_id: operation_id.to_owned() };
        let answer = self.grpc.cancel_operation(request).await;
        self.unpack(answer)
    }
}
