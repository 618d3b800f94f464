//! Requests that cannot be used, and what the client is told.

use proto::v1;
use tests::{FrameStream, TestServer, camera, create_session, open_message, png};
use tonic::{Code, Status};
use tonic_types::StatusExt;

fn field_of(status: &Status) -> String {
    let details = status.get_error_details();
    let violation = details.bad_request().and_then(|request| request.field_violations.first());
    violation.map(|violation| violation.field.clone()).unwrap_or_default()
}

#[tokio::test]
async fn an_impossible_calibration_is_refused_by_the_name_of_its_field() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let good = camera(640, 480);
    let radtan = v1::CameraModel::Radtan.into();
    let cases = [
        ("camera.fx", v1::Camera { fx: -1.0, ..good.clone() }),
        ("camera.fx", v1::Camera { fx: f64::NAN, ..good.clone() }),
        ("camera.fy", v1::Camera { fy: f64::INFINITY, ..good.clone() }),
        // Found by fuzzing: undistorted, its pixels were infinitely far away.
        (
            "camera.fx",
            v1::Camera { fx: 1e-306, model: radtan, distortion: vec![-0.28, 0.07, 0.0, 0.0], ..good.clone() },
        ),
        ("camera.fy", v1::Camera { fy: 1e9, ..good.clone() }),
        ("camera.cx", v1::Camera { cx: 1e9, ..good.clone() }),
        ("camera.width", v1::Camera { width: 159, ..good.clone() }),
        ("camera.height", v1::Camera { height: 4000, ..good.clone() }),
        ("camera.model", v1::Camera { model: 0, ..good.clone() }),
        ("camera.model", v1::Camera { model: 77, ..good.clone() }),
        ("camera.distortion", v1::Camera { model: radtan, distortion: vec![0.1; 3], ..good.clone() }),
        (
            "camera.distortion",
            v1::Camera { model: radtan, distortion: vec![-9.0, 0.0, 0.0, 0.0], ..good.clone() },
        ),
    ];
    for (field, camera) in cases {
        let status = create_session(&mut client, "never", camera.clone()).await.unwrap_err();
        assert_eq!(
            (status.code(), field_of(&status).as_str()),
            (Code::InvalidArgument, field),
            "{camera:?}: {status}"
        );
    }
    let missing = v1::CreateSessionRequest {
        session_id: "never".into(),
        camera: None,
        options: None,
        ..v1::CreateSessionRequest::default()
    };
    assert_eq!(field_of(&client.create_session(missing).await.unwrap_err()), "camera");
    assert_eq!(server.get_json("/v1/sessions").await["sessions"], serde_json::json!([]));
}

#[tokio::test]
async fn a_session_id_cannot_be_a_path() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    for id in ["../escape", "a/b", "a b", "..", &"x".repeat(65)] {
        let status = create_session(&mut client, id, camera(640, 480)).await.unwrap_err();
        assert_eq!(
            (status.code(), field_of(&status).as_str()),
            (Code::InvalidArgument, "session_id"),
            "{id:?}"
        );
    }
    let made = create_session(&mut client, "", camera(640, 480)).await.unwrap();
    assert!(made.id.len() >= 16, "the server made the id {:?}", made.id);
}

#[tokio::test]
async fn ids_are_taken_once_and_sessions_come_in_pages() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    for id in ["c", "a", "b"] {
        create_session(&mut client, id, camera(640, 480)).await.unwrap();
    }
    let again = create_session(&mut client, "a", camera(640, 480)).await.unwrap_err();
    assert_eq!(again.code(), Code::AlreadyExists);

    let (mut ids, mut page_token) = (Vec::new(), String::new());
    loop {
        let request = v1::ListSessionsRequest { page_size: 2, page_token };
        let page = client.list_sessions(request).await.unwrap().into_inner();
        assert!(page.sessions.len() <= 2);
        ids.extend(page.sessions.into_iter().map(|session| session.id));
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    assert_eq!(ids, ["a", "b", "c"]);
    let too_large = v1::ListSessionsRequest { page_size: 1001, page_token: String::new() };
    assert_eq!(field_of(&client.list_sessions(too_large).await.unwrap_err()), "page_size");
}

