//! A running server: two ports, one service, one database.

use crate::config::Config;
use crate::connections::{Certificates, Opening, Table, raise_file_limit};
use crate::service::Service;
use crate::{grpc, rest};
use anyhow::Context;
use std::fs::{File, TryLockError};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use store::{Store, StoreOptions, TokenRecord};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::{CancellationToken, DropGuard};

/// Name of the database in the data folder.
pub const DATABASE_FILE: &str = "monoslam.sqlite";

/// Locked in the data folder by the server that uses it.
const LOCK_FILE: &str = "monoslam.lock";

/// Starts servers. See [`Server::start`].
#[derive(Debug)]
pub struct Server;

impl Server {
    /// Opens the database and both ports. The server serves until [`Running::shutdown`]; port 0 takes a free
    /// one, which [`Running`] tells.
    ///
    /// # Errors
    /// If the configuration cannot be used, the database cannot be opened, or a port is taken.
    pub async fn start(config: Config) -> anyhow::Result<Running> {
        Self::start_with_guest(config, None).await
    }

    /// As [`Self::start`], taking a token for as long as the server runs that is in no database.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub async fn start_with_guest(config: Config, guest: Option<TokenRecord>) -> anyhow::Result<Running> {
        config.validate()?;
        let mut lock = DataLock::take(&config.data_dir)?;
        let max_files = raise_file_limit();
        let tls = Certificates::of(&config.tls)?;
        let store = open_store(&config).await?;
        lock.lock_database(&config.data_dir)?;
        let grpc_listener = listen("grpc_addr", config.grpc_addr).await?;
        let http_listener = listen("http_addr", config.http_addr).await?;
        let (grpc_addr, http_addr) = (grpc_listener.local_addr()?, http_listener.local_addr()?);
        let grace = config.shutdown_grace();
        let table = Table::new(config.connections.clone(), max_files);
        let service = Arc::new(Service::new(Arc::new(config), store.clone()).await?);
        if let Some(guest) = guest {
            service.access().keys().admit_guest(guest);
        }
        let reach = [grpc_addr, http_addr].into_iter().find(|addr| !addr.ip().to_canonical().is_loopback());
        check_reach(&service, reach)?;

        let (closing, ended) = (CancellationToken::new(), CancellationToken::new());
        tokio::spawn(service.access().clone().look_after(closing.clone()));
        tokio::spawn(table.clone().look_after(closing.clone(), ended.clone()));
        if let Some(certificates) = &tls {
            tokio::spawn(certificates.clone().look_after(closing.clone()));
        }
        let opening = |listener| Opening { listener, tls: tls.clone(), table: table.clone() };
        let grpc = grpc::serve(service.clone(), opening(grpc_listener), http_addr.port(), closing.clone());
        let http = rest::serve(rest::App::new(service.clone()), opening(http_listener), closing.clone());
        let tasks = vec![("gRPC", tokio::spawn(grpc)), ("HTTP", tokio::spawn(http))];
        let encrypted = if tls.is_some() { ", encrypted" } else { "" };
        tracing::info!(%grpc_addr, %http_addr, "serving gRPC on {grpc_addr} and HTTP on {http_addr}{encrypted}");
        let ended = ended.drop_guard();
        Ok(Running {
            grpc_addr,
            http_addr,
            service,
            store,
            tls,
            closing,
            tasks,
            grace,
            _ended: ended,
            _lock: lock,
        })
    }
}

/// A server that serves. Dropping it leaves it serving until the runtime ends; call [`Running::shutdown`].
pub struct Running {
    /// Where gRPC listens.
    pub grpc_addr: SocketAddr,
    /// Where HTTP listens.
    pub http_addr: SocketAddr,
    service: Arc<Service>,
    store: Store,
    tls: Option<Arc<Certificates>>,
    closing: CancellationToken,
    tasks: Vec<Serving>,
    grace: Duration,
    _ended: DropGuard,
    /// Held as long as the server runs.
    _lock: DataLock,
}

/// How a shutdown went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shutdown {
    /// Everything ended by itself and is saved.
    Complete,
    /// The grace period ran out; what was running was abandoned. The database is whole, as of its last
    /// commits.
    Abandoned,
}

impl Running {
    /// The service behind both ports.
    pub fn service(&self) -> &Arc<Service> {
        &self.service
    }

    /// The database, for who looks after it; clients are answered by [`Self::service`].
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Reads again what can change while the server runs: certificates and tokens.
    pub async fn reload(&self) {
        if let Some(certificates) = &self.tls {
            certificates.reload();
        }
        if let Err(error) = self.service.access().keys().refresh().await {
            tracing::error!("the tokens cannot be read, those from before hold: {error}");
        }
    }

    /// Stops accepting, ends the streams, waits until every session is saved, and closes the database, all
    /// within the configured grace period.
    pub async fn shutdown(self) -> Shutdown {
        let Self { service, store, closing, tasks, grace, _lock, _ended, .. } = self;
        tracing::info!("shutting down: no new connections, streams end, sessions are saved");
        closing.cancel();
        let orderly = async {
            // Operations hold their sessions.
            service.operations().shut_down().await;
            service.registry().shut_down().await;
            tracing::info!("every session is saved");
            end_connections(tasks, grace / 2).await;
            if let Err(error) = store.close().await {
                tracing::error!("the database did not close well: {error}");
            }
        };
        if tokio::time::timeout(grace, orderly).await.is_ok() {
            tracing::info!("shut down, with everything saved");
            return Shutdown::Complete;
        }
        tracing::warn!("the grace period of {grace:?} ran out: what was still running is abandoned");
        Shutdown::Abandoned
    }
}

