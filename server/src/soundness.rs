//! What is known of damage in the database. Damaged pages are looked for at start; a session that they are
//! found in is closed to streams, while the others work.

use crate::error::{ApiError, ErrorCode};
use crate::storage::StorageConfig;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use store::{Finding, Store, StoreError};
use tokio_util::sync::CancellationToken;

/// See the module's documentation.
#[derive(Debug, Default)]
pub struct Soundness(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    look: Look,
    /// What is wrong with a session, by its key.
    sessions: BTreeMap<String, String>,
    /// Damage that belongs to the file.
    n_of_file: usize,
}

/// How far the look at the file has come.
#[derive(Debug, Default, PartialEq, Eq)]
enum Look {
    /// There was none, or it ended.
    #[default]
    Over,
    Running,
    /// It could not be finished, and why.
    Failed(String),
}

impl Soundness {
    /// Looks for damage as far as the configuration says: before this returns, or beside it until `closing`.
    pub async fn look(config: &StorageConfig, store: &Store, closing: &CancellationToken) -> Arc<Self> {
        let soundness = Arc::new(Self::default());
        if !config.check_at_start {
            return soundness;
        }
        // PostgreSQL looks after its files itself.
        let Some(path) = store.path() else { return soundness };
        let n_bytes = path.metadata().map_or(0, |file| file.len());
        soundness.lock().look = Look::Running;
        soundness.publish();
        let looking = soundness.clone().look_at(store.clone(), closing.clone());
        if n_bytes > config.check_beside_above_bytes {
            tracing::info!(n_bytes, "the database of {n_bytes} bytes is being looked at for damaged pages");
            tokio::spawn(looking);
        } else {
            looking.await;
        }
        soundness
    }

    async fn look_at(self: Arc<Self>, store: Store, closing: CancellationToken) {
        let begun = std::time::Instant::now();
        let found = store.find_damage(move || !closing.is_cancelled()).await;
        match found {
            Ok(found) => self.note(&found),
            Err(StoreError::Stopped) => self.lock().look = Look::Over,
            Err(error) => {
                tracing::error!("the database cannot be looked at for damage: {error}");
                self.lock().look = Look::Failed(error.to_string());
            }
        }
        metrics::gauge!("monoslam_database_check_seconds").set(begun.elapsed().as_secs_f64());
        self.publish();
    }

    fn note(&self, found: &[Finding]) {
        let mut state = self.lock();
        state.look = Look::Over;
        for finding in found {
            tracing::error!("damage in the database: {finding}");
            match &finding.session {
                Some(key) => {
                    state.sessions.entry(key.clone()).or_insert_with(|| finding.what.clone());
                }
                None => state.n_of_file += 1,
            }
        }
    }

    /// Closes a session to streams.
    pub fn close(&self, key: &str, what: &str) {
        self.lock().sessions.entry(key.to_owned()).or_insert_with(|| what.to_owned());
        self.publish();
    }

    /// Forgets a session that was deleted: the next of its name is another.
    pub fn forget(&self, key: &str) {
        self.lock().sessions.remove(key);
        self.publish();
    }

    /// What is wrong with a session, if anything is known to be.
    pub fn damage(&self, key: &str) -> Option<String> {
        self.lock().sessions.get(key).cloned()
    }

    /// Whether a session can be worked with, as far as is known.
    ///
    /// # Errors
    /// If it is damaged, with what to do.
    pub fn require_sound(&self, key: &str) -> Result<(), ApiError> {
        self.damage(key).map_or(Ok(()), |what| Err(damaged(&what)))
    }

    /// What whoever looks after the server should know, in lines; empty if all is well.
    pub fn summary(&self) -> String {
        let state = self.lock();
        let mut lines = match &state.look {
            Look::Over => String::new(),
            Look::Running => "the database is being looked at for damaged pages\n".to_owned(),
            Look::Failed(why) => format!("the database could not be looked at for damage: {why}\n"),
        };
        match state.sessions.len() {
            0 => {}
            1 => lines += "1 session is damaged and closed: restore a backup or delete it\n",
            n => lines += &format!("{n} sessions are damaged and closed: restore a backup or delete them\n"),
        }
        if state.n_of_file > 0 {
            lines += "the database has damaged pages: restore a backup; `monoslam-server check` lists them\n";
        }
        lines
    }

    fn publish(&self) {
        let state = self.lock();
        let running = if state.look == Look::Running { 1.0 } else { 0.0 };
        metrics::gauge!("monoslam_database_check_running").set(running);
        metrics::gauge!("monoslam_database_damage").set(state.n_of_file as f64);
        metrics::gauge!("monoslam_sessions_damaged").set(state.sessions.len() as f64);
    }

    /// A panic elsewhere leaves the state whole: no code that can panic runs while it is locked.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A session's stored map cannot be used, and what to do.
pub fn damaged(what: &str) -> ApiError {
    let sentence = format!(
        "what is stored of this session is damaged ({what}); the others are not affected: restore a backup with \
         `monoslam-server restore`, or delete the session and map anew"
    );
    ApiError::new(ErrorCode::SessionDamaged, sentence)
}
