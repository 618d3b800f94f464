//! The network between two servers of a fleet is cut, while both reach the database.

use crate::crash::stream;
use crate::fleet::{LEASE, reason, server_of_fleet};
use crate::program::ServerProcess;
use std::fs::File;
use std::os::fd::AsRawFd;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::time::{Duration, Instant};
use testkit::postgres::shared_database;
use tests::{FrameStream, SmallWorld, create_session, open_message};
use tonic::Code;

/// Until a stream through a cut network ends: twice the time between signs of life, and some.
const MAX_NOTICING: Duration = Duration::from_secs(15);

/// A network of its own, and a link from here to it. Both go when this is dropped.
struct Network {
    name: String,
    host: String,
}

fn ip(arguments: &str) {
    let status = Command::new("ip").args(arguments.split(' ')).status().expect("the program `ip`");
    assert!(status.success(), "ip {arguments}");
}

impl Network {
    fn make() -> Self {
        let number = std::process::id() % 16_384;
        let (name, [high, low]) = (format!("slam{number}"), [number / 64, number % 64 * 4]);
        let host = format!("10.{}.{low}.2", 100 + high % 100);
        let here = format!("10.{}.{low}.1", 100 + high % 100);
        ip(&format!("netns add {name}"));
        let network = Self { name: name.clone(), host: host.clone() };
        ip(&format!("link add {name}a type veth peer name {name}b netns {name}"));
        ip(&format!("addr add {here}/30 dev {name}a"));
        ip(&format!("link set {name}a up"));
        ip(&format!("-n {name} addr add {host}/30 dev {name}b"));
        ip(&format!("-n {name} link set lo up"));
        network.mend();
        network
    }

    /// From now on what is sent to it is lost.
    fn cut(&self) {
        ip(&format!("-n {0} link set {0}b down", self.name));
    }

    fn mend(&self) {
        ip(&format!("-n {0} link set {0}b up", self.name));
    }

    /// Has a program run in it.
    fn enter(&self, command: &mut Command) {
        let network = File::open(format!("/run/netns/{}", self.name)).expect("the network is there");
        let enter = move || {
            // SAFETY: the descriptor is open; the call is safe between fork and exec.
            match unsafe { libc::setns(network.as_raw_fd(), libc::CLONE_NEWNET) } {
                0 => Ok(()),
                _ => Err(std::io::Error::last_os_error()),
            }
        };
        // SAFETY: the closure allocates nothing and takes no lock.
        unsafe { command.pre_exec(enter) };
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        let _ = Command::new("ip").args(["netns", "del", &self.name]).status();
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "writes networks of the machine, as root; needs PostgreSQL"]
async fn a_cut_between_servers_is_told_and_healed() {
    let (url, folders) = (shared_database(), [(); 2].map(|()| tempfile::tempdir().unwrap()));
    let network = Network::make();
    let near = server_of_fleet(&url, folders[0].path());
    let far = ServerProcess::start_at(&network.host, folders[1].path(), |command| {
        network.enter(command);
        command.env("MONOSLAM_STORAGE__URL", &url).arg("--insecure");
        command.env("MONOSLAM_FLEET__LEASE_S", LEASE.as_secs().to_string());
    });
    let (mut client, mut client_of_far) = (near.client().await, far.client().await);
    let world = SmallWorld::new(1);
    create_session(&mut client, "room", world.camera()).await.unwrap();
    FrameStream::open(&mut client_of_far, open_message("room")).await.unwrap().finish().await.unwrap();
    let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    stream(&mut frames, &world, 0, 10).await;

    network.cut();
    let begun = Instant::now();
    let status = loop {
        match tokio::time::timeout(MAX_NOTICING, frames.next()).await.expect("the stream hangs") {
            Ok(Some(_)) => {}
            Ok(None) => panic!("the stream ended well"),
            Err(status) => break status,
        }
    };
    assert_eq!((status.code(), reason(&status).0.as_str()), (Code::Unavailable, "OWNER_UNREACHABLE"));
    eprintln!("a stream through a cut network ended after {:.1?}", begun.elapsed());
    // It keeps its lease, as it reaches the database: nobody takes its session.
    let begun = Instant::now();
    let status = FrameStream::open(&mut client, open_message("room")).await.err().unwrap();
    assert_eq!((status.code(), reason(&status).0.as_str()), (Code::Unavailable, "OWNER_UNREACHABLE"));
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());

    network.mend();
    let open = proto::v1::OpenStream { take_over: true, ..open_message("room") };
    let begun = Instant::now();
    let frames = loop {
        match FrameStream::open(&mut client, open.clone()).await {
            Ok(frames) => break frames,
            Err(status) => assert!(begun.elapsed() < MAX_NOTICING, "{status:?}"),
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    };
    frames.finish().await.unwrap();
    assert!(near.terminate() && far.terminate());
}
