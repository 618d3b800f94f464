//! Who asks.

use super::rates::FrameRate;
use crate::error::{ApiError, ErrorCode};
use crate::network::QuotaConfig;
use crate::session::{Closed, FrameQueue, OWNER_END, Policy, Queued, Rejection, SessionId};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use store::{TokenQuotas, TokenRecord, TokenRole};
use tokio_util::sync::CancellationToken;

/// What a caller may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Read its owner's sessions.
    Reader,
    /// Make, change, stream into and delete its owner's sessions as well.
    Writer,
    /// Everything, with all sessions.
    Admin,
}

impl Role {
    /// The role in one word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reader => "reader",
            Self::Writer => "writer",
            Self::Admin => "admin",
        }
    }
}

impl From<TokenRole> for Role {
    fn from(role: TokenRole) -> Self {
        match role {
            TokenRole::Reader => Self::Reader,
            TokenRole::Writer => Self::Writer,
            TokenRole::Admin => Self::Admin,
        }
    }
}

/// Who asks. Cheap to clone; clones share what is counted.
#[derive(Clone)]
pub struct Caller(Arc<Identity>);

struct Identity {
    name: String,
    role: Role,
    /// Whose sessions it sees; `None` sees those of all.
    owner: Option<String>,
    quotas: TokenQuotas,
    /// Cancelled when the token is good for nothing any more.
    revoked: CancellationToken,
    streams: Arc<Mutex<Vec<Weak<FrameQueue>>>>,
    frame_rate: Option<FrameRate>,
}

impl Caller {
    /// Who needs no token: this machine, or everybody, while there are no tokens.
    pub fn open() -> Self {
        Self::new("local", Role::Admin, None, TokenQuotas::default())
    }

    /// Who has this token.
    pub fn of(record: &TokenRecord, defaults: &QuotaConfig) -> Self {
        let token = &record.token;
        let role = Role::from(token.role);
        let mut quotas = token.quotas;
        if role != Role::Admin {
            quotas.max_sessions = quotas.max_sessions.or(defaults.max_sessions);
            quotas.max_streams = quotas.max_streams.or(defaults.max_streams);
            quotas.max_frames_per_s = quotas.max_frames_per_s.or(defaults.max_frames_per_s);
            quotas.max_stored_bytes = quotas.max_stored_bytes.or(defaults.max_stored_bytes);
        }
        Self::new(&token.name, role, token.owner.clone(), quotas)
    }

    /// The same caller with other quotas: it is revoked with this one, and its streams are counted together.
    pub fn with_quotas(&self, record: &TokenRecord, defaults: &QuotaConfig) -> Self {
        let Self(mut identity) = Self::of(record, defaults);
        // Nobody else has it yet.
        if let Some(identity) = Arc::get_mut(&mut identity) {
            identity.revoked = self.0.revoked.clone();
            identity.streams = self.0.streams.clone();
        }
        Self(identity)
    }

    fn new(name: &str, role: Role, owner: Option<String>, quotas: TokenQuotas) -> Self {
        Self(Arc::new(Identity {
            name: name.to_owned(),
            role,
            owner,
            quotas,
            revoked: CancellationToken::new(),
            streams: Arc::default(),
            frame_rate: quotas.max_frames_per_s.map(FrameRate::new),
        }))
    }

    /// The token's name; `local` without one.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// What it may do.
    pub fn role(&self) -> Role {
        self.0.role
    }

    /// Whose sessions it sees; `None` sees those of all.
    pub fn owner(&self) -> Option<&str> {
        self.0.owner.as_deref()
    }

    /// What it may use at most.
    pub fn quotas(&self) -> &TokenQuotas {
        &self.0.quotas
    }

    /// Cancelled when the token is good for nothing any more.
    pub fn revoked(&self) -> &CancellationToken {
        &self.0.revoked
    }

    /// The session the caller means; `field` is what an error calls the text.
    ///
    /// # Errors
    /// If the text is no id. Whether there is such a session is not looked up.
    pub fn session(&self, text: &str, field: &str) -> Result<SessionId, ApiError> {
        SessionId::within(self.owner(), text, field)
    }

    /// A stored session as the caller calls it.
    pub fn stored(&self, key: String) -> SessionId {
        SessionId::stored(self.owner(), key)
    }

    /// How the keys of all sessions begin that the caller sees.
    pub fn prefix(&self) -> String {
        self.owner().map_or(String::new(), |owner| format!("{owner}{OWNER_END}"))
    }

    /// Queues what came in a stream. A frame that is one too many for the token waits, or, in a REALTIME
    /// stream, is rejected.
    ///
    /// # Errors
    /// If the queue was closed.
    pub async fn push(&self, queue: &FrameQueue, item: Queued) -> Result<(), Closed> {
        let item = match (&self.0.frame_rate, item) {
            (Some(rate), Queued::Frame(frame)) => match queue.policy() {
                Policy::Lossless => {
                    tokio::select! {
                        () = rate.turn() => {}
                        () = queue.closed() => return Err(Closed),
                    }
                    Queued::Frame(frame)
                }
                Policy::Realtime => match rate.count() {
                    Ok(()) => Queued::Frame(frame),
                    Err(_wait) => Queued::Rejected(Rejection {
                        sequence: frame.sequence,
                        field: "frame",
                        reason: rate.sentence(),
                        code: ErrorCode::RateLimited.name(),
                    }),
                },
            },
            (_, item) => item,
        };
        queue.push(item).await
    }

    /// Counts a stream that was opened; it counts until its queue is closed.
    ///
    /// # Errors
    /// If the caller has as many as it may.
    pub fn count_stream(&self, queue: &Arc<FrameQueue>) -> Result<(), ApiError> {
        let Some(limit) = self.0.quotas.max_streams else { return Ok(()) };
        let mut streams = self.0.streams.lock().unwrap_or_else(PoisonError::into_inner);
        streams.retain(|stream| stream.upgrade().is_some_and(|queue| !queue.is_closed()));
        if streams.len() as u64 >= limit {
            let sentence =
                format!("{limit} streams are open with this token, as many as it may; end one first");
            return Err(ApiError::new(ErrorCode::QuotaExceeded, sentence));
        }
        streams.push(Arc::downgrade(queue));
        Ok(())
    }
}
