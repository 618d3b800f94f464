//! What stands between the network and the service: who is let in, over which connections, and how much each
//! may use. All of it is configuration.

use anyhow::ensure;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::time::Duration;

/// Who is let in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AccessConfig {
    /// While there are no tokens, let everybody in who reaches a port. Otherwise only this machine is let in
    /// then, and a server without tokens does not listen beyond it. Default false.
    pub insecure: bool,
    /// Seconds until a token that was made or revoked is noticed. Default 1: the table is small and read in
    /// less than a millisecond.
    pub refresh_s: f64,
    /// Seconds a page's ticket is good for, with which browsers open events, streams and pictures. Default
    /// 3600; a page renews it in time.
    pub ticket_s: f64,
    /// Whether `/metrics` needs no token. Default false: its sums tell how much others do.
    pub public_metrics: bool,
    /// Names, besides addresses, `localhost`, names without a dot and this machine's own, by which pages may
    /// call a server without tokens. Default none: a foreign name that leads here is how pages of others
    /// reach servers that only their visitor can (DNS rebinding).
    pub hosts: Vec<String>,
    /// Origins, such as `https://maps.example`, whose pages may use the HTTP interface. Default none but its
    /// own.
    pub cors_origins: Vec<String>,
    /// Requests a second of one token, or of one address without a token. Default 200: a page that loads the
    /// pictures of many keyframes asks for a hundred.
    pub requests_per_s: u32,
    /// Requests at once before that rate counts. Default 1000.
    pub request_burst: u32,
}

impl Default for AccessConfig {
    fn default() -> Self {
        Self {
            insecure: false,
            refresh_s: 1.0,
            ticket_s: 3600.0,
            public_metrics: false,
            hosts: Vec::new(),
            cors_origins: Vec::new(),
            requests_per_s: 200,
            request_burst: 1000,
        }
    }
}

/// Encryption of both ports.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TlsConfig {
    /// The certificate with those that vouch for it, a PEM file; `None` is no encryption.
    pub cert: Option<PathBuf>,
    /// Its private key, a PEM file.
    pub key: Option<PathBuf>,
    /// Seconds between looks whether the files changed; SIGHUP has them read at once. Default 10.
    pub reload_s: f64,
}

impl Default for TlsConfig {
    fn default() -> Self {
        Self { cert: None, key: None, reload_s: 10.0 }
    }
}

/// Connections of both ports together. Where there are too many, the one that has been idle longest is closed
/// for a new one; only if none is idle the new one is refused.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConnectionConfig {
    /// Connections at most. Default 4096; fewer where the system allows fewer open files.
    pub max_total: usize,
    /// Connections of one address, or one /64 of IPv6, at most. Default 1024: a whole team behind one router
    /// or proxy.
    pub max_per_address: usize,
    /// Seconds until the first request of a connection must be there, encryption included, and until the head
    /// of each further one that has begun. Default 10.
    pub header_timeout_s: f64,
    /// Seconds a body may stand still while it is sent. Default 30. Streams of frames may pause.
    pub body_timeout_s: f64,
    /// Seconds without a request after which a connection is closed. Default 120.
    pub idle_timeout_s: f64,
    /// Seconds a client may read nothing of what is sent to it. Default 60.
    pub stall_timeout_s: f64,
    /// The same once the server shuts down. Default 2.
    pub closing_stall_s: f64,
    /// Open files that connections leave to the database, exports and the log. Default 256: each of some tens
    /// of readers and writers of the database has up to three.
    pub reserved_files: u64,
}

impl Default for ConnectionConfig {
    fn default() -> Self {
        Self {
            max_total: 4096,
            max_per_address: 1024,
            header_timeout_s: 10.0,
            body_timeout_s: 30.0,
            idle_timeout_s: 120.0,
            stall_timeout_s: 60.0,
            closing_stall_s: 2.0,
            reserved_files: 256,
        }
    }
}