#[tokio::test]
async fn an_unknown_session_is_not_found_everywhere() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let session_id = "nobody".to_owned();
    let got = client.get_session(v1::GetSessionRequest { session_id: session_id.clone() }).await.unwrap_err();
    let deleted =
        client.delete_session(v1::DeleteSessionRequest { session_id: session_id.clone() }).await.unwrap_err();
    let opened = FrameStream::open(&mut client, open_message(&session_id)).await.err().unwrap();
    for status in [got, deleted, opened] {
        assert_eq!(status.code(), Code::NotFound, "{status}");
        assert!(status.message().contains("nobody"), "{status}");
    }
    for page in ["", "/trajectory", "/keyframes", "/keyframes/1", "/keyframes/1/image", "/points"] {
        let url = format!("http://{}/v1/sessions/nobody{page}", server.running().http_addr);
        let response = reqwest::get(url).await.unwrap();
        assert_eq!(response.status(), 404, "{page}");
        assert_eq!(response.headers()["content-type"], "application/problem+json", "{page}");
    }
}

#[tokio::test]
async fn options_that_contradict_each_other_are_refused_by_name() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let options = v1::SessionOptions {
        lines: Some(false),
        global_primitives: Some(true),
        ..v1::SessionOptions::default()
    };
    let request = v1::CreateSessionRequest {
        session_id: "contradiction".into(),
        camera: Some(camera(640, 480)),
        options: Some(options),
        ..v1::CreateSessionRequest::default()
    };
    let status = client.create_session(request).await.unwrap_err();
    assert_eq!(field_of(&status), "options.global_primitives");
}

#[tokio::test]
async fn a_deleted_session_is_gone_and_its_id_is_free() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "brief", camera(640, 480)).await.unwrap();
    let stream = FrameStream::open(&mut client, open_message("brief")).await.unwrap();
    let request = v1::DeleteSessionRequest { session_id: "brief".into() };
    let refused = client.delete_session(request.clone()).await.unwrap_err();
    assert_eq!(refused.code(), Code::FailedPrecondition, "a session with a writer was deleted");
    stream.finish().await.unwrap();
    client.delete_session(request).await.unwrap();
    let gone = client.get_session(v1::GetSessionRequest { session_id: "brief".into() }).await.unwrap_err();
    assert_eq!(gone.code(), Code::NotFound);
    create_session(&mut client, "brief", camera(320, 240)).await.unwrap();
}

#[tokio::test]
async fn as_many_sessions_as_the_limit_says_and_no_more() {
    let server = TestServer::start_with(|config| config.limits.max_sessions = 2).await;
    let mut client = server.client().await;
    create_session(&mut client, "a", camera(640, 480)).await.unwrap();
    create_session(&mut client, "b", camera(640, 480)).await.unwrap();
    let status = create_session(&mut client, "c", camera(640, 480)).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    client.delete_session(v1::DeleteSessionRequest { session_id: "a".into() }).await.unwrap();
    create_session(&mut client, "c", camera(640, 480)).await.unwrap();
}

#[tokio::test]
async fn sessions_in_use_are_limited_and_idle_ones_make_room() {
    let server = TestServer::start_with(|config| config.limits.max_loaded_sessions = 1).await;
    let mut client = server.client().await;
    create_session(&mut client, "a", camera(640, 480)).await.unwrap();
    create_session(&mut client, "b", camera(640, 480)).await.unwrap();
    let first = FrameStream::open(&mut client, open_message("a")).await.unwrap();
    let status = FrameStream::open(&mut client, open_message("b")).await.err().unwrap();
    assert_eq!(status.code(), Code::ResourceExhausted);
    first.finish().await.unwrap();
    let second = FrameStream::open(&mut client, open_message("b")).await.unwrap();
    assert_eq!(server.get_json("/v1/sessions/a").await["loaded"], false);
    second.finish().await.unwrap();
}

