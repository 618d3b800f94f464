//! What can be asked of a map: lines, primitives, graphs, files, places, and what happens in it.
//!
//! How many lines a small room gives is not what these tests are about: they hold with none.

use proto::v1;
use proto::v1::session_event::Event;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;
use store::TableDigest;
use tempfile::TempDir;
use tests::{Client, FrameStream, SmallWorld, TestServer, create_session, open_message};
use tokio::sync::OnceCell;
use tonic::Code;

/// Frames of the room that are streamed: six seconds.
pub const N_FRAMES: usize = 60;
/// Longer than any event may take on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// Streams frames to the end of the stream; how many were tracked.
pub async fn stream_frames(
    mut stream: FrameStream,
    world: &SmallWorld,
    frames: std::ops::Range<usize>,
) -> usize {
    let mut n_tracked = 0;
    for i in frames {
        stream.send(Request::Frame(world.frame(i))).await;
        match stream.next().await.unwrap() {
            Some(Response::Result(result)) => {
                n_tracked += usize::from(result.pose_world_from_camera.is_some())
            }
            other => panic!("frame {i} was not tracked: {other:?}"),
        }
    }
    stream.finish().await.unwrap();
    n_tracked
}

/// A server with a mapped room that is not in memory. The room is mapped once, and each server has a copy.
pub async fn mapped_room() -> (TestServer, Client) {
    static MAPPED: OnceCell<TempDir> = OnceCell::const_new();
    let mapped = MAPPED.get_or_init(map_room).await;
    let server = TestServer::start_on_copy(mapped.path()).await;
    let client = server.client().await;
    (server, client)
}

async fn map_room() -> TempDir {
    let world = SmallWorld::new(1);
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let n_tracked = stream_frames(stream, &world, 0..N_FRAMES).await;
    assert!(n_tracked > N_FRAMES / 3, "only {n_tracked} of {N_FRAMES} frames were tracked");
    let (outcome, folder) = server.shut_down().await;
    assert_eq!(outcome, server::Shutdown::Complete);
    folder
}

/// Fingerprints of what belongs to the map, without the trajectory and the session's row.
async fn map_digest(server: &TestServer) -> Vec<TableDigest> {
    let digest = server.running().store().digest("room").await.unwrap();
    digest.0.into_iter().filter(|table| !["sessions", "frames", "segments"].contains(&table.table)).collect()
}

fn ids(rows: &Value) -> BTreeSet<u64> {
    rows.as_array().unwrap().iter().map(|row| row["id"].as_u64().unwrap()).collect()
}

/// Rows of every page.
async fn all_pages(server: &TestServer, path: &str, rows: &str) -> Vec<Value> {
    let (mut all, mut token) = (Vec::new(), String::new());
    loop {
        let page = server.get_json(&format!("/v1/sessions/room/{path}?page_size=7&page_token={token}")).await;
        all.extend(page[rows].as_array().unwrap().iter().cloned());
        match page["next_page_token"].as_str() {
            Some(next) => token = next.to_owned(),
            None => return all,
        }
    }
}

#[tokio::test]
async fn a_map_is_asked_for_its_lines_primitives_graphs_and_files() {
    let world = SmallWorld::new(1);
    let (server, mut client) = mapped_room().await;
    // Answers come from the database: the session is not in memory.
    let session = server.get_json("/v1/sessions/room").await;
    assert_eq!(
        (session["loaded"].as_bool(), session["n_frames"].as_u64()),
        (Some(false), Some(N_FRAMES as u64))
    );
    assert_eq!(session["last_timestamp_ns"].as_i64(), Some(world.frame(N_FRAMES - 1).timestamp_ns));
    let request = v1::GetSessionRequest { session_id: "room".into() };
    let same = client.get_session(request).await.unwrap().into_inner();
    assert_eq!(same.last_timestamp_ns, session["last_timestamp_ns"].as_i64());
    assert_eq!(Some(same.n_lines), session["n_lines"].as_u64());

    check_lines_and_primitives(&server, &session).await;
    check_graphs(&server, &session).await;
    check_files(&server, &session).await;
    assert_eq!(server.get_json("/v1/sessions/room").await["loaded"], false, "a question loaded the session");
}

