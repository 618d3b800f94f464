//! Bodies with time limits, and answers that note when they have ended.

use super::table::InFlight;
use axum::BoxError;
use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::time::{Instant, Sleep, sleep};
use tokio_util::sync::{CancellationToken, WaitForCancellationFutureOwned};

/// The body of a request that must not stand still, nor hold up a shutdown.
pub struct Timed<B> {
    inner: B,
    timeout: Duration,
    standing_still: Pin<Box<Sleep>>,
    closing: Pin<Box<WaitForCancellationFutureOwned>>,
}

impl<B> Timed<B> {
    /// A body that fails when nothing of it comes for `timeout`, or when the server shuts down.
    pub fn new(inner: B, timeout: Duration, closing: CancellationToken) -> Self {
        let (standing_still, closing) = (Box::pin(sleep(timeout)), Box::pin(closing.cancelled_owned()));
        Self { inner, timeout, standing_still, closing }
    }
}

impl<B: Body<Data = Bytes> + Unpin> Body for Timed<B>
where
    B::Error: Into<BoxError>,
{
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        if let Poll::Ready(frame) = Pin::new(&mut self.inner).poll_frame(cx) {
            let deadline = Instant::now() + self.timeout;
            self.standing_still.as_mut().reset(deadline);
            return Poll::Ready(frame.map(|frame| frame.map_err(Into::into)));
        }
        if self.closing.as_mut().poll(cx).is_ready() {
            return Poll::Ready(Some(Err("the server is shutting down".into())));
        }
        ready!(self.standing_still.as_mut().poll(cx));
        let sentence = format!("nothing of the body came for {:?}", self.timeout);
        Poll::Ready(Some(Err(sentence.into())))
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

/// The body of an answer; its request is in flight until it ends.
pub struct Answer {
    inner: axum::body::Body,
    _in_flight: InFlight,
}

impl Answer {
    /// The answer to a request.
    pub fn new(inner: axum::body::Body, in_flight: InFlight) -> Self {
        Self { inner, _in_flight: in_flight }
    }
}

impl Body for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.inner).poll_frame(cx)
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}
