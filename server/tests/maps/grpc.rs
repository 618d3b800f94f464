//! The gRPC interface says of a map what the HTTP interface says, over real sockets.

use crate::api::store_map;
use crate::rounded::rounded;
use proto::v1;
use proto::v1::export_map_response::Part;
use serde_json::{Value, json};
use slam::map::{MapParts, SubmapId};
use std::time::{Duration, Instant};
use testkit::world::{SMALL, Size, structured};
use tests::{Client, TestServer};
use tonic::{Code, Request, Status, Streaming};
use tonic_types::StatusExt;

/// Points enough for several messages.
const LARGE: Size = Size { n_keyframes: 20, n_keypoints: 400, n_points: 1700 };
/// As small as a world gets: to be read by people.
const TINY: Size = Size { n_keyframes: 4, n_keypoints: 12, n_points: 5 };

async fn serve(world: &MapParts) -> (TestServer, Client) {
    let folder = tempfile::tempdir().unwrap();
    store_map(folder.path(), world, &[]).await;
    let server = TestServer::start_on_copy(folder.path()).await;
    let client = server.client().await;
    (server, client)
}

/// A server with a map in two submaps whose scale is known.
async fn large_world() -> (TestServer, Client) {
    let mut world = structured(7, LARGE);
    world.points.iter_mut().for_each(|point| point.submap = SubmapId((point.id.get() % 2) as u32));
    let (server, mut client) = serve(&world).await;
    let scale = v1::SetScaleRequest { session_id: "s".into(), metres_per_unit: Some(2.5), reference: None };
    client.set_scale(scale).await.unwrap();
    (server, client)
}

async fn read<M>(answer: Result<tonic::Response<Streaming<M>>, Status>) -> Vec<M> {
    let (mut messages, mut all) = (answer.unwrap().into_inner(), Vec::new());
    while let Some(message) = messages.message().await.unwrap() {
        all.push(message);
    }
    all
}

/// Rows of every page.
async fn pages(server: &TestServer, path: &str, rows: &str) -> Vec<Value> {
    let (mut all, mut token) = (Vec::new(), String::new());
    loop {
        let separator = if path.contains('?') { '&' } else { '?' };
        let address = format!("/v1/sessions/s/{path}{separator}page_size=1000&page_token={token}");
        let page = server.get_json(&address).await;
        if rows != "primitives" {
            assert_eq!(page["scale"], "metric");
        }
        all.extend(page[rows].as_array().unwrap().iter().cloned());
        match page["next_page_token"].as_str() {
            Some(next) => token = next.to_owned(),
            None => return all,
        }
    }
}

fn numbers(vector: Option<v1::Vector3>) -> Value {
    let v1::Vector3 { x, y, z } = vector.expect("a vector is there");
    json!([x, y, z])
}

fn pose(pose: Option<v1::Pose>) -> Value {
    let v1::Pose { tx, ty, tz, qx, qy, qz, qw } = pose.expect("a pose is there");
    json!({ "tx": tx, "ty": ty, "tz": tz, "qx": qx, "qy": qy, "qz": qz, "qw": qw })
}

fn vector([x, y, z]: [f64; 3]) -> Option<v1::Vector3> {
    Some(v1::Vector3 { x, y, z })
}

async fn streamed_points(client: &mut Client, request: v1::QueryPointsRequest) -> Vec<Value> {
    let messages = read(client.query_points(request).await).await;
    assert!(messages.iter().all(|message| message.scale() == v1::ScaleKind::Metric));
    let points = messages.into_iter().flat_map(|message| message.points);
    let row = |point: v1::Point| {
        json!({
            "id": point.id, "submap_id": point.submap_id, "position": numbers(point.position),
            "n_observations": point.n_observations,
        })
    };
    points.map(row).collect()
}