/// A server that everybody in a network reaches and nobody needs a token for is not started by accident.
fn check_reach(service: &Service, reach: Option<SocketAddr>) -> anyhow::Result<()> {
    let Some(addr) = reach else { return Ok(()) };
    let keys = service.access().keys();
    if !keys.is_open() || keys.has_guests() {
        return Ok(());
    }
    anyhow::ensure!(
        service.config().access.insecure,
        "{addr} is reached from other machines, and there are no tokens yet, so that everybody there could read, \
         change and delete everything: make one with `monoslam-server token create NAME --role writer`, or say \
         --insecure if that is what you want"
    );
    tracing::warn!(
        "INSECURE: everybody who reaches {addr} can read, change and delete every session; \
         `monoslam-server token create` makes that end"
    );
    Ok(())
}

type Serving = (&'static str, JoinHandle<anyhow::Result<()>>);

/// Waits for answers that are still being read, but not for clients that have stopped reading.
async fn end_connections(tasks: Vec<Serving>, patience: Duration) {
    let deadline = tokio::time::Instant::now() + patience;
    for (name, mut task) in tasks {
        match tokio::time::timeout_at(deadline, &mut task).await {
            Ok(Ok(Ok(()))) => {}
            Ok(Ok(Err(error))) => tracing::error!("serving {name} failed: {error:#}"),
            Ok(Err(error)) => tracing::error!("serving {name} failed: {error}"),
            Err(_elapsed) => {
                tracing::warn!("{name} clients that do not read their answers are left behind");
                task.abort();
            }
        }
    }
}

/// Held by who uses a data folder: two servers on one database would each believe to own its sessions.
struct DataLock {
    _folder: File,
    _database: Option<File>,
}

impl DataLock {
    /// Makes the data folder and locks it, and the database in it, if there is one: the lock's own file may
    /// have been removed. SQLite's locks are of another kind and go beside this one.
    fn take(folder: &Path) -> anyhow::Result<Self> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let path = folder.join(LOCK_FILE);
        let file = File::create(&path).with_context(|| format!("cannot make the file {}", path.display()))?;
        lock(&file, &path)?;
        let mut taken = Self { _folder: file, _database: None };
        if folder.join(DATABASE_FILE).exists() {
            taken.lock_database(folder)?;
        }
        Ok(taken)
    }

    /// Locks the database, unless that was done already. Not to be given up before the database is closed:
    /// with any of its descriptors a process loses SQLite's locks.
    fn lock_database(&mut self, folder: &Path) -> anyhow::Result<()> {
        if self._database.is_none() {
            let path = folder.join(DATABASE_FILE);
            let file = File::open(&path).with_context(|| format!("cannot open {}", path.display()))?;
            lock(&file, &path)?;
            self._database = Some(file);
        }
        Ok(())
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
    let path = config.data_dir.join(DATABASE_FILE);
    let options = StoreOptions { max_bytes: config.limits.max_database_bytes, ..StoreOptions::default() };
    Store::open(&path, options).await.with_context(|| format!("cannot open the database {}", path.display()))
}

/// As [`open_store`], also while a server uses the database; makes folder and database where there are none.
///
/// # Errors
/// If the database cannot be opened.
pub async fn open_store_beside(config: &Config) -> anyhow::Result<Store> {
    let folder = &config.data_dir;
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let path = folder.join(DATABASE_FILE);
    let opened = Store::open_beside(&path, StoreOptions::default()).await;
    opened.with_context(|| format!("cannot open the database {}", path.display()))
}

/// Opens the database of a configuration to read it; as it is, where it cannot be written. Whether that is
/// so.
///
/// # Errors
/// If the database cannot be opened.
pub async fn open_store_to_read(config: &Config) -> anyhow::Result<(Store, bool)> {
    let error = match open_store(config).await {
        Ok(store) => return Ok((store, false)),
        Err(error) => error,
    };
    if !error.downcast_ref::<store::StoreError>().is_some_and(store::StoreError::is_unwritable) {
        return Err(error);
    }
    let path = config.data_dir.join(DATABASE_FILE);
    let store = Store::open_unwritable(&path).await;
    Ok((store.with_context(|| format!("cannot open the database {}", path.display()))?, true))
}

/// Gives the room of deleted sessions back to the file system. Bytes of the file before and after.
///
/// # Errors
/// If a server uses the database, or there is no room beside it to write it anew.
pub async fn compact(config: &Config) -> anyhow::Result<[u64; 2]> {
    let _lock = DataLock::take(&config.data_dir)?;
    // The limit is of what sessions may fill, and not of the copy that is made meanwhile.
    let path = config.data_dir.join(DATABASE_FILE);
    let store = Store::open(&path, StoreOptions::default())
        .await
        .with_context(|| format!("cannot open the database {}", path.display()))?;
    let bytes = store.compact().await.context("the database cannot be written anew")?;
    store.close().await?;
    Ok(bytes)
}

async fn listen(field: &str, addr: SocketAddr) -> anyhow::Result<TcpListener> {
    TcpListener::bind(addr).await.with_context(|| format!("{field}: cannot listen on {addr}"))
}
