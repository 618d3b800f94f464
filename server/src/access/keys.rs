//! Tokens, as the database had them a moment ago.

use super::Caller;
use crate::clock::since_1970_ns;
use crate::network::QuotaConfig;
use crate::outage::Outage;
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;
use store::{Store, StoreError, TOKEN_HASH_BYTES, TokenRecord};
use tokio_util::sync::CancellationToken;

/// Every token begins so, so that people and programs that look for leaked secrets recognize one.
const PREFIX: &str = "monoslam_";

/// Random bytes of a token.
const TOKEN_BYTES: usize = 32;

/// SHA-256 of a token.
pub type Hash = [u8; TOKEN_HASH_BYTES];

/// A new token that nobody can guess.
pub fn new_token() -> String {
    format!("{PREFIX}{}", URL_SAFE_NO_PAD.encode(rand::random::<[u8; TOKEN_BYTES]>()))
}

/// What is kept of a token.
pub fn token_hash(token: &str) -> Hash {
    Sha256::digest(token.as_bytes()).into()
}

/// See the module's documentation.
pub struct Keys {
    store: Store,
    quotas: RwLock<QuotaConfig>,
    known: RwLock<Known>,
}

#[derive(Default)]
struct Known {
    /// Whether there ever was a token.
    is_closed: bool,
    by_hash: HashMap<Hash, Key>,
    /// Tokens of this process alone, which are in no database.
    guests: HashMap<Hash, Key>,
}

#[derive(Clone)]
struct Key {
    id: i64,
    expires_at_ns: Option<i64>,
    record: TokenRecord,
    caller: Caller,
}

impl Key {
    fn is_good(&self, now_ns: i64) -> bool {
        self.record.revoked_at_ns.is_none() && self.expires_at_ns.is_none_or(|end| now_ns < end)
    }
}

impl Keys {
    /// The tokens of a database.
    ///
    /// # Errors
    /// If it cannot be read.
    pub async fn new(store: Store, quotas: QuotaConfig) -> Result<Self, StoreError> {
        let keys = Self { store, quotas: RwLock::new(quotas), known: RwLock::default() };
        keys.refresh().await?;
        Ok(keys)
    }

    /// What tokens may use that were made without numbers of their own. Holds for those that are in use as
    /// well: what they have used so far counts.
    pub fn set_quotas(&self, quotas: &QuotaConfig) {
        quotas.clone_into(&mut self.quotas.write().unwrap_or_else(PoisonError::into_inner));
        for key in self.write().by_hash.values_mut() {
            key.caller = key.caller.with_quotas(&key.record, quotas);
        }
    }

    fn quotas(&self) -> QuotaConfig {
        self.quotas.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Whether nobody needs a token because there never was one.
    pub fn is_open(&self) -> bool {
        !self.read().is_closed
    }

    /// Who has this token; `None` if it is not good.
    pub fn find(&self, token: &str) -> Option<Caller> {
        let (known, hash) = (self.read(), token_hash(token));
        let key = known.by_hash.get(&hash).or_else(|| known.guests.get(&hash))?;
        key.is_good(since_1970_ns()).then(|| key.caller.clone())
    }

    /// Who has the token of this number; `None` if it is not good.
    pub fn numbered(&self, id: i64) -> Option<Caller> {
        let known = self.read();
        let key = known.by_hash.values().chain(known.guests.values()).find(|key| key.id == id)?;
        key.is_good(since_1970_ns()).then(|| key.caller.clone())
    }

    /// The number of a token that is good.
    pub fn number(&self, token: &str) -> Option<i64> {
        let (known, hash) = (self.read(), token_hash(token));
        let key = known.by_hash.get(&hash).or_else(|| known.guests.get(&hash))?;
        key.is_good(since_1970_ns()).then_some(key.id)
    }

    /// Takes a token for as long as this process runs.
    pub fn admit_guest(&self, record: TokenRecord) {
        let caller = Caller::of(&record, &self.quotas());
        let (hash, id, expires_at_ns) = (record.token.hash, record.id, record.token.expires_at_ns);
        self.write().guests.insert(hash, Key { id, expires_at_ns, record, caller });
    }

    /// Whether there is a token of this process alone.
    pub fn has_guests(&self) -> bool {
        !self.read().guests.is_empty()
    }

    /// Reads the tokens anew. Whoever has one that is good no more is told.
    ///
    /// # Errors
    /// If the database cannot be read; what was known before stays.
    pub async fn refresh(&self) -> Result<(), StoreError> {
        let records = self.store.tokens().await?;
        let now_ns = since_1970_ns();
        let mut known = self.write();
        known.is_closed |= !records.is_empty();
        let mut before = std::mem::take(&mut known.by_hash);
        for record in records {
            let hash = record.token.hash;
            // Who was known stays the same: what it uses is counted there.
            let same = before.remove(&hash).filter(|key| key.record.token == record.token);
            let caller = same.map_or_else(|| Caller::of(&record, &self.quotas()), |key| key.caller);
            let (id, expires_at_ns) = (record.id, record.token.expires_at_ns);
            let key = Key { id, expires_at_ns, record, caller };
            if !key.is_good(now_ns) {
                key.caller.revoked().cancel();
            }
            known.by_hash.insert(hash, key);
        }
        before.values().for_each(|gone| gone.caller.revoked().cancel());
        Ok(())
    }

    /// Reads the tokens anew again and again, until `closing`.
    pub async fn look_after(self: Arc<Self>, every: Duration, closing: CancellationToken) {
        let mut outage = Outage::new("the tokens cannot be read, those from before hold");
        while tokio::time::timeout(every, closing.cancelled()).await.is_err() {
            outage.note(&self.refresh().await);
        }
    }

    fn read(&self) -> std::sync::RwLockReadGuard<'_, Known> {
        self.known.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> std::sync::RwLockWriteGuard<'_, Known> {
        self.known.write().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_long_and_differ() {
        let (a, b) = (new_token(), new_token());
        assert!(a.starts_with(PREFIX) && a.len() == PREFIX.len() + 43 && a != b);
        assert!(a.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte)));
        assert_ne!(token_hash(&a), token_hash(&b));
    }
}
