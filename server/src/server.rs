//! A running server: two ports, one service, one database.

use crate::config::Config;
use crate::service::Service;
use crate::{grpc, rest};
use anyhow::Context;
use std::fs::{File, TryLockError};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use store::{Store, StoreOptions};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

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
        config.validate()?;
        let lock = lock_folder(&config.data_dir)?;
        let store = open_store(&config).await?;
        let grpc_listener = listen("grpc_addr", config.grpc_addr).await?;
        let http_listener = listen("http_addr", config.http_addr).await?;
        let (grpc_addr, http_addr) = (grpc_listener.local_addr()?, http_listener.local_addr()?);
        let grace = config.shutdown_grace();
        let service = Arc::new(Service::new(Arc::new(config), store.clone()).await?);

        let closing = CancellationToken::new();
        let grpc = grpc::serve(service.clone(), grpc_listener, http_addr.port(), closing.clone());
        let http = rest::serve(rest::App::new(service.clone()), http_listener, closing.clone());
        let tasks = vec![("gRPC", tokio::spawn(grpc)), ("HTTP", tokio::spawn(http))];
        tracing::info!(%grpc_addr, %http_addr, "serving gRPC on {grpc_addr} and HTTP on {http_addr}");
        Ok(Running { grpc_addr, http_addr, service, store, closing, tasks, grace, _lock: lock })
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
    closing: CancellationToken,
    tasks: Vec<Serving>,
    grace: Duration,
    /// Held as long as the server runs.
    _lock: File,
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

    /// Stops accepting, ends the streams, waits until every session is saved, and closes the database, all
    /// within the configured grace period.
    pub async fn shutdown(self) -> Shutdown {
        let Self { service, store, closing, tasks, grace, _lock, .. } = self;
        tracing::info!("shutting down: no new connections, streams end, sessions are saved");
        closing.cancel();
        let orderly = async {
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

/// Makes the data folder and locks it: two servers on one database would each believe to own its sessions.
fn lock_folder(folder: &Path) -> anyhow::Result<File> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let path = folder.join(LOCK_FILE);
    let file = File::create(&path).with_context(|| format!("cannot make the file {}", path.display()))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => {
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
    let _lock = lock_folder(&config.data_dir)?;
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
