//! Where the database is and how it is kept: what a commit outlives, and when damage is looked for.

use anyhow::{Context, ensure};
use serde::{Deserialize, Serialize};
use std::time::Duration;
use store::{Durability, ObjectOptions, Objects, StoreOptions};

/// Where the database is and how it is kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StorageConfig {
    /// A database of PostgreSQL, such as `postgres://monoslam@db.example/maps?sslmode=verify-full`; the
    /// password is better in `PGPASSWORD` or `~/.pgpass`. Default none: a file of SQLite in the data folder.
    pub url: Option<String>,
    /// Connections to PostgreSQL at most, half of them to write. Default 8: PostgreSQL takes 100 by default,
    /// for all servers together.
    pub n_connections: u32,
    /// Seconds to wait for a connection to PostgreSQL before the request is refused; what waits to be saved
    /// is tried again. Default 5.
    pub connect_timeout_s: u32,
    /// Seconds a statement may take in PostgreSQL. Default 30, a thousand times what any takes.
    pub statement_timeout_s: u32,
    /// Where images of keyframes are kept: `s3://bucket/prefix`, with credentials and endpoint from the
    /// environment (`AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT_URL`, …), or
    /// `file:///folder`. It must be this database's alone. Default none: in the database, as are those from
    /// before.
    pub objects: Option<String>,
    /// Seconds an image may take there or back, with what is tried again. Default 20.
    pub objects_timeout_s: u32,
    /// Hours after which an object that no image is in any more is removed. Default 24; at least 2, which
    /// the machines' clocks may be apart.
    pub orphans_after_h: u32,
    /// What a commit outlives. Default `full`.
    pub synchronous: Synchronous,
    /// Whether damaged pages are looked for when the server starts. Default true: damage that is found years
    /// later is in every backup by then.
    pub check_at_start: bool,
    /// Databases of more bytes than this are looked at beside what the server does, and not before it begins.
    /// Default 256 MiB, which a slow disk of 100 MB a second reads in under three seconds.
    pub check_beside_above_bytes: u64,
}

/// SQLite's `synchronous`, for a database with a write-ahead log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Synchronous {
    /// The end of the machine at any moment: each commit waits until the disk has it, so that what is
    /// acknowledged is there after a power cut.
    #[default]
    Full,
    /// The end of the process at any moment. When the machine stops, the last seconds may be lost, although
    /// they were acknowledged; the database stays whole all the same.
    Normal,
}

impl From<Synchronous> for Durability {
    fn from(synchronous: Synchronous) -> Self {
        match synchronous {
            Synchronous::Full => Self::PowerLoss,
            Synchronous::Normal => Self::ProcessEnd,
        }
    }
}

impl Default for StorageConfig {
    fn default() -> Self {
        Self {
            url: None,
            n_connections: 8,
            connect_timeout_s: 5,
            statement_timeout_s: 30,
            objects: None,
            objects_timeout_s: 20,
            orphans_after_h: 24,
            synchronous: Synchronous::default(),
            check_at_start: true,
            check_beside_above_bytes: 256 << 20,
        }
    }
}

impl StorageConfig {
    /// How the store uses the database.
    pub fn options(&self) -> StoreOptions {
        let n_writers = (self.n_connections / 2).max(1);
        StoreOptions {
            durability: self.synchronous.into(),
            n_writers,
            // SQLite's own default where there is no server to share.
            n_readers: match self.url {
                Some(_) => self.n_connections.saturating_sub(n_writers).max(1),
                None => StoreOptions::default().n_readers,
            },
            connect_timeout: Duration::from_secs(self.connect_timeout_s.into()),
            statement_timeout: Duration::from_secs(self.statement_timeout_s.into()),
            ..StoreOptions::default()
        }
    }

    /// Where images are kept, if not in the database.
    ///
    /// # Errors
    /// If it cannot be used.
    pub fn objects(&self) -> anyhow::Result<Option<Objects>> {
        let Some(url) = &self.objects else { return Ok(None) };
        let timeout = Duration::from_secs(self.objects_timeout_s.into());
        let opened = Objects::open(url, ObjectOptions { timeout });
        Ok(Some(opened.context("storage.objects")?))
    }

    /// Checks that every field can be used.
    ///
    /// # Errors
    /// A sentence that names the field that cannot.
    pub fn validate(&self) -> anyhow::Result<()> {
        let counts = [
            ("storage.n_connections", self.n_connections),
            ("storage.connect_timeout_s", self.connect_timeout_s),
            ("storage.statement_timeout_s", self.statement_timeout_s),
            ("storage.objects_timeout_s", self.objects_timeout_s),
        ];
        for (field, count) in counts {
            ensure!((1..=10_000).contains(&count), "{field} is {count} but must be 1 to 10000");
        }
        let hours = self.orphans_after_h;
        ensure!((2..=100_000).contains(&hours), "storage.orphans_after_h is {hours} but must be 2 to 100000");
        if let Some(url) = &self.objects {
            let is_known = url.starts_with("s3://") || url.starts_with("file:///");
            ensure!(is_known, "storage.objects must begin with s3:// or file:///");
        }
        if let Some(url) = &self.url {
            let is_postgres = url.starts_with("postgres://") || url.starts_with("postgresql://");
            // Without the URL: it may hold a password.
            ensure!(is_postgres, "storage.url must begin with postgres://");
        }
        let bytes = self.check_beside_above_bytes;
        ensure!(
            bytes <= i64::MAX as u64,
            "storage.check_beside_above_bytes is {bytes} but must be below 2^63"
        );
        Ok(())
    }
}
