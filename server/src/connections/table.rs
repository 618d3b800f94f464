//! The connections there are, and the janitor that closes those that stand still.

use crate::network::{ConnectionConfig, span};
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// How often connections are looked at: a fifth of the shortest time limit that makes sense.
const JANITOR_EVERY: Duration = Duration::from_millis(200);

/// How long a connection that is asked to end may take to say so to its client.
const PARTING: Duration = Duration::from_secs(1);

/// See the module's documentation.
pub struct Table {
    limits: ConnectionConfig,
    max_total: usize,
    start: Instant,
    entries: Mutex<Entries>,
}

#[derive(Default)]
struct Entries {
    next_number: u64,
    all: HashMap<u64, Arc<Activity>>,
    per_address: HashMap<IpAddr, usize>,
}

/// What a connection is doing. Times are milliseconds since the table was made.
pub struct Activity {
    address: IpAddr,
    opened: u64,
    /// Since when there has been no request; the opening before the first.
    idle_since: AtomicU64,
    n_in_flight: AtomicU32,
    has_asked: AtomicBool,
    /// Since when the client has taken nothing of what is sent; 0 while it does.
    stalled_since: AtomicU64,
    /// When it was asked to end; 0 if it was not.
    parting_since: AtomicU64,
    /// It speaks another protocol now, which has time limits of its own.
    is_upgraded: AtomicBool,
    /// Cancelled to end the connection once its answers are sent.
    pub close: CancellationToken,
    /// Cancelled to drop it.
    pub drop: CancellationToken,
}

/// A connection's place in the table, until it is dropped.
pub struct Place {
    table: Arc<Table>,
    number: u64,
    activity: Arc<Activity>,
}

/// Why a connection is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Full {
    /// So many of this address are in use.
    OfAddress(usize),
    /// So many are in use.
    InAll(usize),
}

impl std::fmt::Display for Full {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::OfAddress(n) => {
                write!(f, "{n} connections of this address are in use, as many as this server takes of one")
            }
            Self::InAll(n) => write!(f, "{n} connections are in use, as many as this server takes"),
        }
    }
}

impl Table {
    /// No connections, where the process may open so many files.
    pub fn new(limits: ConnectionConfig, max_files: u64) -> Arc<Self> {
        let left = max_files.saturating_sub(limits.reserved_files).max(16);
        let max_total = limits.max_total.min(usize::try_from(left).unwrap_or(usize::MAX));
        if max_total < limits.max_total {
            tracing::warn!(
                "at most {max_total} connections are taken, not {}: the system lets this process open {max_files} \
                 files, of which {} are for the database",
                limits.max_total,
                limits.reserved_files
            );
        }
        Arc::new(Self { limits, max_total, start: Instant::now(), entries: Mutex::default() })
    }

    /// A place for a new connection, closing one that is idle where there is none.
    ///
    /// # Errors
    /// If every place is in use.
    pub fn admit(self: &Arc<Self>, address: IpAddr) -> Result<Place, Full> {
        let address = client_network(address);
        let mut entries = self.lock();
        if entries.per_address.get(&address).is_some_and(|n| *n >= self.limits.max_per_address)
            && !entries.evict(|activity| activity.address == address)
        {
            metrics::counter!("monoslam_connections_refused_total", "limit" => "address").increment(1);
            return Err(Full::OfAddress(self.limits.max_per_address));
        }
        if entries.all.len() >= self.max_total && !entries.evict(|_| true) {
            metrics::counter!("monoslam_connections_refused_total", "limit" => "total").increment(1);
            return Err(Full::InAll(self.max_total));
        }
        let now = self.now();
        let activity = Arc::new(Activity {
            address,
            opened: now,
            idle_since: AtomicU64::new(now),
            n_in_flight: AtomicU32::new(0),
            has_asked: AtomicBool::new(false),
            stalled_since: AtomicU64::new(0),
            parting_since: AtomicU64::new(0),
            is_upgraded: AtomicBool::new(false),
            close: CancellationToken::new(),
            drop: CancellationToken::new(),
        });
        let number = entries.next_number;
        entries.next_number += 1;
        entries.all.insert(number, activity.clone());
        *entries.per_address.entry(address).or_default() += 1;
        Ok(Place { table: self.clone(), number, activity })
    }