#[tokio::test]
async fn health_and_reflection_answer() {
    let server = TestServer::start().await;
    let address = format!("http://{}", server.running().grpc_addr);
    let channel = tonic::transport::Channel::from_shared(address).unwrap().connect().await.unwrap();
    let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
    let request = tonic_health::pb::HealthCheckRequest { service: "monoslam.v1.SlamService".into() };
    let status = health.check(request).await.unwrap().into_inner().status();
    assert_eq!(status, tonic_health::pb::health_check_response::ServingStatus::Serving);
    assert_eq!(server.get("/healthz").await, "ok\n");
    assert_eq!(server.get("/readyz").await, "ready\n");
    assert!(server.get("/").await.contains("<title>monoslam</title>"));
}

#[tokio::test]
async fn a_message_over_the_limit_ends_the_stream_and_says_so() {
    let server = TestServer::start_with(|config| config.limits.max_message_bytes = 1 << 16).await;
    let mut client = server.client().await;
    create_session(&mut client, "a", camera(640, 480)).await.unwrap();
    let mut stream = FrameStream::open(&mut client, open_message("a")).await.unwrap();
    let mut image = png(640, 480, &vec![0; 640 * 480]);
    image.data = vec![0; 1 << 17].into();
    let status = stream.exchange(tests::frame(0, image)).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted, "{status}");
    assert!(status.message().contains("65536"), "{status}");
}

#[tokio::test]
async fn a_body_that_does_not_fit_beside_others_is_refused_and_may_come_again() {
    let server = TestServer::start_with(|config| {
        config.limits.max_message_bytes = 1 << 16;
        config.limits.max_bytes_in_flight = 1 << 16;
    })
    .await;
    create_session(&mut server.client().await, "s", camera(160, 120)).await.unwrap();
    let addr = server.running().http_addr;
    // Begun and not finished: it counts with its whole length.
    let mut unfinished = tokio::net::TcpStream::connect(addr).await.unwrap();
    let head =
        format!("POST /v1/sessions/s/localize HTTP/1.1\r\nhost: {addr}\r\ncontent-length: 60000\r\n\r\n");
    tokio::io::AsyncWriteExt::write_all(&mut unfinished, (head + "P5 ").as_bytes()).await.unwrap();
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    let send = || {
        let url = format!("http://{addr}/v1/sessions/s/localize");
        reqwest::Client::new().post(url).body(vec![0; 30_000]).send()
    };
    let refused = send().await.unwrap();
    assert_eq!(refused.status(), 429);
    assert!(refused.headers().contains_key("retry-after"));
    let problem: serde_json::Value = refused.json().await.unwrap();
    assert_eq!(problem["code"], "TOO_BUSY");
    assert!(problem["detail"].as_str().unwrap().contains("as many as it may"), "{problem}");
    drop(unfinished);
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    assert_eq!(send().await.unwrap().status(), 400, "it is read, and no image");
}

#[tokio::test]
async fn locating_an_image_ends_in_time_and_the_next_one_has_its_turn() {
    let server = TestServer::start_with(|config| config.sessions.localize_timeout_s = 1e-6).await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(640, 480)).await.unwrap();
    for _ in 0..3 {
        let image = Some(png(640, 480, &vec![7; 640 * 480]));
        let request = v1::LocalizeRequest { session_id: "s".into(), image, ..v1::LocalizeRequest::default() };
        let status = client.localize(request).await.unwrap_err();
        assert_eq!(status.code(), Code::DeadlineExceeded, "{status}");
        assert!(status.message().contains("localize_timeout_s"), "{status}");
    }
}
