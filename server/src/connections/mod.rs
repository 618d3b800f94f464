//! Connections of both ports: how many there may be, how long each may stand still, and encryption.
//!
//! A connection that does nothing must not cost a stream its place. Each is noted in a [`Table`] with what it
//! is doing; a janitor closes those that exceed a time limit, and where there are too many, the one that has
//! been idle longest makes way for a new one.

mod body;
mod files;
mod inflow;
mod io;
mod metered;
mod refusal;
mod serve;
mod table;
mod tls;
mod traced;
mod until;

pub use files::raise_file_limit;
pub use inflow::Inflow;
pub use metered::Meter;
pub use serve::{Interface, Opening, Peer, Port, serve};
pub use table::{Table, client_network};
pub use tls::Certificates;
pub use traced::trace;
pub use until::until;
