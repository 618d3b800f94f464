//! Thousands of connections that do nothing beside streams: answers take as long as before.

use crate::program::ServerProcess;
use proto::v1;
use proto::v1::stream_frames_response::Message as Response;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tests::{FrameStream, SmallWorld, create_session, open_message};
use tokio::net::TcpStream;

const N_STREAMS: usize = 2;
const N_IDLE: usize = 2000;
/// Frames of each stream before there are idle connections, and beside them, ten a second.
const N_FRAMES: usize = 60;
/// How much longer answers may take in the 95th percentile.
const MOST: f64 = 1.5;
/// Whoever else uses the machine may spoil a measurement, but not all of them.
const N_ATTEMPTS: usize = 3;

/// Sends frames of one stream at their times; milliseconds from each to its answer.
async fn play(mut stream: FrameStream, images: Arc<Vec<v1::Image>>, first: usize) -> (FrameStream, Vec<f64>) {
    let mut clock = tokio::time::interval(Duration::from_millis(100));
    let mut answers_ms = Vec::new();
    for sequence in first..first + N_FRAMES {
        clock.tick().await;
        // To and fro through the room.
        let at = sequence % (2 * images.len());
        let image = images[at.min(2 * images.len() - 1 - at)].clone();
        let begun = Instant::now();
        let answer = stream.exchange(tests::frame(sequence as u64, image)).await.unwrap();
        assert!(matches!(answer, Response::Result(_)), "{answer:?}");
        answers_ms.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    (stream, answers_ms)
}

/// Both streams beside each other; the 95th percentile of their answers, milliseconds.
async fn p95_ms(streams: &mut Vec<FrameStream>, images: &Arc<Vec<v1::Image>>, first: usize) -> f64 {
    let playing: Vec<_> =
        streams.drain(..).map(|stream| tokio::spawn(play(stream, images.clone(), first))).collect();
    let mut all = Vec::new();
    for playing in playing {
        let (stream, answers_ms) = playing.await.unwrap();
        streams.push(stream);
        all.extend(answers_ms);
    }
    all.sort_by(f64::total_cmp);
    all[all.len() * 95 / 100]
}

/// As many files as this process may have at most.
fn raise_file_limit() {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: `limit` is valid, and both calls use it alone.
    let is_raised = unsafe {
        libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit) == 0 && {
            limit.rlim_cur = limit.rlim_max;
            libc::setrlimit(libc::RLIMIT_NOFILE, &limit) == 0
        }
    };
    assert!(is_raised && limit.rlim_cur as usize > N_IDLE + 100, "{limit:?}");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes a minute: two streams in real time"]
async fn two_thousand_idle_connections_do_not_slow_two_streams() {
    raise_file_limit();
    let folder = tempfile::tempdir().unwrap();
    let server = ServerProcess::start_with(folder.path(), |command| {
        command.env("MONOSLAM_CONNECTIONS__MAX_PER_ADDRESS", "3000");
        command.env("MONOSLAM_CONNECTIONS__HEADER_TIMEOUT_S", "600");
    });
    let world = SmallWorld::new(1);
    let images: Arc<Vec<_>> = Arc::new((0..60).map(|i| world.frame(i).image.unwrap()).collect());
    let mut streams = Vec::new();
    for i in 0..N_STREAMS {
        let (mut client, id) = (server.client().await, format!("room-{i}"));
        create_session(&mut client, &id, world.camera()).await.unwrap();
        streams.push(FrameStream::open(&mut client, open_message(&id)).await.unwrap());
    }
    // What a map's first keyframes take is in neither.
    p95_ms(&mut streams, &images, 0).await;
    let mut ratios = Vec::new();
    for attempt in 0..N_ATTEMPTS {
        let first = (2 * attempt + 1) * N_FRAMES;
        let before = p95_ms(&mut streams, &images, first).await;
        let mut idle = Vec::new();
        for i in 0..N_IDLE {
            let addr = if i % 2 == 0 { server.http_addr } else { server.grpc_addr };
            idle.push(TcpStream::connect(addr).await.unwrap());
        }
        let beside = p95_ms(&mut streams, &images, first + N_FRAMES).await;
        for connection in &idle {
            let is_open = connection
                .try_read(&mut [0; 1])
                .is_err_and(|error| error.kind() == std::io::ErrorKind::WouldBlock);
            assert!(is_open, "an idle connection was closed: they were not all there");
        }
        eprintln!("p95 {before:.1} ms before, {beside:.1} ms beside {N_IDLE} idle connections");
        ratios.push(beside / before);
        if beside / before < MOST {
            break;
        }
    }
    assert!(ratios.iter().any(|ratio| *ratio < MOST), "answers take longer: {ratios:?}");
    for stream in streams {
        stream.finish().await.unwrap();
    }
    assert!(server.terminate());
}
