//! Answers that end early, with why.

use super::serve::Interface;
use crate::error::ApiError;
use axum::body::Body;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use http_body::{Body as _, Frame, SizeHint};
use std::pin::Pin;
use std::task::{Context, Poll};

/// Bytes before each gRPC message: whether it is compressed, and its length.
const HEAD_BYTES: usize = 5;

impl Interface {
    /// An error in the words of the interface.
    pub fn refusal(self, error: ApiError) -> Response {
        match self {
            Self::Http => error.into_response(),
            Self::Grpc => tonic::Status::from(error).into_http(),
        }
    }

    /// The end of an answer that is under way: trailers with why, or, where HTTP has no words for it, the end
    /// of the connection.
    pub fn last_frame(self, error: ApiError) -> Result<Frame<Bytes>, axum::Error> {
        match self {
            Self::Http => Err(axum::Error::new(error)),
            Self::Grpc => {
                let mut trailers = HeaderMap::new();
                tonic::Status::from(error).add_header(&mut trailers).map_err(axum::Error::new)?;
                Ok(Frame::trailers(trailers))
            }
        }
    }
}

/// The body of an answer, until `end` says why it ends; not in the middle of a gRPC message whose rest is
/// there.
pub fn until<End>(body: Body, interface: Interface, end: End) -> Body
where
    End: Future<Output = ApiError> + Send + 'static,
{
    if body.is_end_stream() {
        return body;
    }
    let end = Ending::Waited(Box::pin(end));
    Body::new(Until { inner: Some(body), interface, end, messages: Messages::default() })
}

struct Until {
    /// `None` once it has ended.
    inner: Option<Body>,
    interface: Interface,
    end: Ending,
    messages: Messages,
}

enum Ending {
    Waited(Pin<Box<dyn Future<Output = ApiError> + Send>>),
    There(ApiError),
}

impl Ending {
    fn poll(&mut self, cx: &mut Context<'_>) -> Option<ApiError> {
        if let Self::Waited(end) = self {
            let Poll::Ready(why) = end.as_mut().poll(cx) else { return None };
            *self = Self::There(why);
        }
        match self {
            Self::There(why) => Some(why.clone()),
            Self::Waited(_) => None,
        }
    }
}

impl http_body::Body for Until {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        let Some(inner) = &mut this.inner else { return Poll::Ready(None) };
        let why = this.end.poll(cx);
        let may_end = this.interface == Interface::Http || this.messages.is_between();
        if (why.is_none() || !may_end)
            && let Poll::Ready(frame) = Pin::new(inner).poll_frame(cx)
        {
            match &frame {
                Some(Ok(frame)) => frame.data_ref().into_iter().for_each(|data| this.messages.note(data)),
                Some(Err(_)) | None => this.inner = None,
            }
            return Poll::Ready(frame);
        }
        let Some(why) = why else { return Poll::Pending };
        this.inner = None;
        Poll::Ready(Some(this.interface.last_frame(why)))
    }

    fn is_end_stream(&self) -> bool {
        self.inner.as_ref().is_none_or(Body::is_end_stream)
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::default()
    }
}

/// Where gRPC messages begin and end [gRPC over HTTP/2, "Length-Prefixed-Message"].
#[derive(Default)]
struct Messages {
    head: Vec<u8>,
    n_lacking: usize,
}

impl Messages {
    fn note(&mut self, mut data: &[u8]) {
        while !data.is_empty() {
            if self.n_lacking == 0 {
                let n = (HEAD_BYTES - self.head.len()).min(data.len());
                self.head.extend_from_slice(&data[..n]);
                data = &data[n..];
                if let [_, a, b, c, d] = self.head[..] {
                    self.n_lacking = u32::from_be_bytes([a, b, c, d]) as usize;
                    self.head.clear();
                }
            } else {
                let n = self.n_lacking.min(data.len());
                self.n_lacking -= n;
                data = &data[n..];
            }
        }
    }

    fn is_between(&self) -> bool {
        self.n_lacking == 0 && self.head.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::ErrorCode;
    use http_body_util::{BodyExt, StreamBody};

    /// An answer of these frames that has no end.
    fn endless(frames: &[&'static [u8]]) -> Body {
        let frames: Vec<_> =
            frames.iter().map(|data| Ok::<_, axum::Error>(Frame::data(Bytes::from_static(data)))).collect();
        use futures_util::StreamExt;
        Body::new(StreamBody::new(futures_util::stream::iter(frames).chain(futures_util::stream::pending())))
    }

    fn gone() -> impl Future<Output = ApiError> + Send {
        std::future::ready(ApiError::new(ErrorCode::ShuttingDown, "going"))
    }

    #[tokio::test]
    async fn an_answer_ends_with_why_and_between_messages() {
        let frames: [&[u8]; 3] = [&[0, 0, 0, 0, 4, 1], &[2, 3, 4], &[0, 0, 0, 0, 1, 7]];
        let mut body = endless(&frames);
        let first = body.frame().await.unwrap().unwrap();
        let mut messages = Messages::default();
        messages.note(first.data_ref().unwrap());
        let mut body = Until {
            inner: Some(body),
            interface: Interface::Grpc,
            end: Ending::Waited(Box::pin(gone())),
            messages,
        };
        assert_eq!(body.frame().await.unwrap().unwrap().into_data().unwrap(), frames[1]);
        let trailers = body.frame().await.unwrap().unwrap().into_trailers().unwrap();
        assert_eq!(trailers["grpc-status"], "14");
        assert!(body.frame().await.is_none());

        let mut body = until(endless(&[]), Interface::Http, gone());
        assert!(body.frame().await.unwrap().is_err());
        let mut half = until(endless(&[&[0, 0]]), Interface::Grpc, std::future::pending());
        assert!(half.frame().await.unwrap().is_ok(), "nothing ends it");
    }
}
