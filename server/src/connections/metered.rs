//! Bodies of requests whose bytes are counted against the budget for messages.
//!
//! A message is charged with its whole length as soon as that is known, before memory is made for it, so that
//! one that is let in can be finished. Messages that are begun and not finished are as costly as finished
//! ones.

use crate::budget::{Budget, Charge, Charges};
use crate::error::ApiError;
use axum::BoxError;
use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::time::{Sleep, sleep};
use tonic::Status;

/// Bytes before each gRPC message: whether it is compressed, and its length [gRPC over HTTP/2,
/// "Length-Prefixed-Message"].
const HEAD_BYTES: usize = 5;

type Taking = Pin<Box<dyn Future<Output = Result<Charge, ApiError>> + Send>>;

/// What bodies are counted against.
#[derive(Clone)]
pub struct Meter {
    /// The budget of all connections.
    pub budget: Arc<Budget>,
    /// Longer messages are refused by whoever reads them, before memory is made for them.
    pub max_bytes: usize,
}

impl Meter {
    fn take(&self, n_bytes: usize) -> Taking {
        let budget = self.budget.clone();
        Box::pin(async move { budget.take(n_bytes).await })
    }
}

/// The body of a gRPC request. Between messages it may stand still, within one only for a time.
pub struct Messages<B> {
    inner: B,
    meter: Meter,
    charges: Charges,
    /// What came and was not handed on yet.
    parked: Bytes,
    head: Vec<u8>,
    /// Bytes that the message under way still lacks.
    n_lacking: usize,
    charge: Option<Charge>,
    taking: Option<Taking>,
    timeout: Duration,
    standing_still: Option<Pin<Box<Sleep>>>,
}

impl<B> Messages<B> {
    /// A body whose complete messages are noted in `charges`.
    pub fn new(inner: B, meter: Meter, charges: Charges, timeout: Duration) -> Self {
        Self {
            inner,
            meter,
            charges,
            parked: Bytes::new(),
            head: Vec::with_capacity(HEAD_BYTES),
            n_lacking: 0,
            charge: None,
            taking: None,
            timeout,
            standing_still: None,
        }
    }

    fn is_within_message(&self) -> bool {
        self.n_lacking > 0 || !self.head.is_empty()
    }

    /// The next part of what is parked, up to the end of the head or message it belongs to; nothing of a
    /// message before there is room for it, but all of the one before.
    fn next_part(&mut self, cx: &mut Context<'_>) -> Poll<Result<Option<Bytes>, ApiError>> {
        if let Some(taking) = &mut self.taking {
            let charge = ready!(taking.as_mut().poll(cx));
            self.taking = None;
            self.charge = Some(charge?);
            return Poll::Ready(Ok(Some(self.hand_on_head())));
        }
        if self.n_lacking > 0 {
            let part = self.parked.split_to(self.n_lacking.min(self.parked.len()));
            self.n_lacking -= part.len();
            if self.n_lacking == 0 {
                self.charge.take().into_iter().for_each(|charge| self.charges.push(charge));
            }
            return Poll::Ready(Ok(Some(part).filter(|part| !part.is_empty())));
        }
        let part = self.parked.split_to((HEAD_BYTES - self.head.len()).min(self.parked.len()));
        self.head.extend_from_slice(&part);
        let [_, a, b, c, d] = self.head[..] else { return Poll::Ready(Ok(None)) };
        self.n_lacking = u32::from_be_bytes([a, b, c, d]) as usize;
        if self.n_lacking > self.meter.max_bytes {
            return Poll::Ready(Ok(Some(self.hand_on_head())));
        }
        self.taking = Some(self.meter.take(self.n_lacking));
        self.next_part(cx)
    }

    fn hand_on_head(&mut self) -> Bytes {
        if self.n_lacking == 0 {
            self.charge.take().into_iter().for_each(|charge| self.charges.push(charge));
        }
        Bytes::from(std::mem::replace(&mut self.head, Vec::with_capacity(HEAD_BYTES)))
    }

