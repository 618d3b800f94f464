//! Many streams beside each other in real time: what is dropped, how long answers take, whether all get the
//! same, and what memory it takes.

use crate::program::ServerProcess;
use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tests::{Client, FrameStream, SmallWorld, create_session, open_message};

/// Streams at once.
const STREAMS: [usize; 4] = [1, 4, 8, 16];
const N_ROUNDS: usize = 3;
/// Frames of each stream, ten a second.
const N_FRAMES: usize = 150;
const INTERVAL: Duration = Duration::from_millis(100);
/// Seconds without a stream after which sessions leave memory.
const IDLE_UNLOAD_S: u64 = 2;

/// What came of one stream.
#[derive(Clone, Default)]
struct Played {
    n_dropped: usize,
    /// From a frame's sending to its result, milliseconds.
    answers_ms: Vec<f64>,
    /// Frames that had a pose.
    n_posed: usize,
}

/// What came of all streams of one number.
struct Row {
    n_streams: usize,
    played: Vec<Played>,
    peak_mb: f64,
    unloaded_mb: Vec<f64>,
}

/// How equal shares are: 1 if all are the same, 1/n if one has everything [Jain, Chiu and Hawe 1984].
fn jain(shares: &[f64]) -> f64 {
    let sum: f64 = shares.iter().sum();
    let squares: f64 = shares.iter().map(|share| share * share).sum();
    sum * sum / (shares.len() as f64 * squares)
}

fn percentile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// Plays images into a session, each at its time, whatever became of the one before.
async fn play(mut client: Client, id: String, images: Arc<Vec<v1::Image>>) -> Played {
    let open = v1::OpenStream { policy: v1::StreamPolicy::Realtime.into(), ..open_message(&id) };
    let mut stream = FrameStream::open(&mut client, open).await.unwrap();
    let sender = stream.sender();
    let sent: Arc<Mutex<BTreeMap<u64, Instant>>> = Arc::default();
    let times = sent.clone();
    let sending = tokio::spawn(async move {
        let mut clock = tokio::time::interval(INTERVAL);
        for sequence in 0..N_FRAMES as u64 {
            clock.tick().await;
            let frame = tests::frame(sequence, images[sequence as usize].clone());
            let frame = v1::Frame { timestamp_ns: sequence as i64 * INTERVAL.as_nanos() as i64, ..frame };
            times.lock().unwrap().insert(sequence, Instant::now());
            sender.send(v1::StreamFramesRequest { message: Some(Request::Frame(frame)) }).await.unwrap();
        }
    });
    let mut played = Played::default();
    for _ in 0..N_FRAMES {
        match stream.next().await.unwrap() {
            Some(Response::Result(result)) => {
                let took = sent.lock().unwrap()[&result.sequence].elapsed();
                played.answers_ms.push(took.as_secs_f64() * 1e3);
                played.n_posed += usize::from(result.pose_world_from_camera.is_some());
            }
            Some(Response::Dropped(_)) => played.n_dropped += 1,
            other => panic!("{other:?}"),
        }
    }
    sending.await.unwrap();
    stream.finish().await.unwrap();
    played
}

async fn measure(n_streams: usize, world: &SmallWorld, images: &Arc<Vec<v1::Image>>) -> Row {
    let folder = tempfile::tempdir().unwrap();
    let server = ServerProcess::start_with(folder.path(), |command| {
        command.env("MONOSLAM_SESSIONS__IDLE_UNLOAD_S", IDLE_UNLOAD_S.to_string());
        command.env("MONOSLAM_QUOTAS__MAX_STREAMS", "64").env("MONOSLAM_QUOTAS__MAX_FRAMES_PER_S", "1000");
    });
    let mb = |server: &ServerProcess| server.resident_bytes() as f64 / 1e6;
    let mut row = Row { n_streams, played: Vec::new(), peak_mb: 0.0, unloaded_mb: Vec::new() };
    for round in 0..N_ROUNDS {
        let mut streams = Vec::new();
        for i in 0..n_streams {
            let mut client = server.client().await;
            let id = format!("room-{round}-{i}");
            create_session(&mut client, &id, world.camera()).await.unwrap();
            streams.push(tokio::spawn(play(client, id, images.clone())));
        }
        while !streams.iter().all(|stream| stream.is_finished()) {
            row.peak_mb = row.peak_mb.max(mb(&server));
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        for stream in streams {
            row.played.push(stream.await.unwrap());
        }
        tokio::time::sleep(Duration::from_secs(IDLE_UNLOAD_S + 3)).await;
        row.unloaded_mb.push(mb(&server));
    }
    assert!(server.terminate());
    row
}

impl Row {
    fn fairness(&self) -> f64 {
        let rounds = self.played.chunks(self.n_streams);
        let of_round =
            |round: &[Played]| jain(&round.iter().map(|one| one.answers_ms.len() as f64).collect::<Vec<_>>());
        rounds.map(of_round).fold(1.0, f64::min)
    }

    fn cells(&self) -> String {
        let mut answers: Vec<f64> = self.played.iter().flat_map(|one| one.answers_ms.clone()).collect();
        answers.sort_by(f64::total_cmp);
        let n_frames = (self.played.len() * N_FRAMES) as f64;
        let dropped = self.played.iter().map(|one| one.n_dropped).sum::<usize>() as f64 / n_frames;
        let posed = self.played.iter().map(|one| one.n_posed).sum::<usize>() as f64 / answers.len() as f64;
        let slowest = self.played.iter().map(|one| one.answers_ms.len()).min().unwrap_or(0);
        let unloaded: Vec<String> = self.unloaded_mb.iter().map(|mb| format!("{mb:.0}")).collect();
        format!(
            "{} | {:.1} % | {:.0} | {:.0} | {:.2} | {:.3} | {slowest} | {:.0} | {}",
            self.n_streams,
            100.0 * dropped,
            percentile(&answers, 0.5),
            percentile(&answers, 0.95),
            posed,
            self.fairness(),
            self.peak_mb,
            unloaded.join(", "),
        )
    }
}

/// Puts the table into a document, between its marks.
fn write_into(document: &Path, table: &str) {
    let (begin, end) = ("<!-- begin: streams -->\n", "<!-- end: streams -->");
    let text = std::fs::read_to_string(document).unwrap();
    let (before, rest) = text.split_once(begin).expect("the table's begin is marked");
    let (_, after) = rest.split_once(end).expect("the table's end is marked");
    std::fs::write(document, format!("{before}{begin}\n{table}\n{end}{after}")).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes: up to sixteen streams"]
async fn streams_beside_each_other_get_the_same_and_none_starves() {
    let world = SmallWorld::vga(1);
    let jpeg = |i| tests::jpeg(640, 480, &world.pixels(i));
    let images = Arc::new((0..N_FRAMES).map(jpeg).collect::<Vec<_>>());
    let mut table = "| streams | dropped | p50 ms | p95 ms | with a pose | Jain | fewest answers | peak MB | MB unloaded |\n\
                     | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |\n"
        .to_owned();
    for n_streams in STREAMS {
        let row = measure(n_streams, &world, &images).await;
        writeln!(table, "| {} |", row.cells()).unwrap();
        eprintln!("| {} |", row.cells());
        assert!(row.fairness() > 0.9, "some streams get more than others: {}", row.fairness());
        let [first, .., last] = &row.unloaded_mb[..] else { panic!("rounds") };
        assert!(*last < 1.3 * first + 20.0, "memory grows from round to round: {:?}", row.unloaded_mb);
    }
    if std::env::var_os("UPDATE_GENERATED").is_some() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        write_into(&root.join("docs/performance.md"), &table);
    }
}