    /// Closes what stands still for too long, until `ended`; what is idle or stalls while the server shuts
    /// down is closed at once.
    pub async fn look_after(self: Arc<Self>, closing: CancellationToken, ended: CancellationToken) {
        loop {
            tokio::select! {
                () = ended.cancelled() => return,
                () = tokio::time::sleep(JANITOR_EVERY) => {}
            }
            let connections: Vec<_> = self.lock().all.values().cloned().collect();
            metrics::gauge!("monoslam_connections_open").set(connections.len() as f64);
            let now = self.now();
            connections.iter().for_each(|connection| self.judge(connection, now, closing.is_cancelled()));
        }
    }

    fn judge(&self, connection: &Activity, now: u64, is_closing: bool) {
        if connection.is_upgraded.load(Ordering::Relaxed) {
            return;
        }
        let ConnectionConfig { header_timeout_s, idle_timeout_s, stall_timeout_s, closing_stall_s, .. } =
            self.limits;
        let exceeds = |since: u64, limit: Duration| now.saturating_sub(since) > limit.as_millis() as u64;
        let stall_limit = if is_closing { closing_stall_s } else { stall_timeout_s };
        let stalled = connection.stalled_since.load(Ordering::Relaxed);
        if stalled != 0 && exceeds(stalled, span(stall_limit)) {
            return connection.drop.cancel();
        }
        let parting = connection.parting_since.load(Ordering::Relaxed);
        let is_idle = connection.n_in_flight.load(Ordering::Relaxed) == 0;
        if !is_idle {
            return;
        }
        if parting != 0 {
            if exceeds(parting, PARTING) {
                connection.drop.cancel();
            }
            return;
        }
        let has_asked = connection.has_asked.load(Ordering::Relaxed);
        if !has_asked && exceeds(connection.opened, span(header_timeout_s)) {
            return connection.drop.cancel();
        }
        let idle_since = connection.idle_since.load(Ordering::Relaxed);
        if is_closing || (has_asked && exceeds(idle_since, span(idle_timeout_s))) {
            connection.parting_since.store(now.max(1), Ordering::Relaxed);
            connection.close.cancel();
        }
    }

    fn now(&self) -> u64 {
        self.start.elapsed().as_millis() as u64
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whose connections are counted together: an address, or a network of IPv6, of whose addresses a client has
/// as many as it likes (RFC 4291, section 2.5.1).
pub fn client_network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => {
            let [a, b, c, d, ..] = v6.segments();
            if v6.is_loopback() { address } else { IpAddr::from([a, b, c, d, 0, 0, 0, 0]) }
        }
        v4 => v4,
    }
}

impl Entries {
    /// Drops the connection that has been idle longest of those that may go, if there is one.
    fn evict(&mut self, may_go: impl Fn(&Activity) -> bool) -> bool {
        let idle = self.all.iter().filter(|(_, activity)| may_go(activity) && activity.is_idle());
        let longest = idle.min_by_key(|(_, activity)| activity.idle_since.load(Ordering::Relaxed));
        let Some((number, activity)) = longest.map(|(number, activity)| (*number, activity.clone())) else {
            return false;
        };
        metrics::counter!("monoslam_connections_evicted_total").increment(1);
        activity.drop.cancel();
        self.remove(number);
        true
    }

    fn remove(&mut self, number: u64) {
        let Some(activity) = self.all.remove(&number) else { return };
        if let Some(n) = self.per_address.get_mut(&activity.address) {
            *n -= 1;
            if *n == 0 {
                self.per_address.remove(&activity.address);
            }
        }
    }
}