async fn streamed_lines(client: &mut Client, request: v1::QueryLinesRequest) -> Vec<Value> {
    let messages = read(client.query_lines(request).await).await;
    assert!(messages.iter().all(|message| message.scale() == v1::ScaleKind::Metric));
    let lines = messages.into_iter().flat_map(|message| message.lines);
    let row = |line: v1::Line| {
        json!({
            "id": line.id, "submap_id": line.submap_id, "start": numbers(line.start), "end": numbers(line.end),
            "direction": numbers(line.direction), "moment": numbers(line.moment),
            "n_observations": line.n_observations, "primitive_id": line.primitive_id,
        })
    };
    lines.map(row).collect()
}

#[tokio::test]
async fn points_are_streamed_that_are_paged_under_every_condition() {
    let (server, mut client) = large_world().await;
    let all = || v1::QueryPointsRequest { session_id: "s".into(), ..Default::default() };
    let bbox = Some(v1::BoundingBox { min: vector([-5.0, -4.0, -6.0]), max: vector([7.0, 5.0, 4.0]) });
    let (near, radius) = (vector([1.0, -2.0, 3.0]), Some(6.5));
    let cases = [
        ("points", all()),
        ("points?bbox=-5,-4,-6,7,5,4", v1::QueryPointsRequest { bbox, ..all() }),
        ("points?near=1,-2,3&radius=6.5", v1::QueryPointsRequest { near, radius, ..all() }),
        ("points?min_observations=4", v1::QueryPointsRequest { min_observations: 4, ..all() }),
        ("points?submap_id=1", v1::QueryPointsRequest { submap_id: Some(1), ..all() }),
        ("points?submap_id=9", v1::QueryPointsRequest { submap_id: Some(9), ..all() }),
        (
            "points?bbox=-5,-4,-6,7,5,4&near=1,-2,3&radius=6.5&min_observations=3&submap_id=0",
            v1::QueryPointsRequest { bbox, near, radius, min_observations: 3, submap_id: Some(0), ..all() },
        ),
    ];
    let mut counts = Vec::new();
    for (path, request) in cases {
        let streamed = streamed_points(&mut client, request).await;
        assert_eq!(streamed, pages(&server, path, "points").await, "{path}");
        counts.push(streamed.len());
    }
    assert_eq!((counts[0], counts[5]), (LARGE.n_points as usize, 0));
    assert!(
        counts[1..5].iter().all(|n| (1..counts[0]).contains(n)),
        "a condition decides nothing: {counts:?}"
    );
    assert!((1..counts[1].min(counts[2])).contains(&counts[6]), "{counts:?}");
    let n_messages = read(client.query_points(all()).await).await.len();
    assert!((2..100).contains(&n_messages), "{n_messages} messages for {} points", counts[0]);
}

#[tokio::test]
async fn lines_are_streamed_that_are_paged_under_every_condition() {
    let (server, mut client) = large_world().await;
    let all = || v1::QueryLinesRequest { session_id: "s".into(), ..Default::default() };
    let bbox = Some(v1::BoundingBox { min: vector([-5.0, -4.0, -6.0]), max: vector([0.0, 5.0, 4.0]) });
    let (near, radius) = (vector([1.0, -2.0, 3.0]), Some(4.5));
    let cases = [
        ("lines", all()),
        ("lines?bbox=-5,-4,-6,0,5,4", v1::QueryLinesRequest { bbox, ..all() }),
        ("lines?near=1,-2,3&radius=4.5", v1::QueryLinesRequest { near, radius, ..all() }),
        ("lines?min_observations=4", v1::QueryLinesRequest { min_observations: 4, ..all() }),
        ("lines?primitive_id=2", v1::QueryLinesRequest { primitive_id: Some(2), ..all() }),
        ("lines?submap_id=1", v1::QueryLinesRequest { submap_id: Some(1), ..all() }),
    ];
    let mut counts = Vec::new();
    for (path, request) in cases {
        let streamed = streamed_lines(&mut client, request).await;
        assert_eq!(streamed, pages(&server, path, "lines").await, "{path}");
        counts.push(streamed.len());
    }
    assert_eq!((counts[0], counts[5]), (25, 0));
    assert!(counts[1..5].iter().all(|n| (1..25).contains(n)), "a condition decides nothing: {counts:?}");
}

