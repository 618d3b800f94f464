//! What the service manager is told: that the server serves, reads its files again, stops, and lives.
//!
//! Datagrams to the socket that `NOTIFY_SOCKET` names [sd_notify(3)]; without one nothing is said.

use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::Arc;
use std::time::Duration;

/// A manager is told that the server lives this many times in the time after which it takes it for dead.
const BEATS: u32 = 3;

/// The service manager, if there is one.
pub struct Manager {
    socket: Option<(UnixDatagram, SocketAddr)>,
    /// Time without a sign of life after which the manager ends the server.
    watchdog: Option<Duration>,
}

impl Manager {
    /// The one that started this process.
    pub fn of_environment() -> Self {
        let variable = |name| std::env::var(name).ok();
        let socket = variable("NOTIFY_SOCKET").and_then(|name| match reach(&name) {
            Ok(socket) => Some(socket),
            Err(error) => {
                tracing::warn!("the service manager at {name} cannot be told anything: {error}");
                None
            }
        });
        let is_for_us = variable("WATCHDOG_PID").is_none_or(|id| id == std::process::id().to_string());
        let watchdog = variable("WATCHDOG_USEC").filter(|_| is_for_us).and_then(|text| text.parse().ok());
        Self { socket, watchdog: watchdog.filter(|us| *us > 0).map(Duration::from_micros) }
    }

    /// The server serves, in words for people.
    pub fn ready(&self, status: &str) {
        self.say(&format!("READY=1\nSTATUS={}", status.replace('\n', " ")));
    }

    /// Files are read again; [`Self::ready`] ends that.
    pub fn reloading(&self) {
        let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: `now` is a valid timespec that the call writes to and does not keep.
        unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &mut now) };
        let now_us = now.tv_sec as i128 * 1_000_000 + now.tv_nsec as i128 / 1000;
        self.say(&format!("RELOADING=1\nMONOTONIC_USEC={now_us}"));
    }

    /// The server stops, and may take so long.
    pub fn stopping(&self, grace: Duration) {
        let allowance_us = (grace + Duration::from_secs(5)).as_micros();
        self.say(&format!("STOPPING=1\nEXTEND_TIMEOUT_USEC={allowance_us}"));
    }

    /// Says that the server lives as often as the manager wants to hear it, without end. A task of the
    /// runtime that answers clients: when that is stuck nothing is said.
    pub async fn beat(self: Arc<Self>) {
        let Some(every) = self.watchdog.map(|watchdog| watchdog / BEATS) else { return };
        loop {
            self.say("WATCHDOG=1");
            tokio::time::sleep(every).await;
        }
    }

    fn say(&self, message: &str) {
        let Some((socket, manager)) = &self.socket else { return };
        if let Err(error) = socket.send_to_addr(message.as_bytes(), manager) {
            tracing::warn!("the service manager cannot be told anything: {error}");
        }
    }
}

/// A socket, and the manager's address: a path, or a name after `@`.
fn reach(name: &str) -> std::io::Result<(UnixDatagram, SocketAddr)> {
    let manager = match name.strip_prefix('@') {
        #[cfg(target_os = "linux")]
        Some(name) => <SocketAddr as std::os::linux::net::SocketAddrExt>::from_abstract_name(name)?,
        #[cfg(not(target_os = "linux"))]
        Some(_) => return Err(std::io::ErrorKind::Unsupported.into()),
        None => SocketAddr::from_pathname(name)?,
    };
    let socket = UnixDatagram::unbound()?;
    // A manager that does not listen must not hold the server up.
    socket.set_nonblocking(true)?;
    Ok((socket, manager))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn managers_have_paths_or_names() {
        use std::os::linux::net::SocketAddrExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let name = format!("monoslam-test-{}", std::process::id());
        let abstract_address = SocketAddr::from_abstract_name(&name).unwrap();
        let listening =
            [UnixDatagram::bind(&path).unwrap(), UnixDatagram::bind_addr(&abstract_address).unwrap()];
        let names = [path.to_str().unwrap().to_owned(), format!("@{name}")];
        for (socket, name) in listening.iter().zip(&names) {
            let manager = Manager { socket: Some(reach(name).unwrap()), watchdog: None };
            manager.ready("serving\non two ports");
            let mut message = [0; 100];
            let n_bytes = socket.recv(&mut message).unwrap();
            assert_eq!(&message[..n_bytes], b"READY=1\nSTATUS=serving on two ports");
        }
    }

    #[test]
    fn nobody_is_told_anything_where_nobody_asks() {
        Manager { socket: None, watchdog: None }.ready("serving");
        let gone = Manager { socket: Some(reach("/nonexistent/notify").unwrap()), watchdog: None };
        gone.stopping(Duration::from_secs(1));
        assert!(gone.socket.is_some(), "it goes on without");
    }
}