    /// Whether a message stands still for too long. Counted from when it is waited for: while others are
    /// worked off nobody asks for more of it.
    fn poll_patience(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        if !self.is_within_message() {
            return Poll::Pending;
        }
        let timeout = self.timeout;
        self.standing_still.get_or_insert_with(|| Box::pin(sleep(timeout))).as_mut().poll(cx)
    }
}

impl<B: Body<Data = Bytes> + Unpin> Body for Messages<B>
where
    B::Error: Into<BoxError>,
{
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        loop {
            if self.taking.is_some() || !self.parked.is_empty() {
                match ready!(self.next_part(cx)) {
                    Ok(Some(part)) => return Poll::Ready(Some(Ok(Frame::data(part)))),
                    Ok(None) => continue,
                    Err(refusal) => return Poll::Ready(Some(Err(Status::from(refusal).into()))),
                }
            }
            let Poll::Ready(frame) = Pin::new(&mut self.inner).poll_frame(cx) else {
                ready!(self.poll_patience(cx));
                let sentence = format!("nothing of a message that was begun came for {:?}", self.timeout);
                return Poll::Ready(Some(Err(Status::deadline_exceeded(sentence).into())));
            };
            self.standing_still = None;
            match frame {
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(data) => self.parked = data,
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                Some(Err(error)) => return Poll::Ready(Some(Err(error.into()))),
                None => return Poll::Ready(None),
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        self.taking.is_none() && self.parked.is_empty() && self.inner.is_end_stream()
    }
}

/// The body of another request, which is one message.
pub struct Whole<B> {
    inner: B,
    meter: Meter,
    charges: Charges,
    /// Bytes that are charged and did not come yet.
    n_prepaid: usize,
    is_begun: bool,
    parked: Option<Bytes>,
    taking: Option<Taking>,
}

impl<B: Body> Whole<B> {
    /// A body whose bytes are noted in `charges`, which must be kept for as long as they are.
    pub fn new(inner: B, meter: Meter, charges: Charges) -> Self {
        Self { inner, meter, charges, n_prepaid: 0, is_begun: false, parked: None, taking: None }
    }

    /// What the request says it is long; what is longer than anything that is read counts as it comes.
    fn said_bytes(&self) -> usize {
        let said = self.inner.size_hint().exact().and_then(|n| usize::try_from(n).ok()).unwrap_or(0);
        if said <= self.meter.max_bytes { said } else { 0 }
    }
}

impl<B: Body<Data = Bytes> + Unpin> Body for Whole<B>
where
    B::Error: Into<BoxError>,
{
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        if !self.is_begun {
            self.is_begun = true;
            self.n_prepaid = self.said_bytes();
            self.taking = (self.n_prepaid > 0).then(|| self.meter.take(self.n_prepaid));
        }
        loop {
            if let Some(taking) = &mut self.taking {
                let charge = ready!(taking.as_mut().poll(cx));
                self.taking = None;
                match charge {
                    Ok(charge) => self.charges.push(charge),
                    Err(refusal) => return Poll::Ready(Some(Err(refusal.into()))),
                }
            }
            if let Some(parked) = self.parked.take() {
                return Poll::Ready(Some(Ok(Frame::data(parked))));
            }
            let frame = match ready!(Pin::new(&mut self.inner).poll_frame(cx)) {
                Some(Ok(frame)) => frame,
                Some(Err(error)) => return Poll::Ready(Some(Err(error.into()))),
                None => return Poll::Ready(None),
            };
            let data = match frame.into_data() {
                Ok(data) => data,
                Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
            };
            let n_paid = data.len().min(self.n_prepaid);
            self.n_prepaid -= n_paid;
            let n_more = data.len() - n_paid;
            self.taking = (n_more > 0).then(|| self.meter.take(n_more));
            self.parked = Some(data);
        }
    }

    fn is_end_stream(&self) -> bool {
        self.taking.is_none() && self.parked.is_none() && self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use http_body_util::{BodyExt, StreamBody};
    use tokio_stream::wrappers::ReceiverStream;

    type Chunks = StreamBody<ReceiverStream<Result<Frame<Bytes>, BoxError>>>;

    fn meter(n_bytes: usize) -> Meter {
        let budget = Arc::new(Budget::with_patience(n_bytes, Duration::from_millis(50)));
        Meter { budget, max_bytes: 64 << 10 }
    }

    /// A gRPC message of zeros.
    fn message(n_bytes: usize) -> Vec<u8> {
        let mut bytes = vec![0];
        bytes.extend((n_bytes as u32).to_be_bytes());
        bytes.resize(HEAD_BYTES + n_bytes, 0);
        bytes
    }

    /// A body that is this cut into chunks.
    fn chunks(bytes: &[u8], n_bytes: usize) -> Chunks {
        let (sender, receiver) = tokio::sync::mpsc::channel(bytes.len().max(1));
        for chunk in bytes.chunks(n_bytes) {
            sender.try_send(Ok(Frame::data(Bytes::copy_from_slice(chunk)))).unwrap();
        }
        StreamBody::new(ReceiverStream::new(receiver))
    }

    #[tokio::test]
    async fn messages_come_out_as_they_went_in_however_they_are_cut() {
        let sent = [message(3000), message(0), message(1), message(5000)].concat();
        for n_bytes in [1, 3, 7, 3004, 3005, 9000] {
            let (meter, charges) = (meter(64 << 10), Charges::default());
            let body = Messages::new(
                chunks(&sent, n_bytes),
                meter.clone(),
                charges.clone(),
                Duration::from_secs(30),
            );
            assert_eq!(body.collect().await.unwrap().to_bytes(), sent, "{n_bytes}");
            assert_eq!(meter.budget.n_taken_bytes(), (3 + 1 + 1 + 5) << 10);
            assert!((0..4).all(|_| charges.pop().is_some()) && charges.pop().is_none());
            assert_eq!(meter.budget.n_taken_bytes(), 0);
        }
    }

    #[tokio::test]
    async fn a_message_that_does_not_fit_is_refused_and_the_one_before_is_not_held_up() {
        let (meter, charges) = (meter(8 << 10), Charges::default());
        let sent = [message(6 << 10), message(4 << 10)].concat();
        let mut body =
            Messages::new(chunks(&sent, usize::MAX), meter.clone(), charges.clone(), Duration::from_secs(30));
        let mut n_bytes = 0;
        while n_bytes < message(6 << 10).len() {
            n_bytes += body.frame().await.unwrap().unwrap().into_data().unwrap().len();
        }
        let refused = body.frame().await.unwrap().unwrap_err();
        let status = refused.downcast_ref::<Status>().expect("a status for the client");
        assert_eq!(status.code(), tonic::Code::ResourceExhausted, "{status}");
        drop((body, charges));
        assert_eq!(meter.budget.n_taken_bytes(), 0);
    }

    #[tokio::test]
    async fn a_message_that_is_begun_must_go_on_and_nothing_must_begin() {
        let timeout = Duration::from_millis(50);
        let (sender, receiver) = tokio::sync::mpsc::channel(4);
        let inner: Chunks = StreamBody::new(ReceiverStream::new(receiver));
        let meter = meter(64 << 10);
        let mut body = Messages::new(inner, meter.clone(), Charges::default(), timeout);
        assert!(
            tokio::time::timeout(timeout * 10, body.frame()).await.is_err(),
            "between messages it may wait"
        );
        sender.send(Ok(Frame::data(Bytes::from(message(2000)).slice(..1000)))).await.unwrap();
        body.frame().await.unwrap().unwrap();
        body.frame().await.unwrap().unwrap();
        let ended = body.frame().await.unwrap().unwrap_err();
        assert!(ended.to_string().contains("begun"), "{ended}");
        drop(body);
        assert_eq!(meter.budget.n_taken_bytes(), 0);
    }

    #[tokio::test]
    async fn another_body_counts_as_long_as_it_says_or_as_it_comes() {
        for n_sent in [4 << 10, 20 << 10] {
            let meter = meter(16 << 10);
            let charges = Charges::default();
            let body = Whole::new(chunks(&vec![7; n_sent], 1 << 10), meter.clone(), charges.clone());
            let collected = body.collect().await;
            assert_eq!(collected.is_ok(), n_sent < 16 << 10);
            drop((collected, charges));
            assert_eq!(meter.budget.n_taken_bytes(), 0);
        }
    }
}
