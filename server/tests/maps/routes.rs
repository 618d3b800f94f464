//! One answer of every route, over a small map made by hand.

use crate::api::Api;
use crate::rounded::rounded;
use axum::body::Body;
use axum::http::{Method, Response};
use http_body_util::BodyExt;
use serde_json::{Value, json};
use store::KeyframeImage;
use testkit::world::{Size, kf, structured};
use tokio_stream::StreamExt;

const TINY: Size = Size { n_keyframes: 4, n_keypoints: 12, n_points: 5 };

async fn api() -> Api {
    let bytes = b"as it was sent".to_vec();
    let image = KeyframeImage { keyframe: kf(2), media_type: "image/png".into(), bytes };
    Api::with(structured(7, TINY), &[image]).await
}

/// Status, kind and text of an answer; JSON line by line.
async fn told(response: Response<Body>) -> String {
    let (status, headers) = (response.status(), response.headers().clone());
    let mut head = format!("{status}\n");
    for name in ["content-type", "content-disposition", "location", "x-content-type-options"] {
        if let Some(value) = headers.get(name) {
            head.push_str(&format!("{name}: {}\n", value.to_str().unwrap()));
        }
    }
    let body = response.into_body().collect().await.unwrap().to_bytes();
    let text = String::from_utf8(body.to_vec()).unwrap();
    let text = match serde_json::from_str::<Value>(&text) {
        Ok(value) => serde_json::to_string_pretty(&value).unwrap(),
        Err(_) => text,
    };
    rounded(&format!("{head}\n{text}"))
}

async fn get(api: &Api, path: &str) -> String {
    told(api.send(Method::GET, path, "text/plain", Body::empty()).await).await
}

#[tokio::test]
async fn every_question_has_its_answer() {
    let api = api().await;
    for (name, path) in [
        ("sessions", "/v1/sessions"),
        ("session", "/v1/sessions/s"),
        ("keyframes", "/v1/sessions/s/keyframes?page_size=2&page_token=1"),
        ("keyframe", "/v1/sessions/s/keyframes/2"),
        ("keyframe_image", "/v1/sessions/s/keyframes/2/image"),
        ("keyframe_image_not_kept", "/v1/sessions/s/keyframes/1/image"),
        ("points", "/v1/sessions/s/points?page_size=3"),
        ("lines", "/v1/sessions/s/lines?primitive_id=2&page_size=2"),
        ("primitives", "/v1/sessions/s/primitives?page_size=2"),
        ("primitive", "/v1/sessions/s/primitives/2"),
        ("primitive_not_found", "/v1/sessions/s/primitives/77"),
        ("graph_covisibility", "/v1/sessions/s/graph?keyframe_id=2"),
        ("graph_primitives", "/v1/sessions/s/graph?kind=primitives&keyframe_id=2"),
        ("graph_essential", "/v1/sessions/s/graph?kind=essential"),
        ("trajectory_tum", "/v1/sessions/s/trajectory?to_timestamp_ns=200000000"),
        ("trajectory_euroc", "/v1/sessions/s/trajectory?format=euroc&to_timestamp_ns=200000000"),
        ("trajectory_kitti", "/v1/sessions/s/trajectory?format=kitti&to_timestamp_ns=200000000"),
        ("trajectory_csv", "/v1/sessions/s/trajectory?format=csv&to_timestamp_ns=200000000"),
        ("trajectory_json", "/v1/sessions/s/trajectory?format=json&to_timestamp_ns=200000000"),
        ("map_ply", "/v1/sessions/s/map"),
        ("map_json", "/v1/sessions/s/map?format=json"),
        ("map_colmap_cameras", "/v1/sessions/s/map?format=colmap&part=cameras"),
        ("map_colmap_images", "/v1/sessions/s/map?format=colmap&part=images"),
        ("map_colmap_points", "/v1/sessions/s/map?format=colmap&part=points3D"),
        ("health", "/healthz"),
        ("readiness", "/readyz"),
        ("no_such_path", "/v1/maps"),
        ("wrong_condition", "/v1/sessions/s/points?near=1,2,3"),
    ] {
        insta::assert_snapshot!(format!("route_{name}"), get(&api, path).await);
    }
}

#[tokio::test]
async fn every_request_has_its_answer() {
    let api = api().await;
    let send = async |method, path, body: Value| {
        told(api.send(method, path, "application/json", body.to_string()).await).await
    };
    let camera = json!({
        "model": "pinhole", "width": 640, "height": 480, "fx": 525.0, "fy": 525.0, "cx": 319.5, "cy": 239.5,
    });
    let made = send(Method::POST, "/v1/sessions", json!({ "id": "new", "camera": camera })).await;
    let made: String = made
        .lines()
        .filter(|line| !line.contains("created_at_ns"))
        .fold(String::new(), |all, line| all + line + "\n");
    insta::assert_snapshot!("route_create", made);
    let change = json!({ "options": { "lines": false, "max_keyframes": 300 } });
    insta::assert_snapshot!("route_update", send(Method::PATCH, "/v1/sessions/s", change).await);
    let scale = json!({ "metres_per_unit": 2.5 });
    insta::assert_snapshot!("route_scale", send(Method::POST, "/v1/sessions/s/scale", scale).await);
    insta::assert_snapshot!("route_metric_points", get(&api, "/v1/sessions/s/points?page_size=1").await);
    insta::assert_snapshot!("route_delete", send(Method::DELETE, "/v1/sessions/s", json!({})).await);
}

#[tokio::test]
async fn an_image_that_shows_nothing_is_lost() {
    let api = api().await;
    let image = tests::png(752, 480, &[90; 752 * 480]).data;
    let located = told(api.send(Method::POST, "/v1/sessions/s/localize", "image/png", image).await).await;
    let times = ["\"load_ms\"", "\"locate_ms\""];
    let kept = located.lines().filter(|line| !times.iter().any(|name| line.contains(name)));
    let kept: Vec<&str> = kept.collect();
    assert_eq!(kept.len() + times.len(), located.lines().count(), "{located}");
    insta::assert_snapshot!("route_localize", kept.join("\n"));
}

#[tokio::test]
async fn events_begin_with_the_session() {
    let api = api().await;
    let response = api.send(Method::GET, "/v1/sessions/s/events", "text/plain", Body::empty()).await;
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    let first = response.into_body().into_data_stream().next().await.unwrap().unwrap();
    insta::assert_snapshot!("route_events", rounded(std::str::from_utf8(&first).unwrap()));
}

#[tokio::test]
async fn metrics_are_told_one_a_line() {
    let api = api().await;
    let metrics = get(&api, "/metrics").await;
    let own: Vec<&str> = metrics.lines().filter(|line| line.contains("monoslam_sessions_loaded")).collect();
    insta::assert_snapshot!("route_metrics", own.join("\n"));
}
