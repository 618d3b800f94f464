//! What is done with a database by hand: looked at, copied, put back, compacted.

use crate::config::Config;
use crate::data::{DataLock, database_of, give_to_owner_of, open_store_beside};
use anyhow::{Context, ensure};
use clap::Subcommand;
use indicatif::{ProgressBar, ProgressStyle};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use store::{Store, StoreOptions, Verified};
use tempfile::NamedTempFile;

/// How often the progress of a copy is looked at.
const PROGRESS_EVERY: Duration = Duration::from_millis(200);

/// What to do with a database.
#[derive(Debug, Subcommand)]
pub enum UpkeepCommand {
    /// Checks that the database is whole and that its maps make sense, also while a server runs, without
    /// changing anything; exits with 1 if not
    Check,
    /// Checks a backup, or any other database, in the same way
    Verify {
        /// The database file
        file: PathBuf,
    },
    /// Writes the database as of its last commit to a file, also while a server runs, and verifies the file
    Backup {
        /// Where to; it is there under this name only once it is whole and on the disk
        file: PathBuf,
        /// Replace the file if there is one
        #[arg(long)]
        force: bool,
    },
    /// Puts a backup into the data folder, while no server runs
    Restore {
        /// The backup; it stays as it is
        file: PathBuf,
        /// Do so where there is a database: that one is kept beside it, under another name
        #[arg(long)]
        force: bool,
    },
    /// Gives the room of deleted sessions back to the file system, while no server runs; needs as much room
    /// beside the database as it has of data
    Compact,
}

impl UpkeepCommand {
    /// Does it, and prints the outcome to `out`.
    ///
    /// # Errors
    /// If it cannot be done, or what was looked at is not whole.
    pub async fn run(&self, config: &Config, out: &mut impl Write) -> anyhow::Result<()> {
        match self {
            Self::Check if config.storage.url.is_some() && config.storage.objects.is_some() => {
                check_objects(config, out).await
            }
            Self::Check => {
                let file = file_of(config)?;
                ensure!(file.exists(), "there is no database at {}", file.display());
                verify(config, &file, out).await
            }
            Self::Verify { file } => {
                ensure!(file.exists(), "there is no file {}", file.display());
                verify(config, file, out).await
            }
            Self::Backup { file, force } => back_up(config, file, *force, out).await,
            Self::Restore { file, force } => restore(config, file, *force, out).await,
            Self::Compact => compact(config, out).await,
        }
    }
}

/// The file that is looked after.
fn file_of(config: &Config) -> anyhow::Result<PathBuf> {
    ensure!(
        config.storage.url.is_none(),
        "the database is one of PostgreSQL (storage.url), which has its own programs for this: pg_dump or \
         pg_basebackup and pg_restore, pg_amcheck; room is given back by its autovacuum"
    );
    Ok(database_of(config))
}

/// Looks whether the images are there that a database of PostgreSQL has in an object store.
async fn check_objects(config: &Config, out: &mut impl Write) -> anyhow::Result<()> {
    let store = open_store_beside(config).await?;
    let findings = store.check_objects().await?;
    for finding in &findings {
        writeln!(out, "{finding}")?;
    }
    ensure!(findings.is_empty(), "{} problems found in the object store", findings.len());
    writeln!(out, "images in the object store: {}, all there", store.n_image_objects().await?)?;
    writeln!(out, "the database itself is looked at by PostgreSQL's own programs, such as pg_amcheck")?;
    store.close().await?;
    Ok(())
}

