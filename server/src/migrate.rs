//! `monoslam-server migrate`: everything of one database into another.

use crate::data::{DATABASE_FILE, DataLock};
use crate::storage::StorageConfig;
use anyhow::{Context, bail, ensure};
use clap::Args;
use std::io::Write;
use std::path::Path;
use std::time::Duration;
use store::{Copied, Store, StoreOptions};

/// Sessions asked for at a time.
const PAGE_SIZE: u32 = 1000;

/// How long a statement may take: a table of a large session is read by one.
const STATEMENT_TIMEOUT: Duration = Duration::from_secs(3600);

/// Copies every session and token from one database into another, while no server uses either. Sessions are
/// compared row by row when they are written; those that are there already are left alone, so that a copy
/// that was interrupted is finished by the same command
#[derive(Debug, Args)]
pub struct MigrateCommand {
    /// Where from: `sqlite:FOLDER`, a server's data folder, or `postgres://USER@HOST/DATABASE`
    #[arg(long, value_name = "DATABASE")]
    from: String,
    /// Where to, in the same words; made if it is a folder that is not there
    #[arg(long, value_name = "DATABASE")]
    to: String,
    /// Bring images to this object store, `s3://BUCKET/PREFIX` or `file:///FOLDER`, as `storage.objects` has
    /// it; those that lie in one already must lie in this one
    #[arg(long, value_name = "URL")]
    objects: Option<String>,
}

/// A database that nobody else uses, as far as that can be known.
struct Alone {
    store: Store,
    /// Held as long as a file is used.
    _lock: Option<DataLock>,
}

impl MigrateCommand {
    /// Does it, and prints what came of each session to `out`.
    ///
    /// # Errors
    /// If a database cannot be used or is in use, or a session is there that is another.
    pub async fn run(&self, out: &mut impl Write) -> anyhow::Result<()> {
        ensure!(self.from != self.to, "--from and --to are the same");
        let from = open(&self.from, false).await.context("--from")?;
        let mut to = open(&self.to, true).await.context("--to")?;
        let storage = StorageConfig { objects: self.objects.clone(), ..StorageConfig::default() };
        to.store = to.store.with_objects(storage.objects().context("--objects")?);
        let n_tokens = to.store.copy_tokens(&from.store).await?;
        let (mut n_sessions, mut after) = (0, None);
        loop {
            let page = from.store.list_sessions(after.as_deref(), PAGE_SIZE).await?;
            for session in page.items {
                let copied = to.store.copy_session(&from.store, &session.id).await;
                let copied = copied.with_context(|| format!("session {:?}", session.id))?;
                let what = match copied {
                    Copied::Whole => "copied, and the same row by row",
                    Copied::Before => "is there already, the same row by row",
                };
                writeln!(out, "{}: {what}; keyframes: {}", session.id, session.counts.n_keyframes)?;
                n_sessions += 1;
            }
            after = page.next;
            if after.is_none() {
                break;
            }
        }
        to.store.close().await?;
        writeln!(out, "sessions: {n_sessions}, tokens: {n_tokens}")?;
        Ok(())
    }
}

async fn open(database: &str, make: bool) -> anyhow::Result<Alone> {
    let options = StoreOptions { statement_timeout: STATEMENT_TIMEOUT, ..StoreOptions::default() };
    if database.starts_with("postgres://") || database.starts_with("postgresql://") {
        let store = Store::connect(database, options).await.context("the database cannot be used")?;
        let n_leased = store.n_leased().await?;
        ensure!(n_leased == 0, "servers work with sessions of the database: {n_leased}; stop them before");
        return Ok(Alone { store, _lock: None });
    }
    let Some(folder) = database.strip_prefix("sqlite:").map(Path::new) else {
        bail!("sqlite:FOLDER or postgres://USER@HOST/DATABASE expected");
    };
    let file = folder.join(DATABASE_FILE);
    ensure!(make || file.exists(), "there is no database at {}", file.display());
    let mut lock = DataLock::take(folder)?;
    let opened = Store::open(&file, options).await;
    let store = opened.with_context(|| format!("cannot open the database {}", file.display()))?;
    lock.lock_database(folder)?;
    Ok(Alone { store, _lock: Some(lock) })
}