async fn check_lines_and_primitives(server: &TestServer, session: &Value) {
    let lines = all_pages(server, "lines", "lines").await;
    assert_eq!(Some(lines.len() as u64), session["n_lines"].as_u64());
    for line in lines.iter().take(20) {
        let [x, y, z] = [0, 1, 2].map(|axis| line["start"][axis].as_f64().unwrap());
        let near = server.get_json(&format!("/v1/sessions/room/lines?near={x},{y},{z}&radius=1e-9")).await;
        assert!(near["lines"].as_array().unwrap().contains(line), "{line} is not near its own end");
    }
    let primitives = all_pages(server, "primitives", "primitives").await;
    assert_eq!(Some(primitives.len() as u64), session["n_primitives"].as_u64());
    for primitive in &primitives {
        let id = &primitive["id"];
        let detail = server.get_json(&format!("/v1/sessions/room/primitives/{id}")).await;
        assert_eq!(detail["direction"], primitive["direction"]);
        assert_eq!(detail["lines"].as_array().unwrap().len() as u64, primitive["n_lines"].as_u64().unwrap());
        let lines_of_it = lines.iter().filter(|line| line["primitive_id"] == *id).count();
        assert_eq!(Some(lines_of_it as u64), primitive["n_lines"].as_u64());
    }
}

async fn check_graphs(server: &TestServer, session: &Value) {
    let keyframes = server.get_json("/v1/sessions/room/keyframes?page_size=1000").await;
    let known = ids(&keyframes["keyframes"]);
    for kind in ["covisibility", "essential", "primitives"] {
        let graph = server.get_json(&format!("/v1/sessions/room/graph?kind={kind}")).await;
        assert_eq!((graph["kind"].as_str(), graph["scale"].as_str()), (Some(kind), Some("up_to_scale")));
        assert_eq!(ids(&graph["nodes"]), known, "{kind}");
        for edge in graph["edges"].as_array().unwrap() {
            let ends = ["from", "to"].map(|end| edge[end].as_u64().unwrap());
            assert!(ends[0] != ends[1] && ends.iter().all(|end| known.contains(end)), "{kind}: {edge}");
        }
    }
    let graph = server.get_json("/v1/sessions/room/graph?kind=essential").await;
    let edges = graph["edges"].as_array().unwrap();
    let n_spanning = edges.iter().filter(|edge| edge["spanning"] == true).count();
    assert_eq!(
        n_spanning as u64,
        known.len() as u64 - session["n_submaps"].as_u64().unwrap(),
        "a tree per submap"
    );
    let covisible = server.get_json("/v1/sessions/room/graph").await;
    let n_pairs = covisible["edges"].as_array().unwrap().len();
    assert!(n_pairs >= n_spanning, "neighbours in the tree see points in common");
    let strong = server.get_json("/v1/sessions/room/graph?min_weight=50").await;
    let strong = strong["edges"].as_array().unwrap();
    assert!(strong.len() <= n_pairs && strong.iter().all(|edge| edge["weight"].as_u64() >= Some(50)));
}

