//! The map as a viewer draws it, and pictures.

use crate::api::Api;
use axum::body::Body;
use axum::http::{Method, Request, StatusCode};
use http_body_util::BodyExt;
use serde_json::{Value, json};
use store::KeyframeImage;
use testkit::world::{SMALL, kf, structured};

/// An image whose gray tells the column, in the size of the map's camera.
fn image(keyframe: u64) -> KeyframeImage {
    let pixels: Vec<u8> = (0..752 * 480).map(|i| (i % 752 / 3) as u8).collect();
    let bytes = tests::png(752, 480, &pixels).data.to_vec();
    KeyframeImage { keyframe: kf(keyframe), media_type: "image/png".into(), bytes }
}

async fn scene(api: &Api, query: &str) -> Vec<Value> {
    let text = api.text(&format!("/scene{query}")).await;
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// A column of every part of a kind, one after the other.
fn column(scene: &[Value], kind: &str, name: &str) -> Vec<Value> {
    let parts = scene.iter().filter_map(|part| part.get(kind));
    parts.flat_map(|part| part[name].as_array().unwrap().clone()).collect()
}

/// A number as a scene tells it: with the digits of single precision.
fn single(number: f64) -> Value {
    serde_json::from_str(&serde_json::to_string(&(number as f32)).unwrap()).unwrap()
}

#[tokio::test]
async fn a_scene_has_the_whole_map() {
    let api = Api::new().await;
    let scene = scene(&api, "").await;
    let head = &scene[0]["scene"];
    assert_eq!(
        (&head["session_id"], &head["full"], &head["metres_per_unit"]),
        (&json!("s"), &json!(true), &Value::Null)
    );
    assert_eq!(scene.last().unwrap()["end"]["revision"], head["revision"]);

    let world = &api.world;
    let expected = |ids: Vec<u64>| ids.into_iter().map(|id| json!(id)).collect::<Vec<_>>();
    let points = expected(world.points.iter().map(|point| point.id.get()).collect());
    assert_eq!(column(&scene, "points", "ids"), points);
    let third = &world.points[2];
    let position: Vec<Value> = third.position.iter().map(|length| single(*length)).collect();
    assert_eq!(column(&scene, "points", "positions")[2], json!(position));
    assert_eq!(column(&scene, "points", "created_by")[2], json!(third.created_by.get()));
    let ends: Vec<Value> =
        world.lines[3].endpoints.iter().flat_map(|end| end.iter().map(|length| single(*length))).collect();
    assert_eq!(column(&scene, "lines", "ends")[3], json!(ends));
    let primitive = &world.primitives[1];
    let tied: Vec<u64> = primitive.observations.iter().map(|seen| seen.keyframe.get()).collect();
    assert_eq!(column(&scene, "primitives", "keyframe_ids")[1], json!(tied));
    let keyframe = world.keyframes[4].camera_from_world.inverse();
    assert_eq!(column(&scene, "keyframes", "poses")[4][2], single(keyframe.translation.z));
    assert_eq!(column(&scene, "frames", "sequences").len(), 20);
    assert_eq!(column(&scene, "frames", "states")[0], "tracked");
}

#[tokio::test]
async fn only_changes_are_told_to_whoever_knows_the_rest() {
    let api = Api::new().await;
    let whole = scene(&api, "").await;
    let revision = whole[0]["scene"]["revision"].as_str().unwrap();
    let changes = scene(&api, &format!("?since={revision}")).await;
    assert_eq!(changes[0]["scene"]["full"], false);
    let rows = ["keyframes", "points", "lines", "primitives", "frames"];
    assert!(changes.iter().all(|part| rows.iter().all(|kind| part.get(kind).is_none())), "{changes:?}");
    for unknown in ["1-1", "nonsense"] {
        let again = scene(&api, &format!("?since={unknown}")).await;
        assert_eq!((&again[0]["scene"]["full"], again.len()), (&json!(true), whole.len()), "{unknown}");
    }
}

#[tokio::test]
async fn points_have_the_gray_of_the_image_that_shows_them() {
    let api = Api::with(structured(7, SMALL), &(1..=6).map(image).collect::<Vec<_>>()).await;
    let grays = column(&scene(&api, "").await, "points", "grays");
    for (point, gray) in api.world.points.iter().zip(&grays) {
        let idx = point.observation_in(point.created_by).unwrap_or(point.observations[0].feature_idx);
        let seen_by = point
            .observation_in(point.created_by)
            .map_or(point.observations[0].keyframe, |_| point.created_by);
        let keyframe = api.world.keyframes.iter().find(|keyframe| keyframe.id == seen_by).unwrap();
        let x = keyframe.features.keypoints[idx as usize].x.round() as u64;
        assert_eq!(gray.as_u64(), Some(x / 3), "{point:?}");
    }
    let without = column(&scene(&Api::new().await, "").await, "points", "grays");
    assert!(without.iter().all(Value::is_null) && !without.is_empty(), "no image was kept");
}

#[tokio::test]
async fn a_keyframe_shows_its_features() {
    let api = Api::new().await;
    let keyframe = &api.world.keyframes[1];
    let observed = api.json("/keyframes/2/observed").await;
    assert_eq!((&observed["width"], &observed["height"]), (&json!(752), &json!(480)));
    let points: Vec<Option<u64>> = keyframe.points.iter().map(|id| id.map(|id| id.get())).collect();
    assert_eq!(observed["point_ids"], json!(points));
    assert_eq!(observed["segments"].as_array().unwrap().len(), keyframe.features.lines.len());
    let families = observed["vanishing_points"].as_array().unwrap();
    assert_eq!(families.len(), keyframe.vanishing.len());
    let primitive = keyframe.vanishing[0].primitive.map(|id| id.get());
    assert_eq!(families[0]["primitive_id"], json!(primitive));
    let first = keyframe.vanishing[0].segments[0] as usize;
    assert_eq!(
        (&observed["vanishing_idx"][first], &observed["primitive_ids"][first]),
        (&json!(0), &json!(primitive))
    );
}

#[tokio::test]
async fn a_session_has_a_small_picture_that_is_sent_once() {
    let api = Api::with(structured(7, SMALL), &[image(2), image(5)]).await;
    let get = async |tag: &str| {
        let request = Request::get("/v1/sessions/s/picture").header("if-none-match", tag);
        api.call(request.body(Body::empty()).unwrap()).await
    };
    let answer = get("").await;
    assert_eq!(
        (answer.status(), answer.headers()["content-type"].to_str().unwrap()),
        (StatusCode::OK, "image/png")
    );
    let tag = answer.headers()["etag"].to_str().unwrap().to_owned();
    let file = answer.into_body().collect().await.unwrap().to_bytes();
    assert_eq!(image::load_from_memory(&file).unwrap().width(), 320);
    let again = get(&tag).await;
    assert_eq!(again.status(), StatusCode::NOT_MODIFIED);
    assert!(again.into_body().collect().await.unwrap().to_bytes().is_empty());
    let none =
        Api::new().await.send(Method::GET, "/v1/sessions/s/picture", "text/plain", Body::empty()).await;
    assert_eq!(none.status(), StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn frames_that_are_not_kept_are_not_found() {
    let api = Api::new().await;
    for path in ["frames/3/image", "frames/3/observed", "keyframes/99/observed"] {
        let answer =
            api.send(Method::GET, &format!("/v1/sessions/s/{path}"), "text/plain", Body::empty()).await;
        assert_eq!(answer.status(), StatusCode::NOT_FOUND, "{path}");
    }
    let wrong = api.send(Method::GET, "/v1/sessions/s/frames/x/image", "text/plain", Body::empty()).await;
    assert_eq!(wrong.status(), StatusCode::BAD_REQUEST);
}
