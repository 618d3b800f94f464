//! How the database is kept: what a commit outlives, and when damage is looked for.

use anyhow::ensure;
use serde::{Deserialize, Serialize};
use store::Durability;

/// How the database is kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StorageConfig {
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
            synchronous: Synchronous::default(),
            check_at_start: true,
            check_beside_above_bytes: 256 << 20,
        }
    }
}

impl StorageConfig {
    /// Checks that every field can be used.
    ///
    /// # Errors
    /// A sentence that names the field that cannot.
    pub fn validate(&self) -> anyhow::Result<()> {
        let bytes = self.check_beside_above_bytes;
        ensure!(
            bytes <= i64::MAX as u64,
            "storage.check_beside_above_bytes is {bytes} but must be below 2^63"
        );
        Ok(())
    }
}