async fn check_files(server: &TestServer, session: &Value) {
    let json = server.get_json("/v1/sessions/room/map?format=json").await;
    for (rows, count) in [
        ("keyframes", "n_keyframes"),
        ("points", "n_points"),
        ("lines", "n_lines"),
        ("primitives", "n_primitives"),
    ] {
        assert_eq!(Some(json[rows].as_array().unwrap().len() as u64), session[count].as_u64(), "{rows}");
    }
    assert_eq!(json["camera"], session["camera"]);
    let keyframe =
        server.get_json(&format!("/v1/sessions/room/keyframes/{}", json["keyframes"][0]["id"])).await;
    assert_eq!(json["keyframes"][0], keyframe);

    let ply = server.get("/v1/sessions/room/map?format=ply").await;
    let (head, body) = ply.split_once("end_header\n").unwrap();
    let count = |element: &str| -> usize {
        let line = head.lines().find_map(|line| line.strip_prefix(&format!("element {element} "))).unwrap();
        line.parse().unwrap()
    };
    assert!(head.starts_with("ply\nformat ascii 1.0\n") && count("vertex") > 50, "{head}");
    assert_eq!(body.lines().count(), count("vertex") + count("edge"));
    assert!(body.lines().take(count("vertex")).all(|line| line.split(' ').count() == 6));

    let part =
        async |part: &str| server.get(&format!("/v1/sessions/room/map?format=colmap&part={part}")).await;
    let data = |text: &str| {
        text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect::<Vec<_>>()
    };
    let cameras = data(&part("cameras").await);
    assert_eq!(cameras, ["1 PINHOLE 480 360 345 345 240 180"]);
    let images = data(&part("images").await);
    assert_eq!(images.len(), 2 * json["keyframes"].as_array().unwrap().len());
    let points = data(&part("points3D").await);
    assert_eq!(points.len(), json["points"].as_array().unwrap().len());
    check_tracks(&images, &points);
}

/// Each sighting is told by the point and by the image.
fn check_tracks(images: &[String], points: &[String]) {
    let mut told_by_images = BTreeSet::new();
    for image in images.chunks(2) {
        let id: u64 = image[0].split(' ').next().unwrap().parse().unwrap();
        assert!(image[0].ends_with(&format!("1 keyframe_{id:06}.png")), "{}", image[0]);
        let numbers: Vec<&str> = image[1].split(' ').collect();
        for (idx, keypoint) in numbers.chunks(3).enumerate() {
            let x: f64 = keypoint[0].parse().unwrap();
            assert!((0.0..=480.0).contains(&x), "{x}");
            if keypoint[2] != "-1" {
                told_by_images.insert((keypoint[2].parse::<u64>().unwrap(), id, idx as u64));
            }
        }
    }
    let mut told_by_points = BTreeSet::new();
    for point in points {
        let fields: Vec<&str> = point.split(' ').collect();
        for seen in fields[8..].chunks(2) {
            let [point, image, idx] =
                [fields[0], seen[0], seen[1]].map(|field| field.parse::<u64>().unwrap());
            told_by_points.insert((point, image, idx));
        }
    }
    assert_eq!(told_by_images, told_by_points);
}

