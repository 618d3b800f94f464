//! Under a service manager: it is told when the server serves, lives, reads its files again, and stops.

use crate::program::ServerProcess;
use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

/// What the manager hears next that is no sign of life.
fn heard(socket: &UnixDatagram) -> String {
    let deadline = Instant::now() + Duration::from_secs(20);
    while Instant::now() < deadline {
        let message = next(socket);
        if message != "WATCHDOG=1" {
            return message;
        }
    }
    panic!("nothing but signs of life");
}

fn next(socket: &UnixDatagram) -> String {
    let mut bytes = [0; 1000];
    let n_bytes = socket.recv(&mut bytes).expect("the server says something in time");
    String::from_utf8(bytes[..n_bytes].to_vec()).unwrap()
}

#[test]
fn a_manager_is_told_what_the_server_does() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let server = ServerProcess::start_with(&folder.path().join("data"), |command| {
        command.env("NOTIFY_SOCKET", &path).env("WATCHDOG_USEC", "300000");
    });
    let (grpc_addr, http_addr) = (server.grpc_addr, server.http_addr);
    let ready = format!("READY=1\nSTATUS=gRPC on {grpc_addr}, HTTP on {http_addr}");
    assert_eq!(heard(&socket), ready);
    assert_eq!(next(&socket), "WATCHDOG=1");
    let last = Instant::now();
    assert_eq!(next(&socket), "WATCHDOG=1");
    assert!(last.elapsed() < Duration::from_millis(300), "it must be heard within 300 ms");

    server.signal(libc::SIGHUP);
    let reloading = heard(&socket);
    let since_boot_us = reloading.strip_prefix("RELOADING=1\nMONOTONIC_USEC=").expect("that it reloads");
    assert!(since_boot_us.parse::<u64>().unwrap() > 0, "{reloading}");
    assert_eq!(heard(&socket), ready);

    server.signal(libc::SIGTERM);
    let stopping = heard(&socket);
    assert!(stopping.starts_with("STOPPING=1\nEXTEND_TIMEOUT_USEC="), "{stopping}");
    assert!(server.terminate());
}
