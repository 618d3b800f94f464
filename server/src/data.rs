//! The folder of the database: whose it is, and how the database in it is opened.

use crate::config::Config;
use anyhow::Context;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use store::{Store, StoreOptions};

/// Name of the database in the data folder.
pub const DATABASE_FILE: &str = "monoslam.sqlite";

/// Locked in the data folder by the server that uses it.
const LOCK_FILE: &str = "monoslam.lock";

/// What the server of the folder is called among others.
const NAME_FILE: &str = "monoslam.name";

/// The database file of a configuration, where it names no other database.
pub fn database_of(config: &Config) -> PathBuf {
    config.data_dir.join(DATABASE_FILE)
}

/// Held by who uses a data folder: two servers on one database would each believe to own its sessions.
pub struct DataLock {
    _folder: File,
    _database: Option<File>,
}

impl DataLock {
    /// Makes the data folder and locks it, and the database in it, if there is one: the lock's own file may
    /// have been removed. SQLite's locks are of another kind and go beside this one.
    ///
    /// # Errors
    /// If another server uses it, or a file cannot be made.
    pub fn take(folder: &Path) -> anyhow::Result<Self> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let path = folder.join(LOCK_FILE);
        let is_new = !path.exists();
        let file = File::create(&path).with_context(|| format!("cannot make the file {}", path.display()))?;
        if is_new {
            give_to_owner_of(folder, &path);
        }
        lock(&file, &path)?;
        let mut taken = Self { _folder: file, _database: None };
        if folder.join(DATABASE_FILE).exists() {
            taken.lock_database(folder)?;
        }
        Ok(taken)
    }

    /// Locks the database, unless that was done already. Not to be given up before the database is closed:
    /// with any of its descriptors a process loses SQLite's locks.
    ///
    /// # Errors
    /// As [`Self::take`].
    pub fn lock_database(&mut self, folder: &Path) -> anyhow::Result<()> {
        if self._database.is_none() {
            let path = folder.join(DATABASE_FILE);
            let file = File::open(&path).with_context(|| format!("cannot open {}", path.display()))?;
            lock(&file, &path)?;
            self._database = Some(file);
        }
        Ok(())
    }
}

/// What the server of a data folder is called among others on one database: the same at each start, so that
/// it takes up at once what it had when it was killed. To be asked by who holds the folder's lock.
///
/// # Errors
/// If the folder cannot be read or written.
pub fn server_name(folder: &Path) -> anyhow::Result<String> {
    let path = folder.join(NAME_FILE);
    if let Ok(name) = std::fs::read_to_string(&path)
        && !name.trim().is_empty()
    {
        return Ok(name.trim().to_owned());
    }
    let machine =
        hostname::get().map_or_else(|_| "server".into(), |name| name.to_string_lossy().into_owned());
    let name = format!("{machine}-{:032x}", rand::random::<u128>());
    std::fs::write(&path, &name).with_context(|| format!("cannot write the file {}", path.display()))?;
    Ok(name)
}

/// Gives a file that was made by hand, as by the administrator, to whom its folder belongs, so that the
/// server can use it. Who may not give it away owns it.
pub fn give_to_owner_of(folder: &Path, file: &Path) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        if let Ok(owner) = folder.metadata() {
            let _ = std::os::unix::fs::chown(file, Some(owner.uid()), Some(owner.gid()));
        }
    }
}

fn lock(file: &File, path: &Path) -> anyhow::Result<()> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => {
            let folder = path.parent().unwrap_or(path);
            anyhow::bail!("another server uses the data in {}", folder.display())
        }
        Err(TryLockError::Error(error)) => {
            Err(error).with_context(|| format!("cannot lock {}", path.display()))
        }
    }
}

/// Opens the database of a configuration; its folder must be there.
///
/// # Errors
/// If the database cannot be opened.
pub async fn open_store(config: &Config) -> anyhow::Result<Store> {
    let store = open_database(config).await?.with_objects(config.storage.objects()?);
    let n_objects = store.n_image_objects().await?;
    if n_objects > 0 && config.storage.objects.is_none() {
        tracing::error!("{n_objects} images lie in an object store, and storage.objects names none");
    }
    Ok(store)
}

async fn open_database(config: &Config) -> anyhow::Result<Store> {
    let options = StoreOptions { max_bytes: config.limits.max_database_bytes, ..config.storage.options() };
    if let Some(url) = &config.storage.url {
        return Store::connect(url, options).await.context("storage.url: the database cannot be used");
    }
    let path = database_of(config);
    Store::open(&path, options).await.with_context(|| format!("cannot open the database {}", path.display()))
}

/// As [`open_store`], also while a server uses the database; makes folder and database where there are none.
///
/// # Errors
/// If the database cannot be opened.
pub async fn open_store_beside(config: &Config) -> anyhow::Result<Store> {
    if let Some(url) = &config.storage.url {
        let opened = Store::connect_beside(url, config.storage.options()).await;
        let opened = opened.context("storage.url: the database cannot be used")?;
        return Ok(opened.with_objects(config.storage.objects()?));
    }
    let folder = &config.data_dir;
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let path = folder.join(DATABASE_FILE);
    let opened = Store::open_beside(&path, StoreOptions::default()).await;
    opened.with_context(|| format!("cannot open the database {}", path.display()))
}