async fn verify(config: &Config, file: &Path, out: &mut impl Write) -> anyhow::Result<()> {
    let verified = Store::verify_with(file, config.storage.objects()?).await;
    let verified = verified.with_context(|| format!("{} cannot be checked", file.display()))?;
    let Verified {
        findings,
        n_sessions,
        schema,
        are_sessions_checked,
        n_log_bytes_left_out,
        n_image_objects,
    } = &verified;
    if *n_log_bytes_left_out > 0 {
        let log = format!("without the {n_log_bytes_left_out} bytes in its log");
        writeln!(out, "{} cannot be written and is read as it is, {log}", file.display())?;
    }
    for finding in findings {
        writeln!(out, "{finding}")?;
    }
    ensure!(findings.is_empty(), "{} problems found in {}", findings.len(), file.display());
    if *n_image_objects > 0 && config.storage.objects.is_none() {
        writeln!(
            out,
            "not looked for, since storage.objects names no object store: {n_image_objects} images"
        )?;
    }
    if *are_sessions_checked {
        writeln!(out, "{} is whole; sessions: {n_sessions}", file.display())?;
    } else {
        let reason = format!(
            "its schema is version {schema}, so that its sessions ({n_sessions}) can be checked only once a server has \
             brought it up to {}",
            Store::schema_version()
        );
        writeln!(out, "the file {} is whole; {reason}", file.display())?;
    }
    Ok(())
}

async fn back_up(config: &Config, file: &Path, force: bool, out: &mut impl Write) -> anyhow::Result<()> {
    let from = file_of(config)?;
    ensure!(from.exists(), "there is no database at {}", from.display());
    ensure!(
        force || !file.exists(),
        "there is a file {}: give another name, or --force to replace it",
        file.display()
    );
    if let (Ok(from), Ok(file)) = (from.canonicalize(), file.canonicalize()) {
        ensure!(from != file, "{} is the database itself", file.display());
    }
    let folder = folder_of(file);
    let copy = empty_file_in(folder)?;
    let n_bytes = Store::used_bytes(&from).await.context("the database cannot be read")?;
    let copying = Store::back_up(&from, copy.path());
    let copied = shown("copying", copy.path(), n_bytes, copying).await;
    copied.with_context(|| format!("{} cannot be copied", from.display()))?;
    let n_image_objects = require_whole(copy.path(), "the copy").await?;
    let put = if force { copy.persist(file).map(drop) } else { copy.persist_noclobber(file).map(drop) };
    put.with_context(|| format!("cannot give the copy its name {}", file.display()))?;
    sync_folder(folder)?;
    let mb = file.metadata().map_or(0.0, |file| file.len() as f64 * 1e-6);
    writeln!(out, "{}: {mb:.1} MB, verified", file.display())?;
    if n_image_objects > 0 {
        writeln!(
            out,
            "not in it, but in the object store, which needs a backup of its own: {n_image_objects} images"
        )?;
    }
    Ok(())
}

async fn restore(config: &Config, file: &Path, force: bool, out: &mut impl Write) -> anyhow::Result<()> {
    ensure!(file.exists(), "there is no file {}", file.display());
    let database = file_of(config)?;
    let _lock = DataLock::take(&config.data_dir)?;
    ensure!(
        force || !database.exists(),
        "there is a database at {}: give --force to put the backup in its place, which keeps that one beside it",
        database.display()
    );
    // Beside the database, so that giving it its name is one step.
    let copy = empty_file_in(&config.data_dir)?;
    let n_bytes = file.metadata().map_or(0, |file| file.len());
    let copied = shown("copying", copy.path(), n_bytes, copy_whole(file, copy.path())).await;
    copied.with_context(|| format!("{} cannot be copied", file.display()))?;
    require_whole(copy.path(), &file.display().to_string()).await?;
    give_to_owner_of(&config.data_dir, copy.path());
    if let Some(kept) = set_aside(&database)? {
        writeln!(out, "the database that was there is kept as {}", kept.display())?;
    }
    copy.persist_noclobber(&database)
        .with_context(|| format!("cannot give the copy its name {}", database.display()))?;
    sync_folder(&config.data_dir)?;
    writeln!(out, "{} is restored from {}", database.display(), file.display())?;
    Ok(())
}

/// Copies a database, with what is in its log.
async fn copy_whole(from: &Path, into: &Path) -> anyhow::Result<()> {
    if log_of(from).metadata().is_ok_and(|log| log.len() > 0) {
        return Ok(Store::back_up(from, into).await?);
    }
    let (from, into) = (from.to_owned(), into.to_owned());
    let copy = move || -> std::io::Result<()> {
        // The file is there, so that its permissions stay.
        let mut copy = File::options().write(true).truncate(true).open(&into)?;
        std::io::copy(&mut File::open(&from)?, &mut copy)?;
        copy.sync_all()
    };
    Ok(tokio::task::spawn_blocking(copy).await??)
}