#[tokio::test]
async fn key_frames_and_primitives_are_streamed_that_are_paged() {
    let (server, mut client) = large_world().await;
    let messages =
        read(client.list_keyframes(v1::ListKeyframesRequest { session_id: "s".into() }).await).await;
    let row = |keyframe: v1::Keyframe| {
        json!({
            "id": keyframe.id, "submap_id": keyframe.submap_id, "sequence": keyframe.sequence,
            "timestamp_ns": keyframe.timestamp_ns,
            "timestamp_ns_text": keyframe.timestamp_ns.to_string(), "world_from_camera": pose(keyframe.pose_world_from_camera),
            "parent": keyframe.parent, "n_keypoints": keyframe.n_keypoints, "n_points": keyframe.n_points,
            "n_segments": keyframe.n_segments, "n_lines": keyframe.n_lines, "has_image": keyframe.has_image,
        })
    };
    assert!(messages.iter().all(|message| message.scale() == v1::ScaleKind::Metric));
    let streamed: Vec<Value> = messages.into_iter().flat_map(|message| message.keyframes).map(row).collect();
    assert_eq!(streamed.len(), LARGE.n_keyframes as usize);
    assert_eq!(streamed, pages(&server, "keyframes", "keyframes").await);

    for (submap_id, path, n) in [(None, "primitives", 4), (Some(3), "primitives?submap_id=3", 0)] {
        let request = v1::ListPrimitivesRequest { session_id: "s".into(), submap_id };
        let messages = read(client.list_primitives(request).await).await;
        let row = |primitive: v1::Primitive| {
            let covariance: Vec<&[f64]> = primitive.covariance.chunks(3).collect();
            json!({
                "id": primitive.id, "submap_id": primitive.submap_id, "direction": numbers(primitive.direction),
                "covariance": covariance, "std_deg": primitive.std_deg, "n_keyframes": primitive.n_keyframes,
                "n_lines": primitive.n_lines,
            })
        };
        let streamed: Vec<Value> =
            messages.into_iter().flat_map(|message| message.primitives).map(row).collect();
        assert_eq!((streamed.len(), streamed), (n, pages(&server, path, "primitives").await));
    }
}

#[tokio::test]
async fn trajectories_are_streamed_that_are_written() {
    let (server, mut client) = large_world().await;
    let all = || v1::GetTrajectoryRequest { session_id: "s".into(), ..Default::default() };
    let (from, to) = (Some(200_000_000), Some(700_000_000));
    let keyframes = v1::TrajectoryKind::Keyframes.into();
    let cases = [
        ("", 20, all()),
        ("&kind=keyframes", 2, v1::GetTrajectoryRequest { kind: keyframes, ..all() }),
        (
            "&from_timestamp_ns=200000000&to_timestamp_ns=700000000",
            11,
            v1::GetTrajectoryRequest { from_timestamp_ns: from, to_timestamp_ns: to, ..all() },
        ),
        ("&submap_id=0", 20, v1::GetTrajectoryRequest { submap_id: Some(0), ..all() }),
        ("&submap_id=5", 0, v1::GetTrajectoryRequest { submap_id: Some(5), ..all() }),
    ];
    for (conditions, n, request) in cases {
        let messages = read(client.get_trajectory(request).await).await;
        assert!(messages.iter().all(|message| message.scale() == v1::ScaleKind::Metric));
        let row = |row: v1::TrajectoryPose| {
            assert_eq!(row.state(), v1::TrackingState::Tracked);
            json!({
                "sequence": row.sequence, "timestamp_ns": row.timestamp_ns,
                "timestamp_ns_text": row.timestamp_ns.to_string(), "state": "tracked",
                "submap_id": row.submap_id, "backfilled": row.backfilled,
                "world_from_camera": pose(row.pose_world_from_camera),
            })
        };
        let streamed: Vec<Value> = messages.into_iter().flat_map(|message| message.poses).map(row).collect();
        let written = server.get_json(&format!("/v1/sessions/s/trajectory?format=json{conditions}")).await;
        assert_eq!(streamed.len(), n, "{conditions}");
        assert_eq!(json!(streamed), written["poses"], "{conditions}");
    }
}