impl Activity {
    fn is_idle(&self) -> bool {
        self.n_in_flight.load(Ordering::Relaxed) == 0 && !self.is_upgraded.load(Ordering::Relaxed)
    }
}

impl Place {
    /// What the connection is doing.
    pub fn activity(&self) -> &Arc<Activity> {
        &self.activity
    }

    /// The limits it is under.
    pub fn limits(&self) -> &ConnectionConfig {
        &self.table.limits
    }

    /// A request is being answered, as long as this is kept.
    pub fn begin(self: &Arc<Self>) -> InFlight {
        self.activity.n_in_flight.fetch_add(1, Ordering::Relaxed);
        self.activity.has_asked.store(true, Ordering::Relaxed);
        InFlight(self.clone())
    }

    /// The connection speaks another protocol from now on.
    pub fn upgraded(&self) {
        self.activity.is_upgraded.store(true, Ordering::Relaxed);
    }

    /// The client took something, or (`false`) takes nothing at the moment.
    pub fn wrote(&self, took: bool) {
        let stalled = &self.activity.stalled_since;
        if took {
            stalled.store(0, Ordering::Relaxed);
        } else if stalled.load(Ordering::Relaxed) == 0 {
            stalled.store(self.table.now().max(1), Ordering::Relaxed);
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.table.lock().remove(self.number);
    }
}

/// A request that is being answered.
pub struct InFlight(Arc<Place>);

impl Drop for InFlight {
    fn drop(&mut self) {
        self.0.activity.idle_since.store(self.0.table.now(), Ordering::Relaxed);
        self.0.activity.n_in_flight.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(max_total: usize, max_per_address: usize) -> Arc<Table> {
        Table::new(ConnectionConfig { max_total, max_per_address, ..ConnectionConfig::default() }, 1 << 20)
    }

    const A: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(10, 0, 0, 1));
    const B: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(10, 0, 0, 2));

    #[test]
    fn the_longest_idle_connection_makes_way_and_a_busy_one_does_not() {
        let table = table(2, 2);
        let busy = Arc::new(table.admit(A).unwrap());
        let in_flight = busy.begin();
        let idle = table.admit(A).unwrap();
        let third = Arc::new(table.admit(B).unwrap());
        assert!(idle.activity.drop.is_cancelled() && !busy.activity.drop.is_cancelled());
        let _in_flight = third.begin();
        assert_eq!(table.admit(B).err(), Some(Full::InAll(2)));
        drop(in_flight);
        assert!(table.admit(B).is_ok(), "the first is idle now");
        assert!(busy.activity.drop.is_cancelled());
    }

    #[test]
    fn an_address_that_has_its_share_gives_up_its_own() {
        let table = table(10, 1);
        let of_b = table.admit(B).unwrap();
        let of_a = Arc::new(table.admit(A).unwrap());
        let in_flight = of_a.begin();
        assert_eq!(table.admit(A).err(), Some(Full::OfAddress(1)));
        drop(in_flight);
        let _second = table.admit(A).unwrap();
        assert!(of_a.activity.drop.is_cancelled() && !of_b.activity.drop.is_cancelled());
        drop(of_b);
        assert_eq!(table.lock().all.len(), 1);
    }

    #[test]
    fn a_network_of_ipv6_is_one_client() {
        let network = |text: &str| client_network(text.parse().unwrap());
        assert_eq!(network("2001:db8:1:2:3::4"), network("2001:db8:1:2:ffff::"));
        assert_ne!(network("2001:db8:1:2::"), network("2001:db8:1:3::"));
        assert_eq!(network("::ffff:10.0.0.1"), A);
        assert_ne!(network("10.0.0.1"), network("10.0.0.2"));
    }

    #[test]
    fn files_are_left_to_the_database() {
        let limits = ConnectionConfig { max_total: 4096, reserved_files: 100, ..ConnectionConfig::default() };
        assert_eq!(Table::new(limits, 1024).max_total, 924);
    }
}