#[tokio::test]
async fn one_image_is_located_without_a_trace_also_beside_a_writer() {
    let world = SmallWorld::new(1);
    let (server, mut client) = mapped_room().await;
    let before = server.running().store().digest("room").await.unwrap();
    let i = N_FRAMES - 10;
    let image = world.frame(i).image;
    let request =
        || v1::LocalizeRequest { session_id: "room".into(), image: image.clone(), ..Default::default() };
    let located = client.localize(request()).await.unwrap().into_inner();
    assert!(located.pose_world_from_camera.is_some() && located.n_inlier_points > 10, "{located:?}");
    assert_eq!((located.durable_sequence, located.submap_id), (Some(N_FRAMES as u64 - 1), 0));

    // The same place as the trajectory has it, as a share of how far the camera went.
    let trajectory = server.get_json("/v1/sessions/room/trajectory?format=json").await;
    let position = |pose: &Value| ["tx", "ty", "tz"].map(|axis| pose[axis].as_f64().unwrap());
    let distance =
        |a: [f64; 3], b: [f64; 3]| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
    let poses = trajectory["poses"].as_array().unwrap();
    let of_frame =
        |i: usize| poses.iter().find(|pose| pose["sequence"] == i).map(|pose| &pose["world_from_camera"]);
    let expected = position(of_frame(i).expect("the frame has a pose"));
    let path = distance(position(&poses[0]["world_from_camera"]), expected);
    let found = located.pose_world_from_camera.unwrap();
    let error = distance([found.tx, found.ty, found.tz], expected);
    assert!(error < 0.05 * path, "{error} off on a way of {path}");

    // Over HTTP as a file, while a client streams.
    let stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let png = tests::png(480, 360, &world.pixels(i)).data;
    let url = format!("http://{}/v1/sessions/room/localize", server.running().http_addr);
    let post = |media_type: &'static str, body: bytes::Bytes| {
        reqwest::Client::new().post(&url).header("content-type", media_type).body(body).send()
    };
    let answer: Value = post("image/png", png.clone()).await.unwrap().json().await.unwrap();
    assert_eq!(answer["n_inlier_points"].as_u64(), Some(located.n_inlier_points.into()), "{answer}");
    assert_eq!(answer["world_from_camera"]["tx"].as_f64(), Some(found.tx), "the same image, the same answer");
    stream.finish().await.unwrap();
    assert_eq!(server.running().store().digest("room").await.unwrap(), before, "something was stored");

    // A place that is not in the map is an answer; what is no image is not.
    let gray = tests::png(480, 360, &[90; 480 * 360]).data;
    let lost: Value = post("image/png", gray).await.unwrap().json().await.unwrap();
    assert_eq!((lost["state"].as_str(), &lost["world_from_camera"]), (Some("lost"), &Value::Null), "{lost}");
    assert!(!lost["reason"].as_str().unwrap().is_empty());
    for (media_type, body, field) in [
        ("image/png", png.slice(..200), "image.data"),
        ("image/png", bytes::Bytes::from_static(b"no image"), "image.data"),
    ] {
        let answer = post(media_type, body).await.unwrap();
        assert_eq!(answer.status(), 400, "{field}");
        let problem: Value = answer.json().await.unwrap();
        assert_eq!(problem["violations"][0]["field"], field, "{problem}");
    }
    // The bytes say what an image is, but not that a text is one.
    assert_eq!(post("image/jpeg", png.clone()).await.unwrap().status(), 200);
    assert_eq!(post("text/plain", png).await.unwrap().status(), 415);
    let nothing = v1::LocalizeRequest { session_id: "room".into(), ..Default::default() };
    let status = client.localize(nothing).await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument);
}

#[tokio::test]
async fn streams_that_only_localize_leave_every_table_of_the_map_as_it_is() {
    let world = SmallWorld::new(1);
    let (server, mut client) = mapped_room().await;
    let before = map_digest(&server).await;
    assert_eq!(before.len(), 13, "every table but those of the session and the trajectory");
    let open = v1::OpenStream { mode: v1::StreamMode::LocalizeOnly.into(), ..open_message("room") };
    let stream = FrameStream::open(&mut client, open).await.unwrap();
    let n_located = stream_frames(stream, &world, N_FRAMES..N_FRAMES + 20).await;
    assert!(n_located > 10, "only {n_located} of 20 frames were located");
    assert_eq!(map_digest(&server).await, before);
    let problems = server.running().store().check().await.unwrap();
    assert!(problems.is_empty(), "{problems:?}");
}

