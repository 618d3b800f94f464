//! A fleet under load: servers are killed, or stand still for longer than their leases, and are there again.
//! Streams go to whoever has their session; nothing that was acknowledged is lost.

use crate::fleet::{LEASE, reason, server_of_fleet};
use crate::program::ServerProcess;
use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use store::{Store, StoreOptions};
use testkit::postgres::shared_database;
use tests::{Client, FrameStream, SmallWorld, create_session, open_message};
use tokio::task::JoinHandle;

const N_SERVERS: usize = 3;
const N_STREAMS: usize = 6;
/// Faults, one after the other: every third server stands still instead of being killed.
const N_FAULTS: usize = 24;
/// Frames a second of each stream.
const FRAMES_PER_S: u64 = 10;
const N_IMAGES: usize = 60;

/// Where servers are at present.
pub type Places = Arc<Mutex<Vec<String>>>;

/// One stream that goes on through all of it.
struct Robot {
    id: String,
    places: Places,
    images: Arc<Vec<v1::Image>>,
    /// Every frame before this number was acknowledged as saved.
    promised: AtomicU64,
    /// How long it took from the end of a stream to the next answer.
    gaps: Mutex<Vec<Duration>>,
    stop: Arc<AtomicBool>,
}

impl Robot {
    /// Streams until it is told to stop.
    async fn run(self: Arc<Self>, first: usize) {
        let (mut place, mut turn) = (self.place(first), first);
        let mut broken: Option<Instant> = None;
        while !self.stop.load(Ordering::SeqCst) {
            let next = self.stream(&place, &mut broken).await;
            broken.get_or_insert_with(Instant::now);
            turn += 1;
            place = next.unwrap_or_else(|| self.place(turn));
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    fn place(&self, turn: usize) -> String {
        let places = self.places.lock().unwrap();
        places[turn % places.len()].clone()
    }

    /// Streams to a server until it breaks; where to go then, if the server said.
    async fn stream(&self, place: &str, broken: &mut Option<Instant>) -> Option<String> {
        let address = place.trim_start_matches("http://").parse().unwrap();
        let connecting = tokio::time::timeout(Duration::from_secs(1), tests::connect(address));
        let mut client = connecting.await.ok()?.ok()?;
        // What a server that is gone has passed on may still be open.
        let open = v1::OpenStream { take_over: true, ..open_message(&self.id) };
        let opening = FrameStream::open(&mut client, open);
        let mut stream = match tokio::time::timeout(Duration::from_secs(3), opening).await.ok()? {
            Ok(stream) => stream,
            Err(status) if tonic_types::StatusExt::get_error_details(&status).error_info().is_some() => {
                return reason(&status).1;
            }
            Err(_) => return None,
        };
        let (promised, saved) = (self.promised.load(Ordering::SeqCst), stream.opened.durable_sequence);
        let n_saved = saved.map_or(0, |saved| saved + 1);
        assert!(n_saved >= promised, "{}: {promised} frames were acknowledged, {n_saved} are there", self.id);
        for sequence in stream.opened.next_sequence.. {
            if self.stop.load(Ordering::SeqCst) {
                stream.finish().await.ok()?;
                return None;
            }
            let image = self.images[sequence as usize % self.images.len()].clone();
            let exchanged = async {
                stream.send(Request::Frame(tests::frame(sequence, image))).await;
                stream.next().await
            };
            let Ok(Ok(Some(Response::Result(result)))) =
                tokio::time::timeout(Duration::from_secs(2), exchanged).await
            else {
                return None;
            };
            if let Some(since) = broken.take() {
                self.gaps.lock().unwrap().push(since.elapsed());
            }
            if let Some(durable) = result.durable_sequence {
                self.promised.fetch_max(durable + 1, Ordering::SeqCst);
            }
            tokio::time::sleep(Duration::from_millis(1000 / FRAMES_PER_S)).await;
        }
        None
    }
}

/// Robots that stream through all that befalls a fleet.
pub struct Robots {
    robots: Vec<Arc<Robot>>,
    running: Vec<JoinHandle<()>>,
    stop: Arc<AtomicBool>,
}

impl Robots {
    /// Makes so many sessions and streams into them, to whichever of the places.
    pub async fn start(client: &mut Client, places: &Places) -> Self {
        let world = SmallWorld::new(1);
        let images = Arc::new((0..N_IMAGES).map(|i| world.frame(i).image.unwrap()).collect::<Vec<_>>());
        let (mut robots, mut running, stop) = (Vec::new(), Vec::new(), Arc::new(AtomicBool::new(false)));
        for idx in 0..N_STREAMS {
            let id = format!("robot-{idx}");
            create_session(client, &id, world.camera()).await.unwrap();
            // One server has all of them at first, so that others pass on.
            FrameStream::open(client, open_message(&id)).await.unwrap().finish().await.unwrap();
            let (places, images, stop) = (places.clone(), images.clone(), stop.clone());
            let (promised, gaps) = (AtomicU64::new(0), Mutex::default());
            let robot = Arc::new(Robot { id, places, images, promised, gaps, stop });
            running.push(tokio::spawn(robot.clone().run(idx)));
            robots.push(robot);
        }
        Self { robots, running, stop }
    }

    /// Ends the streams.
    pub async fn stop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        for robot in self.running.drain(..) {
            robot.await.expect("no robot found a frame missing");
        }
    }

    /// That everything is there that was acknowledged; how long each stream was down each time, the shortest
    /// first.
    pub async fn account(&self, url: &str) -> Vec<Duration> {
        let store = Store::connect(url, StoreOptions::default()).await.unwrap();
        assert_eq!(store.check().await.unwrap(), []);
        let mut gaps = Vec::new();
        for robot in &self.robots {
            let promised = robot.promised.load(Ordering::SeqCst);
            let record = store.get_session(&robot.id).await.unwrap();
            let n_frames = record.counts.n_frames;
            assert!(n_frames >= promised, "{}: {n_frames} are there, {promised} were acknowledged", robot.id);
            assert!(promised > 50, "{}: hardly anything was acknowledged: {promised}", robot.id);
            gaps.extend(robot.gaps.lock().unwrap().iter().copied());
        }
        gaps.sort();
        gaps
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes: kills in a fleet; needs PostgreSQL"]
async fn kills_and_standstills_in_a_fleet_lose_nothing_that_was_acknowledged() {
    let url = shared_database();
    let folders: Vec<_> = (0..N_SERVERS).map(|_| tempfile::tempdir().unwrap()).collect();
    let start = |idx: usize| server_of_fleet(&url, folders[idx].path());
    let mut servers: Vec<ServerProcess> = (0..N_SERVERS).map(start).collect();
    let place = |server: &ServerProcess| format!("http://{}", server.grpc_addr);
    let places: Places = Arc::new(Mutex::new(servers.iter().map(place).collect()));
    let mut robots = Robots::start(&mut servers[0].client().await, &places).await;
    tokio::time::sleep(Duration::from_secs(3)).await;
    for fault in 0..N_FAULTS {
        // In an order that repeats after 24.
        let idx = fault * 7 % N_SERVERS;
        if fault % 3 == 2 {
            servers[idx].signal(libc::SIGSTOP);
            tokio::time::sleep(2 * LEASE).await;
            servers[idx].signal(libc::SIGCONT);
        } else {
            // Its folder is its own until it is gone.
            servers.remove(idx).kill();
            servers.insert(idx, start(idx));
            places.lock().unwrap()[idx] = place(&servers[idx]);
        }
        tokio::time::sleep(Duration::from_millis(700 + fault as u64 * 997 % 900)).await;
    }
    robots.stop().await;
    for server in servers {
        assert!(server.terminate());
    }
    let gaps = robots.account(&url).await;
    let (middle, last) = (gaps[gaps.len() / 2], gaps[gaps.len() - 1]);
    eprintln!("{N_FAULTS} faults, {} gaps: half within {middle:.1?}, all within {last:.1?}", gaps.len());
}