/// Gives a database, if there is one, a name beside its own. Its log goes first: were it left behind, it
/// would be taken for that of the next.
fn set_aside(database: &Path) -> anyhow::Result<Option<PathBuf>> {
    if !database.exists() {
        return Ok(None);
    }
    let named = |n: u32| PathBuf::from(format!("{}.before-restore-{n}", database.display()));
    let kept = (1..=u32::MAX).map(named).find(|path| !path.exists() && !log_of(path).exists());
    let kept = kept.context("there is no name left to keep the database under")?;
    for (from, to) in [(log_of(database), log_of(&kept)), (database.to_owned(), kept.clone())] {
        if from.exists() {
            std::fs::rename(&from, &to)
                .with_context(|| format!("cannot keep {} as {}", from.display(), to.display()))?;
        }
    }
    // What processes shared of it says nothing about another database.
    let _ = std::fs::remove_file(format!("{}-shm", database.display()));
    Ok(Some(kept))
}

fn log_of(database: &Path) -> PathBuf {
    PathBuf::from(format!("{}-wal", database.display()))
}

/// Fails if a copy is damaged; how many images are not in it, but in an object store.
async fn require_whole(copy: &Path, name: &str) -> anyhow::Result<u64> {
    let verified = Store::verify(copy).await.with_context(|| format!("{name} cannot be verified"))?;
    if let Some(first) = verified.findings.first() {
        let n = verified.findings.len();
        anyhow::bail!("{name} is damaged, nothing was put in place: {first} ({n} problems)");
    }
    Ok(verified.n_image_objects)
}

/// An empty file, for its owner alone, that is gone again unless it is given a name.
fn empty_file_in(folder: &Path) -> anyhow::Result<NamedTempFile> {
    let made = tempfile::Builder::new().prefix(".monoslam-").suffix(".partial").tempfile_in(folder);
    made.with_context(|| format!("cannot make a file in {}", folder.display()))
}

fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The names in a folder are on the disk when this returns.
fn sync_folder(folder: &Path) -> anyhow::Result<()> {
    let synced = File::open(folder).and_then(|folder| folder.sync_all());
    synced.with_context(|| format!("the folder {} cannot be brought to the disk", folder.display()))
}

/// Does the work, and shows on a terminal how far the file has grown. Whoever interrupts it ends it, and
/// nothing is left of the file.
async fn shown<T, E: Into<anyhow::Error>>(
    what: &'static str,
    file: &Path,
    n_bytes: u64,
    work: impl Future<Output = Result<T, E>>,
) -> anyhow::Result<T> {
    let bar = ProgressBar::new(n_bytes).with_message(what);
    if let Ok(style) = ProgressStyle::with_template("{msg} {bar:30} {bytes} of {total_bytes}, {eta} left") {
        bar.set_style(style);
    }
    let interrupted = crate::shutdown::requested();
    tokio::pin!(work, interrupted);
    loop {
        tokio::select! {
            outcome = &mut work => {
                bar.finish_and_clear();
                return outcome.map_err(Into::into);
            }
            _ = &mut interrupted => anyhow::bail!("interrupted; nothing was put in place"),
            () = tokio::time::sleep(PROGRESS_EVERY) => {
                bar.set_position(file.metadata().map_or(0, |file| file.len()).min(n_bytes));
            }
        }
    }
}

async fn compact(config: &Config, out: &mut impl Write) -> anyhow::Result<()> {
    let file = file_of(config)?;
    ensure!(file.exists(), "there is no database at {}", file.display());
    let _lock = DataLock::take(&config.data_dir)?;
    // The limit is of what sessions may fill, and not of the copy that is made meanwhile.
    let store = Store::open(&file, StoreOptions::default())
        .await
        .with_context(|| format!("cannot open the database {}", file.display()))?;
    let [before, after] = store.compact().await.context("the database cannot be written anew")?;
    store.close().await?;
    let mb = |bytes: u64| bytes as f64 * 1e-6;
    writeln!(out, "{}: {:.1} MB before, {:.1} MB now", file.display(), mb(before), mb(after))?;
    Ok(())
}
