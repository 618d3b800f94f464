//! Monocular SLAM as a service: sessions over gRPC and HTTP, kept in a database as they are made.
//!
//! [`Server::start`] runs a server inside this process, [`Config`] says how, and [`Service`] is what both
//! interfaces call: the modules [`grpc`] and [`rest`] decode, call it and encode. The sessions themselves
//! live in [`session`], each on a thread of its own; what can be asked of their maps stands in [`maps`].
//!
//! ```no_run
//! # async fn example() -> anyhow::Result<()> {
//! let running = server::Server::start(server::Config::local("data")).await?;
//! println!("gRPC on {}, HTTP on {}", running.grpc_addr, running.http_addr);
//! running.shutdown().await;
//! # Ok(())
//! # }
//! ```

pub mod access;
mod budget;
mod clock;
mod config;
mod connections;
mod current;
mod data;
mod error;
mod fleet;
pub mod grpc;
mod ids;
pub mod localization;
pub mod maps;
pub mod measures;
mod memory;
mod migrate;
mod model;
mod motion;
pub mod network;
mod notify;
pub mod operations;
mod options;
mod outage;
mod page;
mod probe;
mod process;
mod quick_share;
mod relay;
pub mod rest;
pub mod scale;
mod server;
mod service;
pub mod session;
mod settings;
mod shutdown;
mod soundness;
mod storage;
mod telemetry;
mod tokens;
mod traces;
mod upkeep;
mod watch;

pub use clock::SystemClock;
pub use config::{Config, ConfigArgs, Limits, LogFormat, SessionConfig};
pub use data::{DATABASE_FILE, open_store, open_store_beside};
pub use error::{ApiError, ErrorCode, FieldViolation};
pub use migrate::MigrateCommand;
pub use model::{Camera, Model, Pose, Scale, State, Units};
pub use notify::Manager;
pub use options::{SessionOptions, camera_warnings, is_of_size_alone};
pub use page::{DEFAULT_PAGE_SIZE, MAX_PAGE_SIZE, Page, PageRequest};
pub use probe::probe;
pub use quick_share::QuickShare;
pub use rest::viewer_file;
pub use server::{Running, Server, Shutdown};
pub use service::{NewSession, Service};
pub use session::SessionView;
pub use settings::ConfigCommand;
pub use shutdown::{Hangups, requested as shutdown_requested};
pub use storage::{StorageConfig, Synchronous};
pub use telemetry::start_log;
pub use tokens::TokenCommand;
pub use traces::{Exporter, TraceConfig};
pub use upkeep::UpkeepCommand;
pub use watch::{Watched, watch};
