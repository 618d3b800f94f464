//! A socket that notes whether its client reads, and counts what comes where that is wanted.

use super::inflow::{Inflow, Waiting};
use super::table::Place;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;

/// A connection's socket, which keeps the connection's place in the table.
pub struct Socket {
    stream: TcpStream,
    place: Arc<Place>,
    inflow: Inflow,
    /// Room for what was read last; nothing more is read before there is some.
    waiting: Option<Waiting>,
}

impl Socket {
    /// A socket with its place.
    pub fn new(stream: TcpStream, place: Arc<Place>, inflow: Inflow) -> Self {
        Self { stream, place, inflow, waiting: None }
    }

    fn noted<T>(&self, outcome: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        self.place.wrote(outcome.is_ready());
        outcome
    }
}

impl AsyncRead for Socket {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let Self { stream, inflow, waiting, .. } = &mut *self;
        ready!(inflow.poll(waiting, cx))?;
        let n_before = into.filled().len();
        let outcome = Pin::new(stream).poll_read(cx, into);
        *waiting = inflow.note(into.filled().len() - n_before);
        outcome
    }
}

impl AsyncWrite for Socket {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.noted(outcome)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.stream).poll_write_vectored(cx, bytes);
        self.noted(outcome)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
