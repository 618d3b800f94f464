//! A rolling restart of a fleet behind a load balancer, under streams.

use crate::fleet::server_of_fleet;
use crate::fleet_kills::{Places, Robots};
use crate::program::ServerProcess;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use testkit::postgres::shared_database;
use tokio::net::{TcpListener, TcpStream};

const N_SERVERS: usize = 3;

/// How often the balancer asks servers whether they are ready.
const PROBED_EVERY: Duration = Duration::from_millis(200);

/// How long a stream may be down: until its session is saved, and another server has loaded it.
const MAX_GAP: Duration = Duration::from_secs(2);

/// Shares connections among servers that are ready, in turn, as any load balancer does.
#[derive(Clone)]
struct Balancer {
    addr: SocketAddr,
    /// gRPC and HTTP of each server.
    servers: Arc<Mutex<Vec<[SocketAddr; 2]>>>,
    ready: Arc<Mutex<Vec<SocketAddr>>>,
}

impl Balancer {
    async fn start(servers: Vec<[SocketAddr; 2]>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let ready = servers.iter().map(|[grpc, _]| *grpc).collect();
        let addr = listener.local_addr().unwrap();
        let balancer =
            Self { addr, servers: Arc::new(Mutex::new(servers)), ready: Arc::new(Mutex::new(ready)) };
        tokio::spawn(balancer.clone().probe());
        tokio::spawn(balancer.clone().serve(listener));
        balancer
    }

    async fn probe(self) {
        loop {
            let servers = self.servers.lock().unwrap().clone();
            let mut ready = Vec::new();
            for [grpc, http] in servers {
                let asked = tests::get(http, "/readyz");
                if matches!(tokio::time::timeout(PROBED_EVERY, asked).await, Ok(Ok(_))) {
                    ready.push(grpc);
                }
            }
            *self.ready.lock().unwrap() = ready;
            tokio::time::sleep(PROBED_EVERY).await;
        }
    }

    async fn serve(self, listener: TcpListener) {
        for turn in 0.. {
            let (mut client, _) = listener.accept().await.unwrap();
            let ready = self.ready.lock().unwrap().clone();
            tokio::spawn(async move {
                for idx in 0..ready.len() {
                    let addr = ready[(turn + idx) % ready.len()];
                    if let Ok(mut server) = TcpStream::connect(addr).await {
                        let _ = server.set_nodelay(true);
                        let _ = tokio::io::copy_bidirectional(&mut client, &mut server).await;
                        return;
                    }
                }
            });
        }
    }
}

/// Requests that a server has passed on.
async fn n_passed_on(server: &ServerProcess) -> f64 {
    let metrics = tests::get(server.http_addr, "/metrics").await.unwrap();
    let name = "monoslam_requests_passed_on_total{outcome=\"answered\"} ";
    let line = metrics.lines().find_map(|line| line.strip_prefix(name));
    line.expect("the counter is there").parse().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes half a minute: restarts a fleet; needs PostgreSQL"]
async fn a_rolling_restart_loses_nothing_and_is_hardly_noticed() {
    let url = shared_database();
    let folders: Vec<_> = (0..N_SERVERS).map(|_| tempfile::tempdir().unwrap()).collect();
    let start = |idx: usize| server_of_fleet(&url, folders[idx].path());
    let mut servers: Vec<ServerProcess> = (0..N_SERVERS).map(start).collect();
    let addresses = |server: &ServerProcess| [server.grpc_addr, server.http_addr];
    let balancer = Balancer::start(servers.iter().map(addresses).collect()).await;
    let places: Places = Arc::new(Mutex::new(vec![format!("http://{}", balancer.addr)]));
    let mut robots = Robots::start(&mut servers[0].client().await, &places).await;
    tokio::time::sleep(Duration::from_secs(5)).await;
    let mut n_passed = 0.0;
    for idx in 0..N_SERVERS {
        n_passed += n_passed_on(&servers[idx]).await;
        let (leaving, begun) = (servers.remove(idx), Instant::now());
        let ended_well = tokio::task::spawn_blocking(|| leaving.terminate()).await.unwrap();
        assert!(ended_well);
        eprintln!("server {idx} left within {:.1?}", begun.elapsed());
        servers.insert(idx, start(idx));
        balancer.servers.lock().unwrap()[idx] = addresses(&servers[idx]);
        tokio::time::sleep(Duration::from_secs(3)).await;
    }
    for server in &servers {
        n_passed += n_passed_on(server).await;
    }
    robots.stop().await;
    for server in servers {
        assert!(server.terminate());
    }
    let gaps = robots.account(&url).await;
    assert!(!gaps.is_empty() && n_passed > 0.0, "nothing was restarted under a stream, or passed on");
    let (middle, last) = (gaps[gaps.len() / 2], gaps[gaps.len() - 1]);
    eprintln!(
        "{N_SERVERS} restarts, {} gaps: half within {middle:.2?}, all within {last:.2?}; {n_passed} requests passed on",
        gaps.len()
    );
    assert!(last < MAX_GAP, "{gaps:?}");
}
