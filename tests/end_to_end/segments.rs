//! Clocks that are set: leaps that cannot be meant are refused, and a new segment goes on in the same map.

use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use tests::{Client, FrameStream, SmallWorld, TestServer, create_session, open_message};

/// Frames before the clock is set, and after.
const N_FRAMES: [usize; 2] = [40, 30];

/// Sends one frame; the answer.
async fn exchange(stream: &mut FrameStream, frame: v1::Frame) -> Response {
    stream.send(Request::Frame(frame)).await;
    stream.next().await.unwrap().expect("an answer")
}

/// Streams frames of the world, with times from `from_ns` on in place of theirs; the answers.
async fn stream(
    client: &mut Client,
    world: &SmallWorld,
    range: std::ops::Range<usize>,
    (from_ns, new_segment): (i64, bool),
) -> Vec<v1::FrameResult> {
    let open = v1::OpenStream { new_segment, ..open_message("room") };
    let mut stream = FrameStream::open(client, open).await.unwrap();
    let first_ns = world.frame(range.start).timestamp_ns;
    let mut answers = Vec::new();
    for i in range {
        let mut frame = world.frame(i);
        frame.timestamp_ns += from_ns - first_ns;
        match exchange(&mut stream, frame).await {
            Response::Result(result) => answers.push(result),
            other => panic!("unexpected answer {other:?}"),
        }
    }
    stream.finish().await.unwrap();
    answers
}

fn n_tracked(answers: &[v1::FrameResult]) -> usize {
    answers.iter().filter(|answer| answer.state() == v1::TrackingState::Tracked).count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_leap_is_refused_and_the_session_goes_on() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let world = SmallWorld::new(1);
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let mut stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let last = i64::MAX;
    let leaps = [
        (v1::Frame { sequence: last as u64, ..world.frame(0) }, "SEQUENCE_LEAP", "next_sequence"),
        (world.frame(0), "", ""),
        (v1::Frame { sequence: last as u64, ..world.frame(1) }, "SEQUENCE_LEAP", "next_sequence"),
        (v1::Frame { timestamp_ns: last, ..world.frame(1) }, "TIMESTAMP_LEAP", "new_segment"),
        (
            v1::Frame { timestamp_ns: -10_000_000_000, ..world.frame(1) },
            "TIMESTAMP_NOT_INCREASING",
            "new_segment",
        ),
        (world.frame(1), "", ""),
    ];
    for (frame, code, advice) in leaps {
        match exchange(&mut stream, frame).await {
            Response::Result(_) => assert_eq!(code, ""),
            Response::Rejected(rejected) => {
                assert_eq!(rejected.code, code, "{rejected:?}");
                assert!(rejected.reason.contains(advice), "{rejected:?}");
            }
            other => panic!("unexpected answer {other:?}"),
        }
    }
    stream.finish().await.unwrap();
    assert_eq!(server.get_json("/v1/sessions/room").await["next_sequence"], 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_segment_goes_on_in_the_same_map_with_times_of_another_clock() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let world = SmallWorld::new(1);
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let wall_ns = 1_700_000_000_000_000_000;
    let before = stream(&mut client, &world, 0..N_FRAMES[0], (wall_ns, false)).await;
    assert!(n_tracked(&before) > 10, "there is a map");

    // The clock of a machine that was started anew.
    let n_all = N_FRAMES[0] + N_FRAMES[1];
    let half = N_FRAMES[0] + N_FRAMES[1] / 2;
    let begun_ns = 5_000_000_000;
    let after = stream(&mut client, &world, N_FRAMES[0]..half, (begun_ns, true)).await;
    assert!(n_tracked(&after) > 0, "the camera is found in the map");
    assert_eq!(after[0].timestamp_ns, begun_ns, "times are the client's");
    assert!(after.iter().all(|answer| answer.submap_id == before[0].submap_id));
    let session = server.get_json("/v1/sessions/room").await;
    let last_ns = session["last_timestamp_ns"].as_i64().unwrap();
    assert_eq!(last_ns, after.last().unwrap().timestamp_ns);

    // It is a matter of the session, not of the server's memory.
    let server = server.restart().await;
    let mut client = server.client().await;
    let later = stream(&mut client, &world, half..n_all, (last_ns + 66_000_000, false)).await;
    assert!(n_tracked(&later) > 0);
    let csv = server.get("/v1/sessions/room/trajectory?format=csv").await;
    let times: Vec<i64> =
        csv.lines().skip(1).map(|row| row.split(',').nth(1).unwrap().parse().unwrap()).collect();
    let n_before = times.iter().filter(|ns| **ns >= wall_ns).count();
    assert!(n_before > 10 && times.len() > n_before, "poses with the times of both clocks: {csv}");
    assert!(times[..n_before].iter().all(|ns| *ns >= wall_ns), "in the order of their numbers");
    assert_eq!(server.running().store().check().await.unwrap(), []);
}
