//! The configuration as it is now: some of it may change while the server runs.

use crate::config::Config;
use anyhow::Context;
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

/// Fields, or tables of them, that take effect while the server runs.
const CHANGEABLE: [&str; 6] =
    ["log_filter", "limits.max_sessions", "limits.max_image_pixels", "sessions", "quotas", "access.hosts"];

/// Fields in these tables that do not: they size what is made once.
const FIXED: [&str; 3] = ["sessions.n_localizations", "sessions.n_cores", "quotas.check_s"];

/// Takes effect where there were any when the server started: without, nothing is said to foreign pages.
const CORS_ORIGINS: &str = "access.cors_origins";

/// See the module's documentation. Clones share it.
#[derive(Clone, Debug)]
pub struct Current(Arc<RwLock<Arc<Config>>>);

/// What came of a changed configuration: names of fields.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// They hold from now on.
    pub now: Vec<String>,
    /// They hold once the server is started again.
    pub after_restart: Vec<String>,
}

impl Current {
    /// The configuration that the server starts with.
    pub fn new(config: Arc<Config>) -> Self {
        Self(Arc::new(RwLock::new(config)))
    }

    /// As it is now.
    pub fn get(&self) -> Arc<Config> {
        self.0.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Takes over what differs between the configuration as it was read `before` and as it is read now, as
    /// far as that can change.
    ///
    /// # Errors
    /// Never, unless a field cannot be written as it was read.
    pub fn change(&self, before: &Config, now: &Config) -> anyhow::Result<Changes> {
        let current = self.get();
        let mut merged = serde_json::to_value(&*current)?;
        let (fields_before, fields_now) = (fields_of(before)?, fields_of(now)?);
        let mut changes = Changes::default();
        for (name, value) in fields_now {
            if fields_before.get(&name) == Some(&value) {
                continue;
            }
            let is_cors = name == CORS_ORIGINS && !current.access.cors_origins.is_empty();
            if !(is_changeable(&name) || is_cors) {
                changes.after_restart.push(name);
                continue;
            }
            let pointer = format!("/{}", name.replace('.', "/"));
            *merged.pointer_mut(&pointer).with_context(|| format!("{name} is no field"))? = value;
            changes.now.push(name);
        }
        let merged = serde_json::from_value(merged).context("the configuration cannot be changed")?;
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(merged);
        Ok(changes)
    }
}

fn is_changeable(name: &str) -> bool {
    let is_within =
        |table: &&str| name == *table || name.strip_prefix(*table).is_some_and(|rest| rest.starts_with('.'));
    CHANGEABLE.iter().any(is_within) && !FIXED.contains(&name)
}

/// The value of each field by its name with those of the tables around it.
///
/// # Errors
/// Never, unless a field cannot be written.
pub fn fields_of(config: &Config) -> anyhow::Result<BTreeMap<String, Value>> {
    let mut fields = BTreeMap::new();
    let mut tables = vec![(String::new(), serde_json::to_value(config)?)];
    while let Some((name, value)) = tables.pop() {
        match value {
            Value::Object(table) => {
                let inner =
                    |(key, value)| (if name.is_empty() { key } else { format!("{name}.{key}") }, value);
                tables.extend(table.into_iter().map(inner));
            }
            value => drop(fields.insert(name, value)),
        }
    }
    Ok(fields)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_can_change_does_and_the_rest_is_named() {
        let before = Config::default();
        // As it runs: a part was changed after it was read, and stays.
        let mut running = before.clone();
        running.tls.cert = Some("made.pem".into());
        let current = Current::new(Arc::new(running));
        let mut now = before.clone();
        now.limits.max_sessions = 7;
        now.quotas.max_streams = None;
        now.sessions.idle_unload_s = 0.1 + 0.2;
        now.sessions.n_localizations = 9;
        now.log_filter = Some("debug".into());
        now.access.hosts = vec!["maps.example".into()];
        now.access.cors_origins = vec!["https://maps.example".into()];
        now.http_addr = "127.0.0.1:9".parse().unwrap();
        let changes = current.change(&before, &now).unwrap();
        let expected = [
            "access.hosts",
            "limits.max_sessions",
            "log_filter",
            "quotas.max_streams",
            "sessions.idle_unload_s",
        ];
        assert_eq!(changes.now, expected);
        assert_eq!(changes.after_restart, ["access.cors_origins", "http_addr", "sessions.n_localizations"]);
        let (got, old) = (current.get(), Config::default());
        assert_eq!((got.limits.max_sessions, got.quotas.max_streams), (7, None));
        assert_eq!(
            (got.sessions.idle_unload_s, got.sessions.n_localizations),
            (0.1 + 0.2, old.sessions.n_localizations)
        );
        assert_eq!((got.http_addr, got.tls.cert.clone()), (old.http_addr, Some("made.pem".into())));
        assert_eq!(current.change(&now, &now).unwrap(), Changes::default());
    }
}