#[tokio::test]
async fn a_watcher_sees_frames_map_changes_and_settings_until_the_session_goes() {
    let world = SmallWorld::new(1);
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let request = v1::WatchMapRequest { session_id: "room".into() };
    let mut events = client.watch_map(request.clone()).await.unwrap().into_inner();
    let mut next = async || {
        let event = tokio::time::timeout(PATIENCE, events.message()).await.expect("an event comes").unwrap();
        event.map(|event| event.event.expect("no event is empty"))
    };
    assert!(matches!(next().await, Some(Event::Session(session)) if session.id == "room"));
    let sse =
        reqwest::get(format!("http://{}/v1/sessions/room/events", server.running().http_addr)).await.unwrap();
    assert_eq!(sse.headers()["content-type"], "text/event-stream");

    let stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let watching = tokio::spawn({
        let mut client = client.clone();
        async move {
            client
                .set_scale(v1::SetScaleRequest {
                    session_id: "room".into(),
                    metres_per_unit: Some(2.0),
                    reference: None,
                })
                .await
        }
    });
    stream_frames(stream, &world, 0..30).await;
    watching.await.unwrap().unwrap();
    client.delete_session(v1::DeleteSessionRequest { session_id: "room".into() }).await.unwrap();

    let (mut n_frames, mut n_missed, mut is_metric, mut last_map) = (0, 0, false, None);
    while let Some(event) = next().await {
        match event {
            Event::Frame(_) => n_frames += 1,
            Event::Map(change) => last_map = Some(change),
            Event::Missed(n) => n_missed += n,
            Event::Session(session) => is_metric = session.metres_per_unit == Some(2.0),
        }
    }
    assert!(n_frames == 30 || n_missed > 0, "{n_frames} frames were told, {n_missed} events missed");
    assert!(is_metric || n_missed > 0);
    assert!(last_map.is_none_or(|change| change.n_keyframes > 0));
    let text = tokio::time::timeout(PATIENCE, sse.text()).await.expect("the events end").unwrap();
    assert!(text.starts_with("event: session\ndata: {"), "{text}");
    assert!(text.contains("event: frame\ndata: {\"sequence\":0,"), "{text}");
    let status = client.watch_map(request).await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
}

#[tokio::test]
async fn watchers_do_not_hold_a_shutdown_up() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "room", tests::camera(320, 240)).await.unwrap();
    let request = v1::WatchMapRequest { session_id: "room".into() };
    let mut events = client.watch_map(request).await.unwrap().into_inner();
    let sse =
        reqwest::get(format!("http://{}/v1/sessions/room/events", server.running().http_addr)).await.unwrap();
    assert!(events.message().await.unwrap().is_some());
    let begin = std::time::Instant::now();
    let (outcome, _folder) = server.shut_down().await;
    assert_eq!(outcome, server::Shutdown::Complete);
    assert!(begin.elapsed() < Duration::from_secs(10), "it took {:?}", begin.elapsed());
    assert!(matches!(events.message().await, Ok(None) | Err(_)));
    assert!(sse.text().await.is_ok_and(|text| text.starts_with("event: session")));
}

