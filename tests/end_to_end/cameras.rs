//! Two clients whose cameras extend one map at the same time.

use proto::v1;
use tests::{Client, FrameStream, SmallWorld, TestServer, create_session, open_message, with_token};
use tonic::Code;

/// Views of the room that each of the cameras shows.
const N_VIEWS: usize = 60;
/// Nanoseconds between frames, as in the world's own frames.
const INTERVAL_NS: i64 = 100_000_000;

async fn extend(client: &mut Client, id: &str, map: &str) -> Result<v1::Session, tonic::Status> {
    let request = v1::CreateSessionRequest {
        session_id: id.into(),
        map: map.into(),
        ..v1::CreateSessionRequest::default()
    };
    Ok(client.create_session(request).await?.into_inner())
}

async fn session(client: &mut Client, id: &str) -> v1::Session {
    client.get_session(v1::GetSessionRequest { session_id: id.into() }).await.unwrap().into_inner()
}

async fn delete(client: &mut Client, id: &str) -> Result<(), tonic::Status> {
    client.delete_session(v1::DeleteSessionRequest { session_id: id.into() }).await.map(|_| ())
}

/// Streams views of the room in this order, numbered from `first` on; how many frames got a pose at once.
async fn walk(
    client: &mut Client,
    id: &str,
    world: &SmallWorld,
    first: u64,
    views: impl IntoIterator<Item = usize>,
) -> usize {
    let mut stream = FrameStream::open(client, open_message(id)).await.unwrap();
    assert_eq!(stream.opened.next_sequence, first);
    let mut n_placed = 0;
    for (sequence, view) in (first..).zip(views) {
        let timestamp_ns = sequence as i64 * INTERVAL_NS;
        let result = stream.track(v1::Frame { sequence, timestamp_ns, ..world.frame(view) }).await.unwrap();
        n_placed += usize::from(result.pose_world_from_camera.is_some());
    }
    stream.finish().await.unwrap();
    n_placed
}

/// Positions of a session's frames by their numbers.
async fn positions(server: &TestServer, id: &str) -> Vec<(usize, [f64; 3])> {
    let csv = server.get(&format!("/v1/sessions/{id}/trajectory?format=csv")).await;
    let rows = csv.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let position =
        |row: Vec<&str>| (row[0].parse().unwrap(), [5, 6, 7].map(|column| row[column].parse().unwrap()));
    rows.map(position).collect()
}

/// True distances between positions in map units, the median and the widest of their middle nine tenths: were
/// two trajectories in different frames of reference they would scatter.
fn scales(a: &[([f64; 3], [f64; 3])], b: &[([f64; 3], [f64; 3])]) -> [f64; 3] {
    let distance = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
    let mut scales: Vec<f64> = Vec::new();
    for (found, truth) in a {
        let far = b.iter().filter(|(_, other)| distance(truth, other) > 0.5);
        scales.extend(far.map(|(other, true_to)| distance(found, other) / distance(truth, true_to)));
    }
    scales.sort_by(f64::total_cmp);
    [1, 10, 19].map(|part| scales[scales.len() * part / 20])
}

