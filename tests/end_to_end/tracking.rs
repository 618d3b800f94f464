//! A camera through a synthetic room: what is streamed in comes out as a trajectory.

use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use tests::{FrameStream, SmallWorld, TestServer, create_session, open_message};

/// Frames of the room that the tests stream: six seconds.
const N_FRAMES: usize = 60;

/// Streams frames and returns the answers, in order.
async fn stream_frames(stream: &mut FrameStream, frames: Vec<v1::Frame>) -> Vec<v1::FrameResult> {
    let (sender, n) = (stream.sender(), frames.len());
    let sending = tokio::spawn(async move {
        for frame in frames {
            let message = Some(Request::Frame(frame));
            sender.send(v1::StreamFramesRequest { message }).await.expect("the stream is open");
        }
    });
    let mut results = Vec::new();
    while results.len() < n {
        match stream.next().await.expect("the stream goes on") {
            Some(Response::Result(result)) => results.push(result),
            other => panic!("frame {} was not tracked: {other:?}", results.len()),
        }
    }
    sending.await.unwrap();
    results
}

fn n_tracked(results: &[v1::FrameResult]) -> usize {
    results.iter().filter(|result| result.state() == v1::TrackingState::Tracked).count()
}

#[tokio::test]
async fn a_streamed_room_becomes_a_map_a_trajectory_and_images() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let world = SmallWorld::new(1);
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let mut stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let results = stream_frames(&mut stream, (0..N_FRAMES).map(|i| world.frame(i)).collect()).await;
    assert!(
        n_tracked(&results) > N_FRAMES / 3,
        "only {} of {N_FRAMES} frames were tracked",
        n_tracked(&results)
    );
    assert!(
        results.iter().all(|result| result.timings.as_ref().is_some_and(|timings| timings.total_ms > 0.0))
    );
    stream.finish().await.unwrap();

    // Complete right after the end of the stream.
    let tum = server.get("/v1/sessions/room/trajectory?format=tum").await;
    assert!(tum.lines().count() >= n_tracked(&results));
    let first: Vec<f64> =
        tum.lines().next().unwrap().split(' ').map(|number| number.parse().unwrap()).collect();
    assert_eq!(first.len(), 8);
    let keyframes = server.get_json("/v1/sessions/room/keyframes?page_size=1000").await;
    let keyframes = keyframes["keyframes"].as_array().unwrap().clone();
    assert!(keyframes.len() >= 2);
    let kf_csv = server.get("/v1/sessions/room/trajectory?format=csv&kind=keyframes").await;
    assert_eq!(kf_csv.lines().count(), keyframes.len() + 1);
    for keyframe in &keyframes {
        assert_eq!(keyframe["has_image"], true, "{keyframe}");
    }
    let url = format!(
        "http://{}/v1/sessions/room/keyframes/{}/image",
        server.running().http_addr,
        keyframes[0]["id"]
    );
    let response = reqwest::get(url).await.unwrap();
    assert_eq!(response.headers()["content-type"], "image/png");
    let image = image::load_from_memory(&response.bytes().await.unwrap()).unwrap().into_luma8();
    let sequence = keyframes[0]["sequence"].as_u64().unwrap() as usize;
    assert_eq!(image.into_raw(), world.pixels(sequence), "the image is the one that was sent");

    let all = server.get_json("/v1/sessions/room/points?page_size=1000").await;
    let point = all["points"][0].clone();
    let [x, y, z] = [0, 1, 2].map(|axis| point["position"][axis].as_f64().unwrap());
    let near = server.get_json(&format!("/v1/sessions/room/points?near={x},{y},{z}&radius=0")).await;
    assert!(near["points"].as_array().unwrap().contains(&point), "{point} is not near itself");
    let metrics = server.get("/metrics").await;
    assert!(
        metrics.contains("monoslam_frames_total") && metrics.contains("monoslam_commit_seconds"),
        "{metrics}"
    );
}

#[tokio::test]
async fn a_restarted_server_finds_its_place_and_goes_on() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let world = SmallWorld::new(1);
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let mut stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    stream_frames(&mut stream, (0..N_FRAMES).map(|i| world.frame(i)).collect()).await;
    stream.finish().await.unwrap();
    let before = server.get("/v1/sessions/room/trajectory?format=csv").await;

    let server = server.restart().await;
    assert_eq!(server.get("/v1/sessions/room/trajectory?format=csv").await, before);
    let mut client = server.client().await;
    let mut stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let next = stream.opened.next_sequence as usize;
    assert_eq!(next, N_FRAMES);
    let results = stream_frames(&mut stream, (next..next + 20).map(|i| world.frame(i)).collect()).await;
    stream.finish().await.unwrap();
    // Two seconds of frames are enough to find the place again.
    assert!(results.iter().any(|result| result.relocalised), "the place was not found again");
    let last = results.last().unwrap();
    assert_eq!((last.state(), last.submap_id), (v1::TrackingState::Tracked, 0), "{last:?}");
}

#[tokio::test]
async fn deterministic_sessions_give_the_same_database_each_time() {
    let world = SmallWorld::new(3);
    let mut digests = Vec::new();
    for _ in 0..2 {
        let server = TestServer::start().await;
        let mut client = server.client().await;
        let options =
            v1::SessionOptions { deterministic: Some(true), seed: Some(5), ..v1::SessionOptions::default() };
        let request = v1::CreateSessionRequest {
            session_id: "room".into(),
            camera: Some(world.camera()),
            options: Some(options),
            ..v1::CreateSessionRequest::default()
        };
        client.create_session(request).await.unwrap();
        let mut stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
        stream_frames(&mut stream, (0..30).map(|i| world.frame(i)).collect()).await;
        stream.finish().await.unwrap();
        digests.push(server.running().store().digest("room").await.unwrap());
    }
    assert_eq!(digests[0], digests[1]);
}