async fn exported(client: &mut Client, request: v1::ExportMapRequest) -> (v1::MapFile, Vec<u8>) {
    let mut parts =
        read(client.export_map(request).await).await.into_iter().map(|message| message.part.unwrap());
    let Some(Part::File(file)) = parts.next() else { panic!("the file is told first") };
    let data = parts.flat_map(|part| match part {
        Part::Data(data) => data,
        Part::File(_) => panic!("the file is told twice"),
    });
    (file, data.collect())
}

#[tokio::test]
async fn files_are_the_same_to_the_last_byte() {
    use v1::MapFormat::{ColmapCameras, ColmapImages, ColmapPoints3d, Json, Ply};
    let (server, mut client) = large_world().await;
    for (format, path, name) in [
        (Ply, "format=ply", "s.ply"),
        (Json, "format=json", "s.json"),
        (ColmapCameras, "format=colmap&part=cameras", "cameras.txt"),
        (ColmapImages, "format=colmap&part=images", "images.txt"),
        (ColmapPoints3d, "format=colmap&part=points3D", "points3D.txt"),
    ] {
        let request =
            |submap_id| v1::ExportMapRequest { session_id: "s".into(), format: format.into(), submap_id };
        let (file, data) = exported(&mut client, request(None)).await;
        let address = format!("http://{}/v1/sessions/s/map?{path}", server.running().http_addr);
        let response = reqwest::get(&address).await.unwrap();
        let headers = response.headers().clone();
        assert_eq!(headers["content-type"], file.media_type.as_str(), "{path}");
        assert_eq!(
            headers["content-disposition"],
            format!("attachment; filename=\"{}\"", file.name).as_str()
        );
        assert_eq!((file.name.as_str(), file.n_bytes), (name, data.len() as u64));
        assert!(response.bytes().await.unwrap() == data, "{path}: the files differ");
        let (_, other) = exported(&mut client, request(Some(1))).await;
        let expected = server.get(&format!("/v1/sessions/s/map?{path}&submap_id=1")).await;
        assert!(expected.as_bytes() == other, "{path}: the files of a submap differ");
    }
}

fn field_of(status: &Status) -> String {
    assert_eq!(status.code(), Code::InvalidArgument, "{status:?}");
    status.get_error_details().bad_request().unwrap().field_violations[0].field.clone()
}

