//! When to stop.

use tokio::signal::unix::{Signal, SignalKind, signal};

/// SIGHUP, which asks a server to read its files again and ends none.
pub struct Hangups(Signal);

impl Hangups {
    /// Listens from now on.
    ///
    /// # Errors
    /// If the signal cannot be listened for.
    pub fn new() -> std::io::Result<Self> {
        signal(SignalKind::hangup()).map(Self)
    }

    /// Waits for the next one.
    pub async fn next(&mut self) {
        self.0.recv().await;
    }
}

/// Waits until the process is told to stop, by SIGTERM or SIGINT.
///
/// # Errors
/// If the signals cannot be listened for.
pub async fn requested() -> std::io::Result<()> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let name = tokio::select! {
        _ = terminate.recv() => "SIGTERM",
        _ = interrupt.recv() => "SIGINT",
    };
    tracing::info!("{name} received");
    Ok(())
}
