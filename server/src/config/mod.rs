//! Configuration of a server: defaults, under a TOML file, under the environment, under the command line.
//!
//! Everything is read once, before a port opens, and checked by [`Config::validate`].

mod environment;
mod limits;
mod sessions;

use crate::fleet::FleetConfig;
use crate::network::{self, AccessConfig, ConnectionConfig, QuotaConfig, TlsConfig};
use crate::storage::StorageConfig;
use crate::traces::TraceConfig;
use anyhow::{Context, ensure};
use clap::{Args, ValueEnum};
use environment::{of_server, unknown_variables};
pub use limits::Limits;
use serde::{Deserialize, Deserializer, Serialize};
pub use sessions::SessionConfig;
use std::net::{Ipv4Addr, SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;

/// Configuration of a server. The names in the TOML file are the fields' names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Folder of the database. It is made if it is not there.
    pub data_dir: PathBuf,
    /// Where gRPC listens; port 0 takes a free one. Default 127.0.0.1:50051: nothing is open to the network
    /// unasked.
    #[serde(deserialize_with = "address_of")]
    pub grpc_addr: SocketAddr,
    /// Where HTTP listens; port 0 takes a free one. Default 127.0.0.1:8080.
    #[serde(deserialize_with = "address_of")]
    pub http_addr: SocketAddr,
    /// Seconds a shutdown may take before what is still running is abandoned. Default 30.
    pub shutdown_grace_s: f64,
    /// What is refused.
    pub limits: Limits,
    /// How sessions run.
    pub sessions: SessionConfig,
    /// How the database is kept.
    pub storage: StorageConfig,
    /// Several servers on one database.
    pub fleet: FleetConfig,
    /// Who is let in.
    pub access: AccessConfig,
    /// Encryption.
    pub tls: TlsConfig,
    /// Connections.
    pub connections: ConnectionConfig,
    /// What each token may use.
    pub quotas: QuotaConfig,
    /// How the log is written.
    pub log: LogFormat,
    /// What is in the log, in the words of `RUST_LOG`, such as `warn,audit=info`. That variable goes before
    /// it. Default `info`.
    pub log_filter: Option<String>,
    /// Where traces go.
    pub traces: TraceConfig,
}
/// How log lines are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line.
    Json,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            data_dir: PathBuf::from("monoslam-data"),
            grpc_addr: (Ipv4Addr::LOCALHOST, 50051).into(),
            http_addr: (Ipv4Addr::LOCALHOST, 8080).into(),
            shutdown_grace_s: 30.0,
            limits: Limits::default(),
            sessions: SessionConfig::default(),
            storage: StorageConfig::default(),
            fleet: FleetConfig::default(),
            access: AccessConfig::default(),
            tls: TlsConfig::default(),
            connections: ConnectionConfig::default(),
            quotas: QuotaConfig::default(),
            log: LogFormat::default(),
            log_filter: None,
            traces: TraceConfig::default(),
        }
    }
}
/// An address to listen at, in numbers or by a name such as `localhost`.
///
/// # Errors
/// A sentence for the user.
pub fn parse_address(text: &str) -> Result<SocketAddr, String> {
    let found: Vec<SocketAddr> = match text.to_socket_addrs() {
        Ok(found) => found.collect(),
        Err(error) => {
            return Err(format!(
                "`{text}` is not an address such as 127.0.0.1:50051 or localhost:50051 ({error})"
            ));
        }
    };
    // A name may stand for two; clients that are given 127.0.0.1 find this one.
    let chosen = found.iter().find(|address| address.is_ipv4()).or(found.first());
    chosen.copied().ok_or_else(|| format!("`{text}` has no address"))
}

fn address_of<'de, D: Deserializer<'de>>(deserializer: D) -> Result<SocketAddr, D::Error> {
    parse_address(&String::deserialize(deserializer)?).map_err(serde::de::Error::custom)
}
/// The file with the environment over it.
///
/// # Errors
/// If the file cannot be read.
pub(crate) fn sources(args: &ConfigArgs) -> anyhow::Result<config::Config> {
    let mut sources = config::Config::builder();
    if let Some(file) = &args.config {
        sources = sources.add_source(config::File::from(file.as_path()).format(config::FileFormat::Toml));
    }
    let environment = config::Environment::with_prefix("MONOSLAM").prefix_separator("_").separator("__");
    let variables = of_server(std::env::vars_os());
    sources = sources.add_source(environment.try_parsing(true).source(Some(variables)));
    sources.build().context("the configuration cannot be read")
}

