//! The HTTP interface, request by request, without a socket.

use axum::Router;
use axum::body::Body;
use axum::http::{Method, Request, StatusCode};
use http_body_util::BodyExt;
use serde_json::{Value, json};
use server::{Config, Service, open_store, rest};
use std::sync::Arc;
use tempfile::TempDir;
use tower::ServiceExt;

struct Api {
    router: Router,
    _folder: TempDir,
}

struct Answer {
    status: StatusCode,
    content_type: String,
    body: Vec<u8>,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).expect("the body is JSON")
    }

    /// A problem in the form of RFC 9457 that says the same as the status line.
    fn problem(&self) -> Value {
        assert_eq!(self.content_type, "application/problem+json");
        let problem = self.json();
        assert_eq!(problem["status"], self.status.as_u16());
        problem
    }
}

impl Api {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let config = Config::local(folder.path());
        let store = open_store(&config).await.unwrap();
        let service = Arc::new(Service::new(Arc::new(config), store).await.unwrap());
        Self { router: rest::router(rest::App::new(service)), _folder: folder }
    }

    async fn send(&self, method: Method, path: &str, body: impl Into<Body>) -> Answer {
        let request = Request::builder().method(method).uri(path).header("content-type", "application/json");
        let response = self.router.clone().oneshot(request.body(body.into()).unwrap()).await.unwrap();
        let content_type =
            response.headers().get("content-type").map(|value| value.to_str().unwrap().to_owned());
        Answer {
            status: response.status(),
            content_type: content_type.unwrap_or_default(),
            body: response.into_body().collect().await.unwrap().to_bytes().to_vec(),
        }
    }

    async fn send_image(&self, file: Vec<u8>) -> Answer {
        let request = Request::builder().method(Method::POST).uri("/v1/sessions/kitchen/localize");
        let response = self.router.clone().oneshot(request.body(Body::from(file)).unwrap()).await.unwrap();
        let status = response.status();
        let body = response.into_body().collect().await.unwrap().to_bytes().to_vec();
        Answer { status, content_type: "application/json".into(), body }
    }

    async fn get(&self, path: &str) -> Answer {
        self.send(Method::GET, path, Body::empty()).await
    }

    async fn post(&self, path: &str, body: &Value) -> Answer {
        self.send(Method::POST, path, body.to_string()).await
    }
}

fn kitchen() -> Value {
    json!({
        "id": "kitchen",
        "camera": {
            "model": "radtan", "width": 640, "height": 480, "fx": 525.0, "fy": 524.5, "cx": 319.5, "cy": 239.5,
            "distortion": [0.1, -0.2, 0.001, 0.002]
        },
        "options": { "seed": 7, "n_features": 1200 }
    })
}

#[tokio::test]
async fn a_session_is_made_read_listed_and_deleted() {
    let api = Api::new().await;
    let made = api.post("/v1/sessions", &kitchen()).await;
    assert_eq!(made.status, StatusCode::CREATED);
    let mut session = made.json();
    assert!(session["created_at_ns"].as_i64().is_some_and(|time| time > 1_700_000_000_000_000_000));
    assert_eq!(session["created_at_ns_text"], json!(session["created_at_ns"].to_string()));
    session["created_at_ns"] = json!("[time]");
    session["created_at_ns_text"] = json!("[time]");
    insta::assert_json_snapshot!("session", session);
    assert_eq!(api.get("/v1/sessions/kitchen").await.json(), made.json());
    let page = api.get("/v1/sessions").await.json();
    assert_eq!(page, json!({ "sessions": [made.json()], "next_page_token": null }));

    let again = api.post("/v1/sessions", &kitchen()).await;
    assert_eq!(again.status, StatusCode::CONFLICT);
    insta::assert_json_snapshot!("session_exists", again.problem());

    let deleted = api.send(Method::DELETE, "/v1/sessions/kitchen", Body::empty()).await;
    assert_eq!((deleted.status, &deleted.json()["id"]), (StatusCode::OK, &json!("kitchen")));
    assert!(deleted.json()["note"].as_str().unwrap().contains("monoslam-server compact"));
    let gone = api.get("/v1/sessions/kitchen").await;
    assert_eq!(gone.status, StatusCode::NOT_FOUND);
    insta::assert_json_snapshot!("session_not_found", gone.problem());
}

