//! A running server: two ports, one service, one database.

use crate::config::Config;
use crate::connections::{Certificates, Meter, Opening, Table, raise_file_limit};
use crate::current::Changes;
use crate::data::{DataLock, open_store, server_name};
use crate::relay::Relay;
use crate::service::Service;
use crate::session::keep;
use crate::soundness::Soundness;
use crate::{grpc, rest, telemetry};
use anyhow::Context;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use store::{Collected, Store, TokenRecord};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::{CancellationToken, DropGuard};

/// How often it is looked for objects that no image is in any more: the names of all are listed, a thousand
/// to a request.
const ORPHANS_EVERY: Duration = Duration::from_secs(3600);

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
        let (closing, ended) = (CancellationToken::new(), CancellationToken::new());
        if store.path().is_some() {
            lock.lock_database(&config.data_dir)?;
        }
        let grpc_listener = listen("grpc_addr", config.grpc_addr).await?;
        let http_listener = listen("http_addr", config.http_addr).await?;
        let (grpc_addr, http_addr) = (grpc_listener.local_addr()?, http_listener.local_addr()?);
        let lease = config.fleet.lease();
        let store = match store.path() {
            Some(_) => store,
            None => {
                let name = server_name(&config.data_dir)?;
                store.owned_by(config.fleet.owner(name, grpc_addr, http_addr, tls.is_some()), lease)
            }
        };
        let grace = config.shutdown_grace();
        let table = Table::new(config.connections.clone(), max_files);
        let soundness = Soundness::look(&config.storage, &store, &closing).await;
        let service = Arc::new(Service::of_sound(Arc::new(config), store.clone(), soundness).await?);
        if let Some(guest) = guest {
            service.access().keys().admit_guest(guest);
        }
        let reach = [grpc_addr, http_addr].into_iter().find(|addr| !addr.ip().to_canonical().is_loopback());
        check_reach(&service, reach)?;

        tokio::spawn(service.access().clone().look_after(closing.clone()));
        let (keeping, kept, gone) = (service.clone(), store.clone(), ended.clone());
        tokio::spawn(async move { gone.run_until_cancelled(keep(keeping.registry(), &kept, lease)).await });
        if service.config().storage.objects.is_some() {
            let hours = service.config().storage.orphans_after_h;
            let (store, gone) = (store.clone(), closing.clone());
            tokio::spawn(async move { gone.run_until_cancelled(collect_orphans(store, hours)).await });
        }
        tokio::spawn(table.clone().look_after(closing.clone(), ended.clone()));
        if let Some(certificates) = &tls {
            tokio::spawn(certificates.clone().look_after(closing.clone()));
        }
        let max_bytes = service.config().limits.max_message_bytes;
        let meter = Meter { budget: service.budget().clone(), max_bytes };
        let opening =
            |listener| Opening { listener, tls: tls.clone(), table: table.clone(), meter: meter.clone() };
        let relay = Relay::new(service.clone(), store.clone(), closing.clone())?;
        let calls = grpc::for_pages(service.clone(), relay.clone());
        let http_relay = relay.clone();
        let grpc =
            grpc::serve(service.clone(), relay, opening(grpc_listener), http_addr.port(), closing.clone());
        let app = rest::App::new(service.clone());
        let http = rest::serve(app, calls, http_relay, opening(http_listener), closing.clone());
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

    /// Takes over what differs between the configuration as it was read before and as it is read now, as far
    /// as that can change while the server runs, and logs what does and what does not.
    pub fn reconfigure(&self, before: &Config, now: &Config) {
        let changes = match self.service.reconfigure(before, now) {
            Ok(changes) => changes,
            Err(error) => return tracing::error!("the configuration from before holds: {error:#}"),
        };
        telemetry::refilter_log(&self.service.config());
        let Changes { now, after_restart } = &changes;
        if !now.is_empty() {
            tracing::info!("the configuration has changed: {}", now.join(", "));
        }
        if !after_restart.is_empty() {
            let fields = after_restart.join(", ");
            tracing::warn!("changed, but held only once the server is started again: {fields}");
        }
    }

    /// Reads again what can change while the server runs besides its configuration: certificates and tokens.
    pub async fn reload(&self) {
        if let Some(certificates) = &self.tls {
            certificates.reload();
        }
        if let Err(error) = self.service.access().keys().refresh().await {
            tracing::error!("the tokens cannot be read, those from before hold: {error}");
        }
    }

    /// Stops accepting, ends the streams, waits until every session is saved, and closes the database, all
    /// within the configured grace period. Where there are other servers, sessions are handed over to them
    /// first, while this one still takes connections and passes on.
    pub async fn shutdown(self) -> Shutdown {
        let Self { service, store, closing, tasks, grace, _lock, _ended, .. } = self;
        let begun = tokio::time::Instant::now();
        hand_over(&service, &store, grace / 2).await;
        tracing::info!("shutting down: no new connections, streams end, sessions are saved");
        closing.cancel();
        let orderly = async {
            // Operations hold their sessions.
            service.operations().shut_down().await;
            service.registry().shut_down().await;
            tracing::info!("every session is saved");
            if let Err(error) = store.withdraw().await {
                tracing::warn!("other servers believe for a while that this one is there: {error}");
            }
            end_connections(tasks, grace / 2).await;
            if let Err(error) = store.close().await {
                tracing::error!("the database did not close well: {error}");
            }
        };
        if tokio::time::timeout_at(begun + grace, orderly).await.is_ok() {
            tracing::info!("shut down, with everything saved");
            return Shutdown::Complete;
        }
        tracing::warn!("the grace period of {grace:?} ran out: what was still running is abandoned");
        Shutdown::Abandoned
    }
}

/// Removes objects of the object store, now and then, that no image is in any more.
async fn collect_orphans(store: Store, after_hours: u32) {
    loop {
        tokio::time::sleep(ORPHANS_EVERY).await;
        match store.collect_orphans(after_hours.into()).await {
            Ok(Collected { n_objects, n_removed, n_removed_bytes }) => tracing::info!(
                "{n_removed} of {n_objects} objects, {n_removed_bytes} bytes, had no image any more and were removed"
            ),
            Err(error) => tracing::warn!("the object store cannot be cleared of what is not wanted: {error}"),
        }
    }
}

/// Hands the sessions over to other servers, if there are any; what takes longer than `patience` ends with
/// the rest.
async fn hand_over(service: &Service, store: &Store, patience: Duration) {
    let handing_over = async {
        if store.servers().await.unwrap_or_default().len() < 2 {
            return;
        }
        tracing::info!("handing sessions over to the other servers, one by one");
        let leaving = store::Load { is_leaving: true, ..service.registry().own_load() };
        if let Err(error) = store.report(crate::session::VERSION, &leaving).await {
            tracing::warn!("other servers do not know that this one leaves: {error}");
        }
        service.registry().hand_over().await;
    };
    if tokio::time::timeout(patience, handing_over).await.is_err() {
        tracing::warn!("sessions could not be handed over one by one within {patience:?}");
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

async fn listen(field: &str, addr: SocketAddr) -> anyhow::Result<TcpListener> {
    TcpListener::bind(addr).await.with_context(|| format!("{field}: cannot listen on {addr}"))
}