/// What a configuration that cannot be read comes from.
fn whose_fault(args: &ConfigArgs) -> String {
    let unknown = unknown_variables(of_server(std::env::vars_os()).into_keys());
    match (unknown.as_slice(), &args.config) {
        ([], None) => "the configuration cannot be used".to_owned(),
        ([], Some(file)) => format!("the configuration in {} cannot be used", file.display()),
        (names, _) => {
            format!("the environment has what is no field of the configuration: {}", names.join(", "))
        }
    }
}

/// The command line's share of the configuration; what is left out comes from the environment, the file or
/// the default.
#[derive(Clone, Debug, Default, Args)]
pub struct ConfigArgs {
    /// Folder of the database; made if it is not there
    #[arg(long, value_name = "DIR", global = true)]
    pub data_dir: Option<PathBuf>,
    /// Where gRPC listens [default: 127.0.0.1:50051]
    #[arg(long, value_name = "ADDR", value_parser = parse_address)]
    pub grpc_addr: Option<SocketAddr>,
    /// Where HTTP listens [default: 127.0.0.1:8080]
    #[arg(long, value_name = "ADDR", value_parser = parse_address)]
    pub http_addr: Option<SocketAddr>,
    /// Certificate with which both ports encrypt, a PEM file; read again when it changes
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate, a PEM file
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// Let everybody in who reaches a port, as long as there are no tokens
    #[arg(long)]
    pub insecure: bool,
    /// How the log is written [default: text]
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub log: Option<LogFormat>,
    /// A TOML file with any field of the configuration
    #[arg(long, value_name = "FILE", global = true)]
    pub config: Option<PathBuf>,
}
impl Config {
    /// The defaults with the database in `data_dir` and ports that are free: what tests and demonstrations
    /// run.
    pub fn local(data_dir: impl Into<PathBuf>) -> Self {
        Self {
            data_dir: data_dir.into(),
            grpc_addr: (Ipv4Addr::LOCALHOST, 0).into(),
            http_addr: (Ipv4Addr::LOCALHOST, 0).into(),
            ..Self::default()
        }
    }

    /// Reads the file and the environment (`MONOSLAM_GRPC_ADDR`, `MONOSLAM_LIMITS__MAX_SESSIONS`, …) and puts
    /// the command line over them.
    ///
    /// # Errors
    /// If the file cannot be read, or a value cannot be used; the message names it.
    pub fn load(args: ConfigArgs) -> anyhow::Result<Self> {
        let read = sources(&args)?;
        let mut merged: Self = read.try_deserialize().with_context(|| whose_fault(&args))?;
        let ConfigArgs { data_dir, grpc_addr, http_addr, tls_cert, tls_key, insecure, log, config: _ } = args;
        merged.data_dir = data_dir.unwrap_or(merged.data_dir);
        merged.grpc_addr = grpc_addr.unwrap_or(merged.grpc_addr);
        merged.http_addr = http_addr.unwrap_or(merged.http_addr);
        merged.tls.cert = tls_cert.or(merged.tls.cert);
        merged.tls.key = tls_key.or(merged.tls.key);
        merged.access.insecure |= insecure;
        merged.log = log.unwrap_or(merged.log);
        merged.validate()?;
        Ok(merged)
    }

