//! What a session's map holds, its scale, and where an image was taken in it.

use proto::v1;

use super::SlamClient;
use crate::error::ClientError;

impl SlamClient {
    /// All points of a session's map, as of its last commit.
    ///
    /// # Errors
    /// `NOT_FOUND`, or if the connection breaks.
    pub async fn points(&mut self, session_id: &str) -> Result<Vec<v1::Point>, ClientError> {
        let request = v1::QueryPointsRequest { session_id: session_id.to_owned(), ..Default::default() };
        let answer = self.grpc.query_points(request).await;
        let mut batches = self.unpack(answer)?;
        let mut points = Vec::new();
        while let Some(batch) = batches.message().await.map_err(|status| self.refused(&status))? {
            points.extend(batch.points);
        }
        Ok(points)
    }

    /// All lines of a session's map, as of its last commit.
    ///
    /// # Errors
    /// `NOT_FOUND`, or if the connection breaks.
    pub async fn lines(&mut self, session_id: &str) -> Result<Vec<v1::Line>, ClientError> {
        let request = v1::QueryLinesRequest { session_id: session_id.to_owned(), ..Default::default() };
        let answer = self.grpc.query_lines(request).await;
        let mut batches = self.unpack(answer)?;
        let mut lines = Vec::new();
        while let Some(batch) = batches.message().await.map_err(|status| self.refused(&status))? {
            lines.extend(batch.lines);
        }
        Ok(lines)
    }

    /// Says how many metres a map unit of the session is, or with `None` frees the scale.
    ///
    /// # Errors
    /// `NOT_FOUND`, or `INVALID_ARGUMENT` if it is not a positive number.
    pub async fn set_scale(
        &mut self,
        session_id: &str,
        metres_per_unit: Option<f64>,
    ) -> Result<v1::Session, ClientError> {
        let session_id = session_id.to_owned();
        let request = v1::SetScaleRequest { session_id, metres_per_unit, reference: None };
        let answer = self.grpc.set_scale(request).await;
        self.unpack(answer)
    }

    /// Finds how many metres a map unit of the session is from a known distance or positions; the session's
    /// `scale_measurement` tells how well.
    ///
    /// # Errors
    /// `NOT_FOUND`, `INVALID_ARGUMENT`, or `FAILED_PRECONDITION` if the reference does not determine it.
    pub async fn measure_scale(
        &mut self,
        session_id: &str,
        reference: v1::set_scale_request::Reference,
    ) -> Result<v1::Session, ClientError> {
        let (session_id, reference) = (session_id.to_owned(), Some(reference));
        let request = v1::SetScaleRequest { session_id, metres_per_unit: None, reference };
        let answer = self.grpc.set_scale(request).await;
        self.unpack(answer)
    }

    /// Locates one image in the map of a session without changing it. A place that is not found is an answer:
    /// its state is `LOST` and its reason a sentence.
    ///
    /// # Errors
    /// `NOT_FOUND`, or `INVALID_ARGUMENT` if the image cannot be used.
    pub async fn localize(
        &mut self,
        session_id: &str,
        image: v1::Image,
    ) -> Result<v1::LocalizeResponse, ClientError> {
        let session_id = session_id.to_owned();
        self.localize_with(v1::LocalizeRequest { session_id, image: Some(image), ..Default::default() }).await
    }

    /// As [`Self::localize`], with everything that can be said: another camera, several sessions, where to
    /// look.
    ///
    /// # Errors
    /// `NOT_FOUND`, or `INVALID_ARGUMENT` if the image or what is said of its camera cannot be used.
    pub async fn localize_with(
        &mut self,
        request: v1::LocalizeRequest,
    ) -> Result<v1::LocalizeResponse, ClientError> {
        let answer = self.grpc.localize(request).await;
        self.unpack(answer)
    }
}
