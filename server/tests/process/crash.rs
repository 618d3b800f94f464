//! `kill -9` at any moment: every session is listed again, whole, and goes on in its own map.

use crate::program::{ServerProcess, check};
use proto::v1;
use std::net::SocketAddr;
use std::time::Duration;
use tests::{FrameStream, SmallWorld, create_session, open_message};

/// Frames after which a server is killed, within one stream each; then the last server sees the rest.
const KILLED_AFTER: [usize; 3] = [3, 25, 85];
/// Frames in all.
const N_FRAMES: usize = 120;
/// Frames in which a session must have found its place again: two seconds.
const N_RELOCALIZING_FRAMES: usize = 20;

/// What came of the frames of one stream: sequence and answer.
pub type Answers = Vec<v1::FrameResult>;

/// Streams frames until so many were answered or all are.
pub async fn stream(stream: &mut FrameStream, world: &SmallWorld, first: usize, n: usize) -> Answers {
    let sender = stream.sender();
    let frames: Vec<_> = (first..(first + n + 8).min(N_FRAMES)).map(|i| world.frame(i)).collect();
    let n = n.min(frames.len());
    let sending = tokio::spawn(async move {
        for frame in frames {
            let message = Some(v1::stream_frames_request::Message::Frame(frame));
            if sender.send(v1::StreamFramesRequest { message }).await.is_err() {
                break;
            }
        }
    });
    let mut answers = Vec::new();
    while answers.len() < n {
        match stream.next().await.expect("the stream goes on") {
            Some(v1::stream_frames_response::Message::Result(result)) => answers.push(result),
            other => panic!("unexpected answer {other:?}"),
        }
    }
    // More frames are on their way when the server is killed.
    sending.abort();
    answers
}

#[tokio::test(flavor = "multi_thread")]
async fn a_killed_server_keeps_every_promise_and_goes_on_in_the_same_map() {
    let folder = tempfile::tempdir().unwrap();
    let world = SmallWorld::new(1);
    let mut promised = None;
    for (kill, n_frames) in KILLED_AFTER.into_iter().enumerate() {
        let server = ServerProcess::start(folder.path());
        let mut client = server.client().await;
        if kill == 0 {
            create_session(&mut client, "room", world.camera()).await.unwrap();
            create_session(&mut client, "other", world.camera()).await.unwrap();
        }
        let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
        assert!(frames.opened.durable_sequence >= promised, "{:?} was promised", promised);
        let next = frames.opened.next_sequence as usize;
        let answers = stream(&mut frames, &world, next, n_frames - next).await;
        promised = answers.last().and_then(|answer| answer.durable_sequence).max(promised);
        // Not in step with the frames.
        tokio::time::sleep(Duration::from_millis(7 * kill as u64)).await;
        server.kill();
        check(folder.path());
    }

    let server = ServerProcess::start(folder.path());
    let mut client = server.client().await;
    let sessions =
        client.list_sessions(v1::ListSessionsRequest::default()).await.unwrap().into_inner().sessions;
    assert_eq!(sessions.iter().map(|session| session.id.as_str()).collect::<Vec<_>>(), ["other", "room"]);
    let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    assert!(frames.opened.durable_sequence >= promised);
    assert!(frames.opened.n_keyframes >= 2, "there was a map before: {:?}", frames.opened);
    let next = frames.opened.next_sequence as usize;
    let answers = stream(&mut frames, &world, next, N_FRAMES - next).await;
    frames.finish().await.unwrap();
    let found = answers.iter().position(|answer| answer.state() == v1::TrackingState::Tracked);
    let found = found.expect("the session finds its place again");
    assert!(found < N_RELOCALIZING_FRAMES, "it took {found} frames to find the place again");
    assert_one_frame_of_reference(server.http_addr, &world, next).await;
    assert!(server.terminate(), "the server ends well when asked to");
    check(folder.path());
}

/// The parts before and after the last kill fit the truth under one and the same similarity.
async fn assert_one_frame_of_reference(http_addr: SocketAddr, world: &SmallWorld, restart: usize) {
    let csv = tests::get(http_addr, "/v1/sessions/room/trajectory?format=csv").await.unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert!(rows.iter().all(|row| row[3] == "0"), "there is more than one submap");
    let sequence = |row: &Vec<&str>| row[0].parse::<usize>().unwrap();
    let (before, after): (Vec<_>, Vec<_>) = rows.iter().partition(|row| sequence(row) < restart);
    assert!(before.len() > 10 && after.len() > 10, "{} poses before, {} after", before.len(), after.len());

    // Distances between positions of both parts, in map units per true unit: one scale for all of them, were
    // the parts in different frames of reference they would scatter.
    let estimate = |row: &Vec<&str>| [5, 6, 7].map(|column| row[column].parse::<f64>().unwrap());
    let truth = |row: &Vec<&str>| world.camera_position(sequence(row));
    let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
    let scale_between = |a: &Vec<&str>, b: &Vec<&str>| {
        let true_distance = distance(truth(a), truth(b));
        (true_distance > 0.1).then(|| distance(estimate(a), estimate(b)) / true_distance)
    };
    let mut within: Vec<f64> = Vec::new();
    let mut across: Vec<f64> = Vec::new();
    for (i, a) in before.iter().enumerate() {
        within.extend(before[i + 1..].iter().filter_map(|b| scale_between(a, b)));
        across.extend(after.iter().filter_map(|b| scale_between(a, b)));
    }
    let median = |scales: &mut Vec<f64>| {
        scales.sort_by(f64::total_cmp);
        scales[scales.len() / 2]
    };
    let (within, across) = (median(&mut within), median(&mut across));
    assert!(
        (within / across - 1.0).abs() < 0.1,
        "scale {within} within the first part, {across} across both"
    );
}
