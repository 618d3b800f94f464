//! One of several servers on one database: how the others and clients know it.

use anyhow::ensure;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;
use store::Owner;

/// Several servers on one database of PostgreSQL (`storage.url`). A session that is in memory belongs to one
/// of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FleetConfig {
    /// Seconds for which a session stays a server's that is not heard of; then another may take it. Default
    /// 10: renewed every third of it, so that two renewals in a row may fail.
    pub lease_s: f64,
    /// Where clients reach this server's gRPC, as `http://maps-1.example:50051`. Default the address it
    /// listens on, or the machine's name where it listens on all.
    pub grpc_url: Option<String>,
    /// The same of its HTTP.
    pub http_url: Option<String>,
    /// Whether what another server must answer is passed on to it. Default true: clients need to reach any
    /// one server, as behind a load balancer, and none of the others' addresses. Otherwise they are told
    /// where to ask, which spares a frame the way through two servers where they do reach all.
    pub pass_on: bool,
    /// Seconds in which another server must take a connection. Default 2: they are in one network, and
    /// clients wait meanwhile.
    pub connect_timeout_s: f64,
    /// Authorities whose certificates other servers show, a PEM file, where they encrypt. Default the
    /// system's.
    pub ca: Option<PathBuf>,
}

impl Default for FleetConfig {
    fn default() -> Self {
        Self {
            lease_s: 10.0,
            grpc_url: None,
            http_url: None,
            pass_on: true,
            connect_timeout_s: 2.0,
            ca: None,
        }
    }
}

impl FleetConfig {
    /// Checks that every field can be used.
    ///
    /// # Errors
    /// A sentence that names the field that cannot.
    pub fn validate(&self) -> anyhow::Result<()> {
        let lease_s = self.lease_s;
        ensure!(
            (1.0..=3600.0).contains(&lease_s),
            "fleet.lease_s is {lease_s} but must be 1 to 3600 seconds"
        );
        let connect_timeout_s = self.connect_timeout_s;
        ensure!(
            (0.05..=60.0).contains(&connect_timeout_s),
            "fleet.connect_timeout_s is {connect_timeout_s} but must be 0.05 to 60 seconds"
        );
        for (field, url) in [("fleet.grpc_url", &self.grpc_url), ("fleet.http_url", &self.http_url)] {
            let is_url =
                url.as_ref().is_none_or(|url| url.starts_with("http://") || url.starts_with("https://"));
            ensure!(is_url, "{field} must begin with http:// or https://");
        }
        Ok(())
    }

    /// How long a session stays this server's without a renewal.
    pub fn lease(&self) -> Duration {
        Duration::from_secs_f64(self.lease_s)
    }

    /// How long another server may take to take a connection.
    pub fn connect_timeout(&self) -> Duration {
        Duration::from_secs_f64(self.connect_timeout_s)
    }

    /// The server of this name, as it can be reached.
    pub fn owner(
        &self,
        name: String,
        grpc_addr: SocketAddr,
        http_addr: SocketAddr,
        is_encrypted: bool,
    ) -> Owner {
        let scheme = if is_encrypted { "https" } else { "http" };
        let machine =
            hostname::get().map_or_else(|_| "localhost".into(), |name| name.to_string_lossy().into_owned());
        let url = |given: &Option<String>, addr: SocketAddr| match given {
            Some(url) => url.trim_end_matches('/').to_owned(),
            None if addr.ip().is_unspecified() => format!("{scheme}://{machine}:{}", addr.port()),
            None => format!("{scheme}://{addr}"),
        };
        Owner { name, grpc_url: url(&self.grpc_url, grpc_addr), http_url: url(&self.http_url, http_addr) }
    }
}

/// What names of operations begin with that a server knows, so that the others find it.
pub fn operation_tag(server_name: &str) -> String {
    let digest = Sha256::digest(server_name.as_bytes());
    digest[..4].iter().map(|byte| format!("{byte:02x}")).collect()
}