#[tokio::test]
async fn what_cannot_be_asked_is_refused_by_its_name() {
    let (_server, mut client) = serve(&structured(7, SMALL)).await;
    let all = || v1::QueryPointsRequest { session_id: "s".into(), ..Default::default() };
    let corner = || vector([0.0; 3]);
    let (min, max) = (corner(), vector([1.0, -1.0, 1.0]));
    let inside_out = Some(v1::BoundingBox { min, max });
    let half = Some(v1::BoundingBox { min, max: None });
    let endless = Some(v1::BoundingBox { min, max: vector([f64::INFINITY; 3]) });
    for (request, field) in [
        (v1::QueryPointsRequest { bbox: inside_out, ..all() }, "bbox"),
        (v1::QueryPointsRequest { bbox: endless, ..all() }, "bbox"),
        (v1::QueryPointsRequest { bbox: half, ..all() }, "bbox.max"),
        (v1::QueryPointsRequest { near: corner(), ..all() }, "radius"),
        (v1::QueryPointsRequest { radius: Some(1.0), ..all() }, "near"),
        (v1::QueryPointsRequest { near: corner(), radius: Some(-1.0), ..all() }, "radius"),
        (v1::QueryPointsRequest { near: corner(), radius: Some(f64::NAN), ..all() }, "radius"),
        (v1::QueryPointsRequest { session_id: "a/b".into(), ..all() }, "session_id"),
    ] {
        assert_eq!(field_of(&client.query_points(request).await.unwrap_err()), field);
    }
    let request = |primitive_id| v1::QueryLinesRequest {
        session_id: "s".into(),
        primitive_id: Some(primitive_id),
        ..Default::default()
    };
    for number in [0, u64::MAX] {
        assert_eq!(field_of(&client.query_lines(request(number)).await.unwrap_err()), "primitive_id");
    }
    let request = v1::GetTrajectoryRequest { session_id: "s".into(), kind: 77, ..Default::default() };
    assert_eq!(field_of(&client.get_trajectory(request).await.unwrap_err()), "kind");
    for format in [0, 77] {
        let request = v1::ExportMapRequest { session_id: "s".into(), format, submap_id: None };
        assert_eq!(field_of(&client.export_map(request).await.unwrap_err()), "format");
    }
}

#[tokio::test]
async fn a_session_that_is_not_there_is_not_found() {
    let (_server, mut client) = serve(&structured(7, SMALL)).await;
    let id = || "nobody".to_owned();
    let format = v1::MapFormat::Ply.into();
    let codes = [
        client.list_keyframes(v1::ListKeyframesRequest { session_id: id() }).await.err(),
        client.query_points(v1::QueryPointsRequest { session_id: id(), ..Default::default() }).await.err(),
        client.query_lines(v1::QueryLinesRequest { session_id: id(), ..Default::default() }).await.err(),
        client.list_primitives(v1::ListPrimitivesRequest { session_id: id(), submap_id: None }).await.err(),
        client
            .get_trajectory(v1::GetTrajectoryRequest { session_id: id(), ..Default::default() })
            .await
            .err(),
        client.export_map(v1::ExportMapRequest { session_id: id(), format, submap_id: None }).await.err(),
    ];
    for (idx, status) in codes.into_iter().enumerate() {
        let status = status.expect("nothing is told of a session that is not there");
        assert_eq!(status.code(), Code::NotFound, "{idx}");
        assert_eq!(status.get_error_details().error_info().unwrap().reason, "SESSION_NOT_FOUND");
    }
}

/// Points enough that an answer does not fit into what the transport holds for a client that does not read.
const HUGE: Size = Size { n_keyframes: 100, n_keypoints: 1200, n_points: 30_000 };
const PATIENCE: Duration = Duration::from_secs(60);

#[tokio::test]
async fn whoever_has_enough_ends_the_call_and_holds_nothing_up() {
    let (server, mut client) = serve(&structured(7, HUGE)).await;
    let request = || v1::QueryPointsRequest { session_id: "s".into(), ..Default::default() };
    let mut answer = client.query_points(request()).await.unwrap().into_inner();
    let first = answer.message().await.unwrap().expect("there are points");
    assert!(first.points.len() < 5_000, "{} points at once", first.points.len());
    drop(answer);
    // More calls at once than the database has readers; nobody reads their answers.
    let mut unread = Vec::new();
    for _ in 0..40 {
        unread.push(client.query_points(request()).await.unwrap().into_inner());
    }
    // A session can be deleted and the server can stop all the same: over another connection, since what
    // nobody reads has used up what this one may hold.
    let mut other = server.client().await;
    let delete = other.delete_session(v1::DeleteSessionRequest { session_id: "s".into() });
    tokio::time::timeout(PATIENCE, delete).await.expect("the session is deleted").unwrap();
    drop(unread);
    let begin = Instant::now();
    let (outcome, _folder) = server.shut_down().await;
    assert_eq!(outcome, server::Shutdown::Complete);
    assert!(begin.elapsed() < PATIENCE, "it took {:?}", begin.elapsed());
}

