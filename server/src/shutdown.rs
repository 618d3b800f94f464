//! When to stop.

use tokio::signal::unix::{SignalKind, signal};

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
