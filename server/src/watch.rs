//! Watching a session: its state first, then what happens.

use crate::error::ApiError;
use crate::service::Service;
use crate::session::{SessionEvent, SessionId, SessionView};
use std::sync::Arc;
use tokio::sync::{broadcast, mpsc};

/// Messages that wait for a watcher to read them; then events wait in the session, and then they are missed.
const MAX_WAITING: usize = 16;

/// A message to a watcher.
#[derive(Clone, Debug)]
pub enum Watched {
    /// The session as it is now.
    Session(Box<SessionView>),
    /// Something happened.
    Event(SessionEvent),
    /// So many events were left out because the watcher did not read them.
    Missed(u64),
}

/// Watches a session until the watcher is gone, the session is deleted, or the server shuts down.
///
/// # Errors
/// If there is no such session.
pub async fn watch(
    service: Arc<Service>,
    id: SessionId,
) -> Result<mpsc::Receiver<Result<Watched, ApiError>>, ApiError> {
    service.registry().check_open()?;
    // Looked up first: asking for events makes a place for the session.
    service.get_session(&id).await?;
    let events = service.registry().events(&id);
    let view = service.get_session(&id).await?;
    let (sender, receiver) = mpsc::channel(MAX_WAITING);
    let first = Ok(Watched::Session(Box::new(view)));
    tokio::spawn(async move {
        let closed = service.registry().closed();
        tokio::select! {
            () = forward(&service, &id, events, &sender, first) => {}
            () = closed.cancelled() => {}
            () = sender.closed() => {}
        }
    });
    Ok(receiver)
}

async fn forward(
    service: &Service,
    id: &SessionId,
    mut events: broadcast::Receiver<SessionEvent>,
    watcher: &mpsc::Sender<Result<Watched, ApiError>>,
    first: Result<Watched, ApiError>,
) {
    let mut message = first;
    loop {
        let is_last = message.is_err();
        if watcher.send(message).await.is_err() || is_last {
            return;
        }
        message = match events.recv().await {
            Ok(SessionEvent::Settings) => {
                service.get_session(id).await.map(|view| Watched::Session(Box::new(view)))
            }
            Ok(event) => Ok(Watched::Event(event)),
            Err(broadcast::error::RecvError::Lagged(n)) => Ok(Watched::Missed(n)),
            Err(broadcast::error::RecvError::Closed) => return,
        };
    }
}