#[tokio::test]
async fn wrong_fields_are_named() {
    let api = Api::new().await;
    let mut wrong_camera = kitchen();
    wrong_camera["camera"]["fx"] = json!(-3.0);
    let answer = api.post("/v1/sessions", &wrong_camera).await;
    assert_eq!(answer.status, StatusCode::BAD_REQUEST);
    insta::assert_json_snapshot!("wrong_camera", answer.problem());

    let mut unknown_field = kitchen();
    unknown_field["camera"]["focal"] = json!(1.0);
    let mut wrong_model = kitchen();
    wrong_model["camera"]["model"] = json!("fish");
    for (request, word) in
        [(unknown_field, "focal"), (wrong_model, "fish"), (json!({}), "camera"), (json!([]), "camera")]
    {
        let answer = api.post("/v1/sessions", &request).await;
        assert_eq!(answer.status, StatusCode::BAD_REQUEST, "{request}");
        assert!(answer.problem().to_string().contains(word), "{} does not name {word}", answer.problem());
    }
    let not_json = api.send(Method::POST, "/v1/sessions", "{").await;
    assert_eq!(not_json.problem()["violations"][0]["field"], "body");
    let too_large = api.send(Method::POST, "/v1/sessions", vec![b' '; 1 << 20]).await;
    assert_eq!(too_large.status, StatusCode::PAYLOAD_TOO_LARGE);
    assert_eq!(too_large.problem()["code"], "MESSAGE_TOO_LARGE");
}

/// A gray picture of the size of the kitchen's camera.
fn picture(format: image::ImageFormat) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    let pixels = image::GrayImage::from_fn(640, 480, |x, y| image::Luma([(x / 8 * 31 + y / 8 * 17) as u8]));
    image::DynamicImage::from(pixels).to_rgb8().write_to(&mut file, format).unwrap();
    file.into_inner()
}

#[tokio::test]
async fn an_image_is_what_its_bytes_are() {
    use image::ImageFormat::{Bmp, Jpeg, Png, Pnm, Tiff, WebP};
    let api = Api::new().await;
    api.post("/v1/sessions", &kitchen()).await;
    let send = async |content_type: Option<&str>, body: Vec<u8>| {
        let request = Request::builder().method(Method::POST).uri("/v1/sessions/kitchen/localize");
        let request = match content_type {
            Some(said) => request.header("content-type", said),
            None => request,
        };
        let response = api.router.clone().oneshot(request.body(Body::from(body)).unwrap()).await.unwrap();
        let status = response.status();
        (
            status,
            String::from_utf8(response.into_body().collect().await.unwrap().to_bytes().to_vec()).unwrap(),
        )
    };
    for format in [Png, Jpeg, Bmp, WebP, Tiff, Pnm] {
        assert_eq!(send(None, picture(format)).await.0, StatusCode::OK, "{format:?}");
    }
    for said in [
        "application/x-www-form-urlencoded",
        "application/octet-stream",
        "image/jpg",
        "IMAGE/JPEG",
        "image/jpeg; charset=binary",
        "image/png",
        "image/*",
    ] {
        assert_eq!(send(Some(said), picture(Jpeg)).await.0, StatusCode::OK, "{said}");
    }
    for said in ["text/plain", "application/json", "video/mp4"] {
        let (status, body) = send(Some(said), picture(Jpeg)).await;
        assert_eq!(status, StatusCode::UNSUPPORTED_MEDIA_TYPE, "{said}");
        assert!(body.contains("UNSUPPORTED_MEDIA_TYPE") && body.contains("image/jpeg"), "{body}");
    }
    let form = |head: &str| {
        let head = format!("--x\r\ncontent-disposition: form-data; {head}\r\n\r\n");
        [head.as_bytes(), &picture(Jpeg), b"\r\n--x--\r\n"].concat()
    };
    let multipart = Some("multipart/form-data; boundary=x");
    for head in ["name=\"image\"", "name=\"image\"; filename=\"a.jpg\"", "name=\"photo\"; filename=\"a.jpg\""]
    {
        assert_eq!(send(multipart, form(head)).await.0, StatusCode::OK, "{head}");
    }
    let (status, body) = send(multipart, form("name=\"note\"")).await;
    assert!(status == StatusCode::BAD_REQUEST && body.contains("send it as part"), "{body}");
    let (status, body) = send(None, b"\0\0\0\x18ftypheic\0\0\0\0".to_vec()).await;
    assert!(status == StatusCode::BAD_REQUEST && body.contains("HEIC"), "{body}");

    let form =
        Request::builder().method(Method::POST).uri("/v1/sessions").header("content-type", "text/plain");
    let response = api.router.clone().oneshot(form.body(Body::from("{}")).unwrap()).await.unwrap();
    assert_eq!(response.status(), StatusCode::UNSUPPORTED_MEDIA_TYPE);
}