    /// Checks that every field can be used.
    ///
    /// # Errors
    /// A sentence that names the first field that cannot.
    pub fn validate(&self) -> anyhow::Result<()> {
        ensure!(!self.data_dir.as_os_str().is_empty(), "data_dir is empty");
        let spans = [
            ("shutdown_grace_s", self.shutdown_grace_s),
            ("sessions.idle_unload_s", self.sessions.idle_unload_s),
            ("sessions.save_interval_s", self.sessions.save_interval_s),
            ("sessions.save_retry_s", self.sessions.save_retry_s),
            ("sessions.realtime_max_wait_s", self.sessions.realtime_max_wait_s),
            ("sessions.idle_stream_s", self.sessions.idle_stream_s),
            ("sessions.localize_timeout_s", self.sessions.localize_timeout_s),
        ];
        for (field, seconds) in spans {
            ensure!((0.0..=1e6).contains(&seconds), "{field} is {seconds} but must be 0 to 1000000 seconds");
        }
        let (leap, time_leap_s) = (self.sessions.max_sequence_leap, self.sessions.max_time_leap_s);
        ensure!(
            (1..=1 << 62).contains(&leap),
            "sessions.max_sequence_leap is {leap} but must be 1 to {}",
            1_u64 << 62
        );
        ensure!(
            (1.0..=4e9).contains(&time_leap_s),
            "sessions.max_time_leap_s is {time_leap_s} but must be 1 to 4000000000 seconds"
        );
        let counts = [
            ("sessions.lossless_queue_frames", self.sessions.lossless_queue_frames),
            ("sessions.realtime_queue_frames", self.sessions.realtime_queue_frames),
            ("sessions.n_localizations", self.sessions.n_localizations),
            ("sessions.n_operations", self.sessions.n_operations),
            ("sessions.n_cores", self.sessions.n_cores()),
            ("limits.max_operations", self.limits.max_operations),
            ("limits.max_loaded_sessions", self.limits.max_loaded_sessions),
        ];
        for (field, count) in counts {
            ensure!((1..=65_536).contains(&count), "{field} is {count} but must be 1 to 65536");
        }
        network::validate(&self.access, &self.tls, &self.connections, &self.quotas)?;
        self.storage.validate()?;
        self.fleet.validate()?;
        self.traces.validate()?;
        if let Some(filter) = &self.log_filter {
            let parsed = tracing_subscriber::EnvFilter::try_new(filter);
            parsed.map_err(|error| anyhow::anyhow!("log_filter: {filter:?} cannot be used: {error}"))?;
        }
        let bytes = self.limits.max_message_bytes;
        ensure!(bytes >= 1 << 16, "limits.max_message_bytes is {bytes} but must be at least 65536");
        let in_flight = self.limits.max_bytes_in_flight;
        ensure!(
            in_flight >= bytes,
            "limits.max_bytes_in_flight is {in_flight} but must be at least limits.max_message_bytes, which is {bytes}"
        );
        Ok(())
    }

    /// What images are accepted, for the decoder.
    pub fn decode_limits(&self) -> vision::decode::DecodeLimits {
        let Limits { max_message_bytes, max_image_pixels, .. } = self.limits;
        let defaults = vision::decode::DecodeLimits::default();
        vision::decode::DecodeLimits {
            max_bytes: max_message_bytes,
            max_pixels: max_image_pixels,
            ..defaults
        }
    }

    /// [`Self::shutdown_grace_s`] as a span of time.
    pub fn shutdown_grace(&self) -> Duration {
        Duration::from_secs_f64(self.shutdown_grace_s)
    }
}
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_goes_over_the_file_and_the_file_over_the_defaults() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("monoslam.toml");
        let text = "data_dir = \"from-file\"\nhttp_addr = \"127.0.0.1:81\"\n[limits]\nmax_sessions = 3\n";
        std::fs::write(&file, text).unwrap();
        let args =
            ConfigArgs { config: Some(file), data_dir: Some("from-flag".into()), ..ConfigArgs::default() };
        let config = Config::load(args).unwrap();
        assert_eq!(config.data_dir, PathBuf::from("from-flag"));
        assert_eq!(config.http_addr.port(), 81);
        assert_eq!(config.limits.max_sessions, 3);
        assert_eq!(config.grpc_addr, Config::default().grpc_addr);
    }

    #[test]
    fn a_field_nobody_knows_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("monoslam.toml");
        std::fs::write(&file, "data_dri = \"x\"\n").unwrap();
        let error = Config::load(ConfigArgs { config: Some(file), ..ConfigArgs::default() }).unwrap_err();
        let error = format!("{error:#}");
        assert!(error.contains("data_dri") && error.contains("monoslam.toml"), "{error}");
    }

    #[test]
    fn addresses_may_be_names() {
        let address = parse_address("localhost:50051").unwrap();
        assert!(address.ip().is_loopback() && address.port() == 50051, "{address}");
        assert_eq!(parse_address("[::1]:7").unwrap().port(), 7);
        for wrong in ["localhost", "50051", ":50051x", "127.0.0.1:99999"] {
            assert!(parse_address(wrong).unwrap_err().contains("localhost:50051"), "{wrong}");
        }
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("monoslam.toml");
        std::fs::write(&file, "http_addr = \"localhost:81\"\n").unwrap();
        let config = Config::load(ConfigArgs { config: Some(file), ..ConfigArgs::default() }).unwrap();
        assert_eq!(config.http_addr.port(), 81);
    }

    #[test]
    fn a_span_that_is_not_a_number_is_refused() {
        let mut config = Config::local("x");
        config.sessions.idle_unload_s = f64::NAN;
        assert!(config.validate().unwrap_err().to_string().contains("sessions.idle_unload_s"));
    }
}