#[tokio::test(flavor = "multi_thread")]
async fn two_clients_extend_one_map_each_with_its_own_trajectory() {
    let server = TestServer::start().await;
    let (mut first, mut second) = (server.client().await, server.client().await);
    let world = SmallWorld::new(1);
    create_session(&mut first, "room", world.camera()).await.unwrap();
    let added = extend(&mut second, "walker", "room").await.unwrap();
    assert_eq!((added.map.as_deref(), added.camera), (Some("room"), Some(world.camera())));
    assert_eq!(session(&mut first, "room").await.map, None);

    // One goes on when the other has ended.
    let (forth, back) = (0..N_VIEWS, (0..N_VIEWS + 20).map(|i| (N_VIEWS + 19 - i) / 2));
    let other = SmallWorld::new(1);
    let walking = tokio::spawn(async move {
        let n_placed = walk(&mut second, "walker", &other, 0, back).await;
        (second, n_placed)
    });
    let n_first = walk(&mut first, "room", &world, 0, forth).await;
    let (mut second, n_second) = walking.await.unwrap();
    assert!(n_first >= N_VIEWS * 8 / 10 && n_second >= N_VIEWS * 8 / 10, "{n_first} and {n_second} poses");

    let sessions = [session(&mut first, "room").await, session(&mut first, "walker").await];
    let counts = sessions.each_ref().map(|s| (s.n_keyframes, s.n_points, s.n_lines, s.n_submaps));
    assert_eq!(counts[0], counts[1], "one map");
    assert_eq!(counts[0].3, 1, "one frame of reference");
    assert_eq!(sessions.each_ref().map(|s| s.n_frames), [N_VIEWS as u64, N_VIEWS as u64 + 20]);
    assert_eq!(sessions.each_ref().map(|s| s.durable_sequence.unwrap()), [59, 79]);
    let keyframes = server.get_json("/v1/sessions/walker/keyframes?page_size=1000").await;
    assert_eq!(keyframes["keyframes"].as_array().unwrap().len() as u64, sessions[0].n_keyframes);
    let scene = server.get("/v1/sessions/walker/scene").await;
    assert!(scene.len() > 10_000, "the viewer of either shows the map");

    // Both trajectories fit the truth at one scale.
    let truth = |view: usize| world.camera_position(view);
    let of_first: Vec<_> =
        positions(&server, "room").await.into_iter().map(|(i, found)| (found, truth(i))).collect();
    let of_second: Vec<_> = positions(&server, "walker").await;
    let of_second: Vec<_> =
        of_second.into_iter().map(|(i, found)| (found, truth((N_VIEWS + 19 - i) / 2))).collect();
    let [low, within, high] = scales(&of_first, &of_first);
    let [low_across, across, high_across] = scales(&of_first, &of_second);
    println!(
        "scale {low:.4} {within:.4} {high:.4} within, {low_across:.4} {across:.4} {high_across:.4} across"
    );
    assert!((within / across - 1.0).abs() < 0.02, "{within} within one, {across} across");
    assert!(low_across > 0.9 * across && high_across < 1.1 * across);

    // The units are the map's.
    let scale = v1::SetScaleRequest {
        session_id: "walker".into(),
        metres_per_unit: Some(2.0),
        ..v1::SetScaleRequest::default()
    };
    second.set_scale(scale).await.unwrap();
    assert_eq!(session(&mut first, "room").await.metres_per_unit, Some(2.0));

    // What concerns the map is asked of the session whose it is, and that one stays while others extend it.
    let refused = delete(&mut first, "room").await.unwrap_err();
    assert_eq!(refused.code(), Code::FailedPrecondition);
    assert!(refused.message().contains("walker") && refused.message().contains("room"), "{refused}");
    let optimize = v1::OptimizeMapRequest { session_id: "walker".into() };
    assert_eq!(second.optimize_map(optimize).await.unwrap_err().code(), Code::FailedPrecondition);
    let merge = v1::MergeSessionsRequest { into: "room".into(), from: "walker".into() };
    assert_eq!(second.merge_sessions(merge).await.unwrap_err().code(), Code::FailedPrecondition);

    // After a restart both go on where they were.
    let server = server.restart().await;
    let (mut first, mut second) = (server.client().await, server.client().await);
    let other = SmallWorld::new(1);
    let walking = tokio::spawn(async move {
        walk(&mut second, "walker", &other, N_VIEWS as u64 + 20, (10..22).map(|i| i / 2)).await
    });
    let n_first = walk(&mut first, "room", &world, N_VIEWS as u64, N_VIEWS..N_VIEWS + 10).await;
    let n_second = walking.await.unwrap();
    assert!(n_first >= 9 && n_second >= 10, "{n_first} of 10 and {n_second} of 12 are placed");
    assert_eq!(session(&mut first, "room").await.n_submaps, 1);

    // One is deleted: the map keeps what it has put there, and the other goes on.
    let before = session(&mut first, "room").await.n_keyframes;
    delete(&mut first, "walker").await.unwrap();
    assert_eq!(session(&mut first, "room").await.n_keyframes, before);
    let n_placed = walk(&mut first, "room", &world, N_VIEWS as u64 + 10, (50..60).rev()).await;
    assert!(n_placed >= 9, "{n_placed} of 10");
    delete(&mut first, "room").await.unwrap();
    let (_, folder) = server.shut_down().await;
    let store =
        store::Store::open(folder.path().join(server::DATABASE_FILE), Default::default()).await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_extended_by_whom_it_may_be_and_as_it_can_be() {
    let server = TestServer::start().await;
    let ann = server.token("ann", store::TokenRole::Writer).await;
    let bob = server.token("bob", store::TokenRole::Writer).await;
    let mut client = server.client().await;
    let request = |id: &str, map: &str, options: Option<v1::SessionOptions>, camera: Option<v1::Camera>| {
        v1::CreateSessionRequest {
            session_id: id.into(),
            map: map.into(),
            options,
            camera,
            ..v1::CreateSessionRequest::default()
        }
    };
    let camera = tests::camera(320, 240);
    let mut create = async |token: &str, request: v1::CreateSessionRequest| {
        client.create_session(with_token(token, request)).await.map(|made| made.into_inner())
    };
    create(&ann, request("room", "", None, Some(camera.clone()))).await.unwrap();
    let refused = create(&bob, request("spy", "room", None, None)).await.unwrap_err();
    assert_eq!(refused.code(), Code::NotFound, "another owner's is looked for in vain");
    create(&ann, request("second", "room", None, None)).await.unwrap();
    // Named by one that extends it, the map is the same.
    let third = create(&ann, request("third", "second", None, Some(tests::camera(480, 360)))).await.unwrap();
    assert_eq!(third.map.as_deref(), Some("room"));

    let options = v1::SessionOptions { loop_closing: Some(false), ..v1::SessionOptions::default() };
    let refused = create(&ann, request("x", "room", Some(options), None)).await.unwrap_err();
    assert!(refused.message().contains("options.loop_closing"), "{refused}");
    let of_size = v1::Camera { width: 320, height: 240, ..v1::Camera::default() };
    let refused = create(&ann, request("x", "room", None, Some(of_size))).await.unwrap_err();
    assert!(refused.message().contains("needs its calibration"), "{refused}");
    let fixed = v1::SessionOptions { deterministic: Some(true), ..v1::SessionOptions::default() };
    create(&ann, request("fixed", "", Some(fixed), Some(camera))).await.unwrap();
    let refused = create(&ann, request("x", "fixed", None, None)).await.unwrap_err();
    assert!(refused.message().contains("deterministic"), "{refused}");
    let refused = create(&ann, request("x", "nowhere", None, None)).await.unwrap_err();
    assert_eq!(refused.code(), Code::NotFound);
}