#[tokio::test]
async fn a_black_picture_is_said_to_be_black() {
    let api = Api::new().await;
    api.post("/v1/sessions", &kitchen()).await;
    for (gray, said) in [(0, "the picture is black; "), (9, "its brightest value is 9 of 255; ")] {
        let mut file = std::io::Cursor::new(Vec::new());
        image::GrayImage::from_pixel(640, 480, image::Luma([gray]))
            .write_to(&mut file, image::ImageFormat::Png)
            .unwrap();
        let located = api.send_image(file.into_inner()).await.json();
        assert!(located["reason"].as_str().unwrap().contains(said), "{located}");
    }
    let located = api.send_image(picture(image::ImageFormat::Png)).await.json();
    assert!(!located["reason"].as_str().unwrap().contains("black"), "{located}");
}

#[tokio::test]
async fn a_distortion_that_folds_is_warned_of() {
    let api = Api::new().await;
    let mut folding = kitchen();
    folding["camera"]["fx"] = json!(400.0);
    folding["camera"]["fy"] = json!(400.0);
    folding["camera"]["distortion"] = json!([-0.35, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let made = api.post("/v1/sessions", &folding).await;
    assert_eq!(made.status, StatusCode::CREATED);
    let warning = made.json()["camera_warnings"][0].as_str().unwrap().to_owned();
    assert!(warning.contains("folds back") && warning.contains("% of the image"), "{warning}");
    assert_eq!(made.json()["camera"]["distortion"].as_array().unwrap().len(), 8);
}

#[tokio::test]
async fn wrong_parameters_are_named() {
    let api = Api::new().await;
    api.post("/v1/sessions", &kitchen()).await;
    let cases = [
        ("/v1/sessions?page_size=1001", "page_size"),
        ("/v1/sessions?page_size=many", "query"),
        ("/v1/sessions?page_token=a%2Fb", "page_token"),
        ("/v1/sessions?page=2", "query"),
        ("/v1/sessions/a%2Fb", "id"),
        ("/v1/sessions/..%2F..%2Fetc/trajectory", "id"),
        ("/v1/sessions/kitchen/trajectory?format=xml", "query"),
        ("/v1/sessions/kitchen/trajectory?kind=all", "query"),
        ("/v1/sessions/kitchen/keyframes/0", "kf"),
        ("/v1/sessions/kitchen/keyframes/99999999999999999999", "kf"),
        ("/v1/sessions/kitchen/points?bbox=1,2,3", "bbox"),
        ("/v1/sessions/kitchen/points?bbox=1,0,0,0,1,1", "bbox"),
        ("/v1/sessions/kitchen/points?near=0,0,0", "radius"),
        ("/v1/sessions/kitchen/points?near=0,0,NaN&radius=1", "near"),
        ("/v1/sessions/kitchen/points?near=0,0,0&radius=-1", "radius"),
        ("/v1/sessions/kitchen/points?radius=1", "near"),
        ("/v1/sessions/kitchen/lines?bbox=0,0,0,1,1", "bbox"),
        ("/v1/sessions/kitchen/lines?near=0,0,0", "radius"),
        ("/v1/sessions/kitchen/lines?primitive_id=0", "primitive_id"),
        ("/v1/sessions/kitchen/lines?page_token=x", "page_token"),
        ("/v1/sessions/kitchen/primitives/0", "p"),
        ("/v1/sessions/kitchen/primitives?page_token=-1", "page_token"),
        ("/v1/sessions/kitchen/graph?kind=family", "query"),
        ("/v1/sessions/kitchen/map?format=xyz", "query"),
        ("/v1/sessions/kitchen/map?format=colmap", "part"),
        ("/v1/sessions/kitchen/map?format=ply&part=images", "part"),
    ];
    for (path, field) in cases {
        let answer = api.get(path).await;
        assert_eq!(answer.status, StatusCode::BAD_REQUEST, "{path}");
        assert_eq!(answer.problem()["violations"][0]["field"], field, "{path}");
    }
}

#[tokio::test]
async fn an_empty_session_has_an_empty_map() {
    let api = Api::new().await;
    api.post("/v1/sessions", &kitchen()).await;
    for (format, content_type, body) in [
        ("tum", "text/plain; charset=utf-8", ""),
        ("kitti", "text/plain; charset=utf-8", ""),
        (
            "euroc",
            "text/csv; charset=utf-8",
            "#timestamp [ns],p_RS_R_x,p_RS_R_y,p_RS_R_z,q_RS_w,q_RS_x,q_RS_y,q_RS_z\n",
        ),
        (
            "csv",
            "text/csv; charset=utf-8",
            "sequence,timestamp_ns,state,submap_id,backfilled,tx,ty,tz,qx,qy,qz,qw\n",
        ),
    ] {
        let answer = api.get(&format!("/v1/sessions/kitchen/trajectory?format={format}")).await;
        assert_eq!((answer.status, answer.content_type.as_str()), (StatusCode::OK, content_type), "{format}");
        assert_eq!(String::from_utf8(answer.body).unwrap(), body, "{format}");
    }
    let trajectory = api.get("/v1/sessions/kitchen/trajectory?format=json&kind=keyframes").await.json();
    let expected = json!({ "session_id": "kitchen", "transform": "world_from_camera", "scale": "up_to_scale", "poses": [] });
    assert_eq!(trajectory, expected);
    let keyframes = api.get("/v1/sessions/kitchen/keyframes").await.json();
    assert_eq!(keyframes, json!({ "scale": "up_to_scale", "keyframes": [], "next_page_token": null }));
    let points = api.get("/v1/sessions/kitchen/points?near=0,0,0&radius=10").await.json();
    assert_eq!(points, json!({ "scale": "up_to_scale", "points": [], "next_page_token": null }));
    let missing = api.get("/v1/sessions/kitchen/keyframes/1").await;
    assert_eq!(missing.problem()["code"], "KEYFRAME_NOT_FOUND");
    let lines = api.get("/v1/sessions/kitchen/lines?bbox=-1,-1,-1,1,1,1").await.json();
    assert_eq!(lines, json!({ "scale": "up_to_scale", "lines": [], "next_page_token": null }));
    let primitives = api.get("/v1/sessions/kitchen/primitives").await.json();
    assert_eq!(primitives, json!({ "primitives": [], "next_page_token": null }));
    let missing = api.get("/v1/sessions/kitchen/primitives/1").await;
    assert_eq!(missing.problem()["code"], "PRIMITIVE_NOT_FOUND");
    for kind in ["covisibility", "essential", "primitives"] {
        let graph = api.get(&format!("/v1/sessions/kitchen/graph?kind={kind}")).await.json();
        let expected = json!({ "session_id": "kitchen", "kind": kind, "scale": "up_to_scale", "nodes": [], "edges": [] });
        assert_eq!(graph, expected);
    }
    let ply = api.get("/v1/sessions/kitchen/map").await;
    assert!(String::from_utf8(ply.body).unwrap().contains("element vertex 0\n"));
    for part in ["cameras", "images", "points3D"] {
        let answer = api.get(&format!("/v1/sessions/kitchen/map?format=colmap&part={part}")).await;
        assert_eq!(
            (answer.status, answer.content_type.as_str()),
            (StatusCode::OK, "text/plain; charset=utf-8")
        );
    }
    let whole = api.get("/v1/sessions/kitchen/map?format=json").await.json();
    assert_eq!(
        (&whole["points"], &whole["lines"], &whole["session_id"]),
        (&json!([]), &json!([]), &json!("kitchen"))
    );
}

#[tokio::test]
async fn paths_and_methods_that_are_not_there_are_problems_too() {
    let api = Api::new().await;
    assert_eq!(api.get("/v2/sessions").await.problem()["code"], "NOT_FOUND");
    let answer = api.send(Method::PUT, "/v1/sessions", Body::empty()).await;
    assert_eq!(answer.status, StatusCode::METHOD_NOT_ALLOWED);
    assert_eq!(answer.problem()["code"], "METHOD_NOT_ALLOWED");
}

#[tokio::test]
async fn the_document_describes_the_interface() {
    let api = Api::new().await;
    let served = api.get("/openapi.json").await.json();
    assert_eq!(served, serde_json::to_value(rest::openapi()).unwrap());
    let mut document = served;
    document["info"]["version"] = json!("[version]");
    insta::assert_json_snapshot!("openapi", document);
}

#[tokio::test]
async fn the_front_page_is_the_viewer_with_all_it_loads() {
    let api = Api::new().await;
    let page = api.get("/").await;
    assert!(page.content_type.starts_with("text/html"));
    let text = String::from_utf8(page.body).unwrap();
    let loaded: Vec<&str> = text
        .split('"')
        .filter(|word| word.starts_with('/') && word.rsplit('/').next().unwrap().contains('.'))
        .collect();
    assert!(loaded.len() >= 3, "the page loads a script, a style sheet and an icon: {loaded:?}");
    for path in loaded {
        let file = api.get(path).await;
        assert_eq!(file.status, StatusCode::OK, "{path}");
        assert_ne!(file.content_type, "application/octet-stream", "{path}");
    }
    for path in ["/assets/none.js", "/assets/..%2Findex.html", "/assets/%2Fetc%2Fpasswd"] {
        assert_eq!(api.get(path).await.problem()["code"], "NOT_FOUND", "{path}");
    }
    assert_eq!(api.get("/healthz").await.status, StatusCode::OK);
    assert_eq!(api.get("/readyz").await.status, StatusCode::OK);
    assert_eq!(api.get("/metrics").await.status, StatusCode::OK);
}