#[tokio::test]
async fn a_deadline_that_passes_while_a_file_is_prepared_ends_the_call() {
    let (server, mut client) = serve(&structured(7, HUGE)).await;
    let format = v1::MapFormat::Json.into();
    let mut request = Request::new(v1::ExportMapRequest { session_id: "s".into(), format, submap_id: None });
    request.set_timeout(Duration::from_millis(1));
    let status = client.export_map(request).await.unwrap_err();
    assert!(matches!(status.code(), Code::DeadlineExceeded | Code::Cancelled), "{status:?}");
    assert_eq!(server.shut_down().await.0, server::Shutdown::Complete);
}

#[tokio::test]
async fn reflection_tells_every_question() {
    use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
    use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
    use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;
    let (server, _client) = serve(&structured(7, SMALL)).await;
    let address = format!("http://{}", server.running().grpc_addr);
    let channel = tonic::transport::Channel::from_shared(address).unwrap().connect().await.unwrap();
    let request = tonic_reflection::pb::v1::ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::FileContainingSymbol("monoslam.v1.SlamService".into())),
    };
    let asked =
        ServerReflectionClient::new(channel).server_reflection_info(tokio_stream::iter([request])).await;
    let answer = asked.unwrap().into_inner().message().await.unwrap().unwrap();
    let Some(MessageResponse::FileDescriptorResponse(files)) = answer.message_response else {
        panic!("no file tells of the service: {answer:?}")
    };
    let file: prost_types::FileDescriptorProto =
        prost::Message::decode(&files.file_descriptor_proto[0][..]).unwrap();
    let methods = &file.service[0].method;
    for name in ["ListKeyframes", "QueryPoints", "QueryLines", "ListPrimitives", "GetTrajectory", "ExportMap"]
    {
        let method = methods.iter().find(|method| method.name() == name);
        assert!(method.is_some_and(|method| method.server_streaming()), "{name} is not told");
    }
}

#[tokio::test]
async fn answers_look_like_this() {
    let (_server, mut client) = serve(&structured(7, TINY)).await;
    let session_id = || "s".to_owned();
    let snapshot = |name: &str, text: String| insta::assert_snapshot!(format!("rpc_{name}"), rounded(&text));
    let keyframes = client.list_keyframes(v1::ListKeyframesRequest { session_id: session_id() }).await;
    snapshot("list_keyframes", format!("{:#?}", read(keyframes).await));
    let points = v1::QueryPointsRequest { session_id: session_id(), ..Default::default() };
    snapshot("query_points", format!("{:#?}", read(client.query_points(points).await).await));
    let lines =
        v1::QueryLinesRequest { session_id: session_id(), primitive_id: Some(2), ..Default::default() };
    snapshot("query_lines", format!("{:#?}", read(client.query_lines(lines).await).await));
    let primitives = v1::ListPrimitivesRequest { session_id: session_id(), submap_id: None };
    snapshot("list_primitives", format!("{:#?}", read(client.list_primitives(primitives).await).await));
    let to_timestamp_ns = Some(200_000_000);
    let trajectory =
        v1::GetTrajectoryRequest { session_id: session_id(), to_timestamp_ns, ..Default::default() };
    snapshot("get_trajectory", format!("{:#?}", read(client.get_trajectory(trajectory).await).await));
    let format = v1::MapFormat::ColmapPoints3d.into();
    let map = v1::ExportMapRequest { session_id: session_id(), format, submap_id: None };
    let (file, data) = exported(&mut client, map).await;
    let file = v1::MapFile { n_bytes: 0, ..file };
    snapshot("export_map", format!("{file:#?}\n{}", String::from_utf8(data).unwrap()));
}
