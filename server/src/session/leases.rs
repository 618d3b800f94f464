//! Keeps what this server has taken, lets go in time of what it could not keep, and tells the other servers
//! how busy it is.

use super::Registry;
use crate::outage::Outage;
use std::time::Duration;
use store::Store;

/// Renewals a lease lasts for: so many but one may fail.
const RENEWALS: u32 = 3;
/// Looks at what is left of leases while one lasts. A server that finds less left than twice the time between
/// two looks lets go, so that it has before another can take the session.
const LOOKS: u32 = 20;

/// What this server is a build of.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Renews leases, reports this server, and ends sessions whose lease is about to end, for as long as it is
/// polled.
pub async fn keep(registry: &Registry, store: &Store, lease: Duration) {
    let renewing = async {
        let mut outage = Outage::new("sessions cannot be kept");
        loop {
            let begun = tokio::time::Instant::now();
            let every = lease / RENEWALS;
            let renewed = match tokio::time::timeout(every, store.renew()).await {
                Ok(renewed) => renewed.map_err(|error| error.to_string()),
                Err(_elapsed) => Err("the database does not answer in time".to_owned()),
            };
            outage.note(&renewed);
            tokio::time::sleep_until(begun + every).await;
        }
    };
    let reporting = async {
        loop {
            // The next report follows soon: what keeps it from the database is told where leases are renewed.
            let _ = tokio::time::timeout(lease, store.report(VERSION, &registry.own_load())).await;
            tokio::time::sleep(lease / RENEWALS).await;
        }
    };
    let looking = async {
        let every = lease / LOOKS;
        loop {
            tokio::time::sleep(every).await;
            for key in store.lost(2 * every) {
                registry.lose(&key);
            }
        }
    };
    tokio::join!(renewing, reporting, looking);
}
