//! What takes long: maps are adjusted and joined while their clients may come and go.

use crate::maps::{N_FRAMES, mapped_room, stream_frames};
use proto::v1;
use proto::v1::OperationState;
use proto::v1::operation::Result as Outcome;
use serde_json::{Value, json};
use std::time::Duration;
use store::TokenRole;
use tests::{Client, FrameStream, SmallWorld, TestServer, create_session, open_message, with_token};
use tonic::Code;

/// Longer than any operation on a room takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// The operation once it has ended.
async fn ended(client: &mut Client, id: &str) -> v1::Operation {
    let (begin, mut last) = (std::time::Instant::now(), 0.0);
    loop {
        let request = v1::GetOperationRequest { operation_id: id.to_owned() };
        let operation = client.get_operation(request).await.unwrap().into_inner();
        assert!(operation.progress >= last && operation.progress <= 1.0, "{operation:?}");
        last = operation.progress;
        if operation.ended_at_ns.is_some() {
            return operation;
        }
        assert!(begin.elapsed() < PATIENCE, "{operation:?}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

fn optimize(session_id: &str) -> v1::OptimizeMapRequest {
    v1::OptimizeMapRequest { session_id: session_id.to_owned() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_adjusted_and_the_result_is_there_after_a_restart() {
    let world = SmallWorld::new(1);
    let server = TestServer::start().await;
    let mut client = server.client().await;
    // Without primitives a map is not adjusted as a whole when its recording ends.
    let options = v1::SessionOptions { global_primitives: Some(false), ..v1::SessionOptions::default() };
    let (session_id, camera) = ("room".to_owned(), Some(world.camera()));
    let new = v1::CreateSessionRequest {
        session_id,
        camera,
        options: Some(options),
        ..v1::CreateSessionRequest::default()
    };
    client.create_session(new).await.unwrap();
    let stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    stream_frames(stream, &world, 0..N_FRAMES).await;
    let address = format!("http://{}", server.running().http_addr);
    let http = reqwest::Client::new();
    let keyframes = server.get_json("/v1/sessions/room/keyframes?page_size=1000").await;
    let answer = http.post(format!("{address}/v1/sessions/room/optimize")).send().await.unwrap();
    assert_eq!(answer.status(), 202);
    let location = answer.headers()["location"].to_str().unwrap().to_owned();
    let begun: Value = answer.json().await.unwrap();
    let id = begun["id"].as_str().unwrap().to_owned();
    assert_eq!(location, format!("/v1/operations/{id}"));
    assert_eq!((&begun["kind"], &begun["session_id"]), (&json!("optimize"), &json!("room")));

    // The client that began it has gone; another one asks.
    let operation = ended(&mut client, &id).await;
    assert_eq!(operation.state(), OperationState::Done, "{operation:?}");
    let Some(Outcome::Optimized(result)) = operation.result else { panic!("{operation:?}") };
    assert!(result.cost_after > 0.0 && result.cost_after < result.cost_before, "{result:?}");
    assert!(operation.n_iterations > 0 && result.n_keyframes > 3);
    let told = server.get_json(&location).await;
    assert_eq!(told["optimized"]["cost_after"].as_f64(), Some(result.cost_after));
    assert_eq!((told["state"].as_str(), told["progress"].as_f64()), (Some("done"), Some(1.0)));
    let listed = client.list_operations(v1::ListOperationsRequest::default()).await.unwrap().into_inner();
    assert_eq!(listed.operations.len(), 1);
    let adjusted = server.get_json("/v1/sessions/room/keyframes?page_size=1000").await;
    assert_ne!(adjusted, keyframes, "nothing moved");
    assert!(server.running().store().check().await.unwrap().is_empty());

    let server = server.restart().await;
    assert_eq!(server.get_json("/v1/sessions/room/keyframes?page_size=1000").await, adjusted);
    let mut client = server.client().await;
    let request = v1::GetOperationRequest { operation_id: id };
    let gone = client.get_operation(request).await.unwrap_err();
    assert_eq!(gone.code(), Code::NotFound);
    assert!(gone.message().contains("restart"), "{}", gone.message());
    // And the session goes on where it was.
    let stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    assert!(stream_frames(stream, &world, N_FRAMES..N_FRAMES + 10).await > 5);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_belongs_to_its_stream_or_to_its_operation() {
    let (server, mut client) = mapped_room().await;
    let stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let refused = client.optimize_map(optimize("room")).await.unwrap_err();
    assert_eq!(refused.code(), Code::FailedPrecondition);
    assert!(refused.message().contains("a client streams into session room"), "{}", refused.message());
    stream.finish().await.unwrap();

    let begun = client.optimize_map(optimize("room")).await.unwrap().into_inner();
    let twice = client.optimize_map(optimize("room")).await.unwrap_err();
    assert_eq!(twice.code(), Code::FailedPrecondition);
    assert!(twice.message().contains(&begun.id), "{}", twice.message());
    // Whatever comes first, nobody waits for long, and what is asked is done or refused in a sentence.
    let opened = FrameStream::open(&mut client, open_message("room")).await;
    if let Err(refused) = &opened {
        assert_eq!(refused.code(), Code::FailedPrecondition, "{refused:?}");
        assert!(refused.message().contains("an operation works on session room"), "{}", refused.message());
    }
    drop(opened);
    let operation = ended(&mut client, &begun.id).await;
    assert!(matches!(operation.state(), OperationState::Done | OperationState::Failed), "{operation:?}");
    let missing = client.optimize_map(optimize("nowhere")).await.unwrap_err();
    assert_eq!(missing.code(), Code::NotFound);
    assert!(server.running().store().check().await.unwrap().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_cancelled_changes_nothing_and_a_shutdown_does_not_wait() {
    let (server, mut client) = mapped_room().await;
    let before = server.running().store().digest("room").await.unwrap();
    let begun = client.optimize_map(optimize("room")).await.unwrap().into_inner();
    let request = v1::CancelOperationRequest { operation_id: begun.id.clone() };
    client.cancel_operation(request.clone()).await.unwrap();
    let operation = ended(&mut client, &begun.id).await;
    if operation.state() == OperationState::Cancelled {
        assert_eq!(server.running().store().digest("room").await.unwrap(), before);
        assert!(operation.result.is_none() && operation.message.contains("nothing was changed"));
    }
    // One that has ended stays as it is.
    let again = client.cancel_operation(request).await.unwrap().into_inner();
    assert_eq!(again, operation);
    client.optimize_map(optimize("room")).await.unwrap();
    let begin = std::time::Instant::now();
    let (outcome, _folder) = server.shut_down().await;
    assert_eq!(outcome, server::Shutdown::Complete);
    assert!(begin.elapsed() < Duration::from_secs(20), "it took {:?}", begin.elapsed());
}

#[tokio::test(flavor = "multi_thread")]
async fn operations_of_others_are_not_there() {
    let world = SmallWorld::new(1);
    let server = TestServer::start().await;
    let ann = server.token("ann", TokenRole::Writer).await;
    let bob = server.token("bob", TokenRole::Writer).await;
    let mut client = server.client().await;
    let (session_id, camera) = ("kitchen".to_owned(), Some(world.camera()));
    let new = v1::CreateSessionRequest { session_id, camera, ..v1::CreateSessionRequest::default() };
    client.create_session(with_token(&ann, new)).await.unwrap();
    let begun = client.optimize_map(with_token(&ann, optimize("kitchen"))).await.unwrap().into_inner();
    assert_eq!(begun.session_id, "kitchen");
    let get = || v1::GetOperationRequest { operation_id: begun.id.clone() };
    let cancel = v1::CancelOperationRequest { operation_id: begun.id.clone() };
    assert_eq!(client.get_operation(with_token(&bob, get())).await.unwrap_err().code(), Code::NotFound);
    assert_eq!(client.cancel_operation(with_token(&bob, cancel)).await.unwrap_err().code(), Code::NotFound);
    let list = v1::ListOperationsRequest::default();
    let listed = client.list_operations(with_token(&bob, list.clone())).await.unwrap().into_inner();
    assert_eq!(listed.operations, []);
    let own = client.list_operations(with_token(&ann, list)).await.unwrap().into_inner();
    assert_eq!(own.operations.len(), 1);
    assert_eq!(client.get_operation(with_token(&ann, get())).await.unwrap().into_inner().id, begun.id);
}

/// Streams frames of a world into a new session of its own.
async fn map(client: &mut Client, id: &str, world: &SmallWorld, frames: std::ops::Range<usize>) {
    create_session(client, id, world.camera()).await.unwrap();
    let stream = FrameStream::open(client, open_message(id)).await.unwrap();
    let n = frames.len();
    let n_tracked = stream_frames(stream, world, frames).await;
    assert!(n_tracked > n / 3, "{id}: only {n_tracked} of {n} frames were tracked");
}

#[tokio::test(flavor = "multi_thread")]
async fn two_maps_of_one_room_become_one_and_two_rooms_stay_two() {
    let world = SmallWorld::new(1);
    let (server, mut client) = mapped_room().await;
    map(&mut client, "later", &world, 20..N_FRAMES + 15).await;
    map(&mut client, "elsewhere", &SmallWorld::new(3), 0..30).await;
    let store = server.running().store();
    let digests = async || {
        let [into, from] = ["room", "elsewhere"].map(|id| store.digest(id));
        (into.await.unwrap(), from.await.unwrap())
    };
    let before = digests().await;
    let merge = |from: &str| v1::MergeSessionsRequest { into: "room".to_owned(), from: from.to_owned() };
    let begun = client.merge_sessions(merge("elsewhere")).await.unwrap().into_inner();
    let nothing = ended(&mut client, &begun.id).await;
    let Some(Outcome::Merged(result)) = &nothing.result else { panic!("{nothing:?}") };
    assert!(!result.found && nothing.message.contains("nothing was changed"), "{nothing:?}");
    assert_eq!(digests().await, before, "something was changed though nothing was found");

    let counts = async |id: &str| server.get_json(&format!("/v1/sessions/{id}")).await;
    let (room, later) = (counts("room").await, counts("later").await);
    let url = format!("http://{}/v1/sessions/room/merge", server.running().http_addr);
    let answer = reqwest::Client::new().post(url).json(&json!({"from": "later"})).send().await.unwrap();
    assert_eq!(answer.status(), 202);
    let begun: Value = answer.json().await.unwrap();
    let joined = ended(&mut client, begun["id"].as_str().unwrap()).await;
    let Some(Outcome::Merged(result)) = &joined.result else { panic!("{joined:?}") };
    assert!(result.found && !result.places.is_empty(), "{joined:?}");
    assert_eq!(store.check().await.unwrap().len(), 0, "{:?}", store.check().await);
    let number = |session: &Value, count: &str| session[count].as_u64().unwrap();
    let now = counts("room").await;
    assert_eq!(number(&now, "n_frames"), number(&room, "n_frames") + number(&later, "n_frames"));
    assert_eq!(number(&now, "n_keyframes"), number(&room, "n_keyframes") + number(&later, "n_keyframes"));
    assert_eq!(number(&now, "n_submaps"), 1, "{joined:?}");
    assert!(number(&now, "n_points") < number(&room, "n_points") + number(&later, "n_points"));
    assert_eq!(counts("later").await["n_keyframes"], later["n_keyframes"], "what was taken in stays");
    // The images of keyframes came along.
    let keyframes = server.get_json("/v1/sessions/room/keyframes?page_size=1000").await;
    let keyframes = keyframes["keyframes"].as_array().unwrap();
    assert!(keyframes.iter().all(|keyframe| keyframe["has_image"] == true));
    check_positions(&server, &world, result).await;

    let same = client.merge_sessions(merge("room")).await.unwrap_err();
    assert_eq!(same.code(), Code::InvalidArgument);
    create_session(&mut client, "other-camera", tests::camera(320, 240)).await.unwrap();
    let begun = client.merge_sessions(merge("other-camera")).await.unwrap().into_inner();
    let refused = ended(&mut client, &begun.id).await;
    assert_eq!((refused.state(), &refused.error_code[..]), (OperationState::Failed, "CANNOT_MERGE"));
}

/// Frames of both recordings are where the truth has them, by one similarity.
async fn check_positions(server: &TestServer, world: &SmallWorld, result: &v1::MergeResult) {
    let trajectory = server.get_json("/v1/sessions/room/trajectory?format=json").await;
    let poses = trajectory["poses"].as_array().unwrap();
    let (mut estimated, mut truth) = (Vec::new(), Vec::new());
    let mut n_taken_in = 0;
    for pose in poses {
        let sequence = pose["sequence"].as_i64().unwrap();
        let taken_in = sequence >= N_FRAMES as i64;
        n_taken_in += usize::from(taken_in);
        let frame = if taken_in { sequence - result.sequence_shift } else { sequence };
        let place = ["tx", "ty", "tz"].map(|axis| pose["world_from_camera"][axis].as_f64().unwrap());
        estimated.push(geometry::nalgebra::Vector3::from(place));
        truth.push(geometry::nalgebra::Vector3::from(world.camera_position(frame as usize)));
    }
    assert!(n_taken_in > 20, "{n_taken_in} of {}", poses.len());
    let fitted = geometry::Similarity::from_correspondences(&estimated, &truth, true).unwrap();
    let errors: Vec<f64> =
        estimated.iter().zip(&truth).map(|(place, truth)| (fitted.transform(place) - truth).norm()).collect();
    let rms = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
    assert!(rms < 0.1, "{rms} m off, at most {:?}", errors.iter().copied().fold(0.0, f64::max));
}