#[tokio::test]
async fn scale_and_options_are_changed_and_lengths_follow() {
    let world = SmallWorld::new(1);
    let (server, mut client) = mapped_room().await;
    let address = format!("http://{}/v1/sessions/room", server.running().http_addr);
    let http = reqwest::Client::new();
    let points = server.get_json("/v1/sessions/room/points?page_size=1").await;
    let x = points["points"][0]["position"][0].as_f64().unwrap();

    let scaled: Value = http
        .post(format!("{address}/scale"))
        .json(&json!({"metres_per_unit": 2.5}))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!((scaled["scale"].as_str(), scaled["metres_per_unit"].as_f64()), (Some("metric"), Some(2.5)));
    let metric = server.get_json("/v1/sessions/room/points?page_size=1").await;
    assert_eq!(metric["scale"], "metric");
    assert!((metric["points"][0]["position"][0].as_f64().unwrap() - 2.5 * x).abs() <= 1e-9 * x.abs());
    let [x, y, z] = [0, 1, 2].map(|axis| metric["points"][0]["position"][axis].as_f64().unwrap());
    let near = server.get_json(&format!("/v1/sessions/room/points?near={x},{y},{z}&radius=1e-6")).await;
    assert_eq!(near["points"][0], metric["points"][0], "a place is asked for in the unit it is told in");
    let located =
        v1::LocalizeRequest { session_id: "room".into(), image: world.frame(50).image, ..Default::default() };
    let located = client.localize(located);
    assert_eq!(located.await.unwrap().into_inner().scale(), v1::ScaleKind::Metric);
    let freed = v1::SetScaleRequest { session_id: "room".into(), ..Default::default() };
    assert_eq!(client.set_scale(freed).await.unwrap().into_inner().metres_per_unit, None);
    for wrong in [json!({"metres_per_unit": 0.0}), json!({"metres_per_unit": -1.0}), json!({})] {
        let answer = http.post(format!("{address}/scale")).json(&wrong).send().await.unwrap();
        assert_eq!(answer.status(), 400, "{wrong}");
    }

    let patch = async |options: Value| {
        http.patch(&address).json(&json!({ "options": options })).send().await.unwrap()
    };
    let changed: Value = patch(json!({"lines": false, "seed": 9})).await.json().await.unwrap();
    assert_eq!(
        (changed["options"]["lines"].as_bool(), changed["options"]["seed"].as_u64()),
        (Some(false), Some(9))
    );
    let refused = patch(json!({"global_primitives": true})).await;
    assert_eq!(refused.status(), 400);
    let problem: Value = refused.json().await.unwrap();
    assert_eq!(problem["violations"][0]["field"], "options.global_primitives", "{problem}");
    let stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    assert_eq!(patch(json!({"lines": true})).await.status(), 409);
    stream.finish().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_known_already_is_not_sent_again_and_the_rest_is_compressed() {
    let (server, mut client) = mapped_room().await;
    let http = reqwest::Client::new();
    let get = async |path: &str, header: (&str, &str)| {
        let url = format!("http://{}/v1/sessions/room/{path}", server.running().http_addr);
        http.get(url).header(header.0, header.1).send().await.unwrap()
    };
    for path in ["keyframes", "points?page_size=5", "map?format=ply", "trajectory", "graph"] {
        let first = get(path, ("accept", "*/*")).await;
        let tag = first.headers()["etag"].to_str().unwrap().to_owned();
        let again = get(path, ("if-none-match", &tag)).await;
        assert_eq!(
            (again.status().as_u16(), again.headers()["etag"].to_str().unwrap()),
            (304, &tag[..]),
            "{path}"
        );
        assert!(again.bytes().await.unwrap().is_empty(), "{path}");
        assert_eq!(get(path, ("if-none-match", "\"other\"")).await.status(), 200, "{path}");
        let packed = get(path, ("accept-encoding", "gzip")).await;
        assert_eq!(packed.headers()["content-encoding"], "gzip", "{path}");
        let (packed, plain) = (packed.bytes().await.unwrap(), first.bytes().await.unwrap());
        assert!(packed.len() < plain.len() && packed[..2] == [0x1f, 0x8b], "{path}");
    }
    let tag = get("keyframes", ("accept", "*/*")).await.headers()["etag"].clone();
    let scale =
        v1::SetScaleRequest { session_id: "room".into(), metres_per_unit: Some(2.0), reference: None };
    client.set_scale(scale).await.unwrap();
    let scaled = get("keyframes", ("if-none-match", tag.to_str().unwrap())).await;
    assert_eq!(scaled.status(), 200, "lengths mean something else now");

    // Over gRPC by who asks for it, both ways.
    for encoding in [tonic::codec::CompressionEncoding::Gzip, tonic::codec::CompressionEncoding::Zstd] {
        let mut packing = server.client().await.accept_compressed(encoding).send_compressed(encoding);
        let request = v1::QueryPointsRequest { session_id: "room".into(), ..Default::default() };
        let answer = packing.query_points(request).await.unwrap();
        let used = answer.metadata().get("grpc-encoding").and_then(|value| value.to_str().ok());
        let expected = if encoding == tonic::codec::CompressionEncoding::Gzip { "gzip" } else { "zstd" };
        assert_eq!(used, Some(expected));
        assert!(!answer.into_inner().message().await.unwrap().unwrap().points.is_empty());
    }
}