/// What each token may use, unless it was made with other numbers; `None` is no limit. Without a token, and
/// for administrators, only the limits of the server hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QuotaConfig {
    /// Sessions of its owner. Default 1000: a tenth of what the server keeps.
    pub max_sessions: Option<u64>,
    /// Streams open at the same time. Default 16: a quarter of the sessions that are in memory.
    pub max_streams: Option<u64>,
    /// Frames a second, all streams together. Default 240: eight cameras of 30. A LOSSLESS stream is held
    /// back; in a REALTIME stream frames beyond it are rejected.
    pub max_frames_per_s: Option<f64>,
    /// Bytes of images and features that its owner's sessions keep. Default no limit but the disk's.
    pub max_stored_bytes: Option<u64>,
    /// Seconds between looks at what is stored while a stream is open. Default 10.
    pub check_s: f64,
}

impl Default for QuotaConfig {
    fn default() -> Self {
        Self {
            max_sessions: Some(1000),
            max_streams: Some(16),
            max_frames_per_s: Some(240.0),
            max_stored_bytes: None,
            check_s: 10.0,
        }
    }
}

/// Checks that every field can be used.
///
/// # Errors
/// A sentence that names the first field that cannot.
pub fn validate(
    access: &AccessConfig,
    tls: &TlsConfig,
    connections: &ConnectionConfig,
    quotas: &QuotaConfig,
) -> anyhow::Result<()> {
    let spans = [
        ("access.refresh_s", access.refresh_s),
        ("access.ticket_s", access.ticket_s),
        ("tls.reload_s", tls.reload_s),
        ("connections.header_timeout_s", connections.header_timeout_s),
        ("connections.body_timeout_s", connections.body_timeout_s),
        ("connections.idle_timeout_s", connections.idle_timeout_s),
        ("connections.stall_timeout_s", connections.stall_timeout_s),
        ("connections.closing_stall_s", connections.closing_stall_s),
        ("quotas.check_s", quotas.check_s),
    ];
    for (field, seconds) in spans {
        ensure!((0.05..=1e6).contains(&seconds), "{field} is {seconds} but must be 0.05 to 1000000 seconds");
    }
    let counts = [
        ("access.requests_per_s", access.requests_per_s as usize),
        ("access.request_burst", access.request_burst as usize),
        ("connections.max_total", connections.max_total),
        ("connections.max_per_address", connections.max_per_address),
    ];
    for (field, count) in counts {
        ensure!((1..=1_000_000).contains(&count), "{field} is {count} but must be 1 to 1000000");
    }
    if let Some(rate) = quotas.max_frames_per_s {
        ensure!(
            (0.01..=1e6).contains(&rate),
            "quotas.max_frames_per_s is {rate} but must be 0.01 to 1000000"
        );
    }
    ensure!(
        tls.cert.is_some() == tls.key.is_some(),
        "tls.cert and tls.key go together: one of them is missing"
    );
    for origin in &access.cors_origins {
        let is_origin = origin.split_once("://").is_some_and(|(scheme, host)| {
            ["http", "https"].contains(&scheme) && !host.is_empty() && !host.contains(['/', '*'])
        });
        ensure!(is_origin, "access.cors_origins: {origin:?} is not an origin such as https://maps.example");
    }
    Ok(())
}

/// Seconds of a checked field as a span of time.
pub fn span(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(access: AccessConfig, tls: TlsConfig) -> anyhow::Result<()> {
        validate(&access, &tls, &ConnectionConfig::default(), &QuotaConfig::default())
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        assert!(check(AccessConfig::default(), TlsConfig::default()).is_ok());
        let half = TlsConfig { cert: Some("c.pem".into()), ..TlsConfig::default() };
        assert!(check(AccessConfig::default(), half).unwrap_err().to_string().contains("tls.key"));
        for origin in ["maps.example", "https://", "https://a/b", "*", "ftp://a"] {
            let access = AccessConfig { cors_origins: vec![origin.to_owned()], ..AccessConfig::default() };
            let error = check(access, TlsConfig::default()).unwrap_err().to_string();
            assert!(error.contains("cors_origins"), "{origin}: {error}");
        }
    }
}
