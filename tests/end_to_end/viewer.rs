//! What the viewer relies on while a session grows: changes since a revision add up to the whole, and the
//! last frames can be seen.

use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tests::{FrameStream, SmallWorld, TestServer, create_session, open_message, raw_gray};
use tokio_stream::StreamExt;

/// Frames of the room that are streamed: six seconds.
const N_FRAMES: usize = 60;
/// Longer than any event may take on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// A viewer's rows: by kind and id, the row as JSON.
#[derive(Default)]
struct Viewer {
    rows: BTreeMap<(String, u64), Value>,
    revision: String,
    n_deltas: usize,
}

impl Viewer {
    async fn read(&mut self, server: &TestServer) {
        let text = server.get(&format!("/v1/sessions/room/scene?since={}", self.revision)).await;
        let mut ended = false;
        for line in text.lines() {
            let part: Value = serde_json::from_str(line).unwrap();
            let (kind, columns) = part.as_object().unwrap().iter().next().unwrap();
            match kind.as_str() {
                "scene" if columns["full"] == true => self.rows.clear(),
                "scene" => self.n_deltas += 1,
                "removed" => self.remove(columns),
                "end" => {
                    self.revision = columns["revision"].as_str().unwrap().to_owned();
                    ended = true;
                }
                _ => self.enter(kind, columns),
            }
        }
        assert!(ended, "the scene has no end");
    }

    fn remove(&mut self, removed: &Value) {
        for (kind, ids) in removed.as_object().unwrap() {
            for id in ids.as_array().unwrap() {
                self.rows.remove(&(kind.clone(), id.as_u64().unwrap()));
            }
        }
    }

    fn enter(&mut self, kind: &str, columns: &Value) {
        let key = if kind == "frames" { "sequences" } else { "ids" };
        for (i, id) in columns[key].as_array().unwrap().iter().enumerate() {
            let named = columns.as_object().unwrap().iter().filter(|(name, _)| *name != "reasons");
            let mut row: BTreeMap<&str, &Value> =
                named.map(|(name, column)| (name.as_str(), &column[i])).collect();
            if let Some(reasons) = columns.get("reasons") {
                row.insert("reason", &reasons[id.to_string()]);
            }
            self.rows.insert((kind.to_owned(), id.as_u64().unwrap()), json!(row));
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn changes_add_up_to_the_whole_scene() {
    let world = SmallWorld::new(1);
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let mut viewer = Viewer::default();
    viewer.read(&server).await;
    assert!(viewer.rows.is_empty());
    let mut stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    for i in 0..N_FRAMES {
        stream.send(Request::Frame(world.frame(i))).await;
        stream.next().await.unwrap();
        if i % 7 == 0 {
            viewer.read(&server).await;
        }
    }
    // The lens is covered: these stay without a pose, and why is told.
    let blank = raw_gray(480, 360, &[90; 480 * 360]);
    for i in N_FRAMES..N_FRAMES + 3 {
        stream.send(Request::Frame(v1::Frame { image: Some(blank.clone()), ..world.frame(i) })).await;
        stream.next().await.unwrap();
    }
    stream.finish().await.unwrap();
    viewer.read(&server).await;
    let mut whole = Viewer::default();
    whole.read(&server).await;
    assert!(viewer.n_deltas > N_FRAMES / 7 && whole.n_deltas == 0);
    let kinds: BTreeSet<&str> = whole.rows.keys().map(|(kind, _)| kind.as_str()).collect();
    assert!(kinds.is_superset(&["frames", "keyframes", "points"].into()), "{kinds:?}");
    assert_eq!(viewer.rows.keys().collect::<Vec<_>>(), whole.rows.keys().collect::<Vec<_>>());
    assert_eq!(viewer.rows, whole.rows);
    for row in whole.rows.iter().filter(|((kind, _), _)| kind == "frames").map(|(_, row)| row) {
        let is_good = row["states"] == "tracked";
        assert_eq!(row["reason"].as_str().unwrap_or_default().is_empty(), is_good, "{row}");
    }
    assert!(whole.rows.values().filter(|row| row["reason"].is_string()).count() >= 3);

    let server = server.restart().await;
    let mut later = Viewer::default();
    later.read(&server).await;
    assert_eq!(later.rows, whole.rows, "nothing of it is forgotten by a restart");
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_watches_sees_the_last_frames_and_learns_of_commits() {
    let world = SmallWorld::new(1);
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let url = format!("http://{}/v1/sessions/room", server.running().http_addr);
    let mut events = reqwest::get(format!("{url}/events")).await.unwrap().bytes_stream();
    let mut told = String::new();
    let mut stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    for i in 0..N_FRAMES {
        let frame = world.frame(i);
        let sequence = frame.sequence;
        stream.send(Request::Frame(frame)).await;
        stream.next().await.unwrap();
        if i == N_FRAMES / 2 {
            let image = reqwest::get(format!("{url}/frames/{sequence}/image")).await.unwrap();
            assert_eq!(image.status(), 200);
            assert!(image::load_from_memory(&image.bytes().await.unwrap()).is_ok());
            let observed = server.get_json(&format!("/v1/sessions/room/frames/{sequence}/observed")).await;
            let n_keypoints = observed["keypoints"].as_array().unwrap().len();
            assert!(n_keypoints > 100, "{n_keypoints} keypoints");
            assert_eq!(observed["point_ids"].as_array().unwrap().len(), n_keypoints);
        }
    }
    stream.finish().await.unwrap();
    while !(told.contains("event: scene") && told.contains("\"n_inlier_points\"")) {
        let next = tokio::time::timeout(PATIENCE, events.next()).await.expect("an event in time");
        told.push_str(&String::from_utf8_lossy(&next.unwrap().unwrap()));
    }
    let old = reqwest::get(format!("{url}/frames/0/image")).await.unwrap();
    assert_eq!(old.status(), 404, "frames are not kept for ever");
}
