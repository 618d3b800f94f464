//! Tokens: who is let in, on both ports, and for how long.

use proto::v1;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use store::{TokenQuotas, TokenRole};
use tests::{FrameStream, SmallWorld, TestServer, camera, create_session, frame, open_message, with_token};
use tokio_stream::StreamExt;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tonic::{Code, Status};
use tonic_types::StatusExt;

/// The named time within which a token that was made or revoked is noticed, with room for a busy machine.
const NOTICED_WITHIN: Duration = Duration::from_secs(5);

async fn http(
    server: &TestServer,
    method: Method,
    path: &str,
    headers: &[(&str, &str)],
) -> reqwest::Response {
    let url = format!("http://{}{path}", server.running().http_addr);
    let mut request = reqwest::Client::new().request(method, url);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    request.send().await.expect("the server answers")
}

async fn status(server: &TestServer, method: Method, path: &str, headers: &[(&str, &str)]) -> StatusCode {
    http(server, method, path, headers).await.status()
}

fn list() -> v1::ListSessionsRequest {
    v1::ListSessionsRequest::default()
}

/// A server with a session from before there were tokens, and who may do what since.
struct Lab {
    server: TestServer,
    admin: String,
    writer: String,
    reader: String,
}

async fn lab() -> Lab {
    let server = TestServer::start().await;
    create_session(&mut server.client().await, "before", camera(320, 240)).await.unwrap();
    let admin = server.token("boss", TokenRole::Admin).await;
    let writer = server.token("robot", TokenRole::Writer).await;
    let reader = server.token("robot-reader", TokenRole::Reader).await;
    Lab { server, admin, writer, reader }
}

impl Lab {
    async fn create(&self, token: &str, id: &str) -> Result<v1::Session, Status> {
        let request = v1::CreateSessionRequest {
            session_id: id.into(),
            camera: Some(camera(320, 240)),
            options: None,
            ..v1::CreateSessionRequest::default()
        };
        let answer = self.server.client().await.create_session(with_token(token, request)).await;
        answer.map(tonic::Response::into_inner)
    }

    async fn ids(&self, token: &str) -> Vec<String> {
        let answer = self.server.client().await.list_sessions(with_token(token, list())).await;
        answer.unwrap().into_inner().sessions.into_iter().map(|session| session.id).collect()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_decide_who_does_what_on_both_ports() {
    let lab = lab().await;
    let server = &lab.server;
    let refused = server.client().await.list_sessions(list()).await.unwrap_err();
    assert_eq!(refused.code(), Code::Unauthenticated);
    assert!(refused.message().contains("MONOSLAM_TOKEN"), "{}", refused.message());
    let answer = http(server, Method::GET, "/v1/sessions", &[]).await;
    assert_eq!(answer.status(), StatusCode::UNAUTHORIZED);
    assert!(answer.headers()["www-authenticate"].to_str().unwrap().starts_with("Bearer"));
    let unknown = server.client().await.list_sessions(with_token("monoslam_x", list())).await.unwrap_err();
    assert_eq!(unknown.code(), Code::Unauthenticated);

    assert_eq!(lab.create(&lab.writer, "kitchen").await.unwrap().id, "kitchen");
    assert_eq!(lab.create(&lab.reader, "hall").await.unwrap_err().code(), Code::PermissionDenied);
    assert_eq!(lab.ids(&lab.reader).await, ["kitchen"]);
    assert_eq!(lab.ids(&lab.admin).await, ["before", "robot~kitchen"]);

    let bearer = |token: &str| format!("Bearer {token}");
    let (admin, reader) = (bearer(&lab.admin), bearer(&lab.reader));
    let as_reader = [("authorization", reader.as_str())];
    let as_admin = [("authorization", admin.as_str())];
    assert_eq!(status(server, Method::GET, "/v1/sessions/kitchen", &as_reader).await, 200);
    assert_eq!(status(server, Method::DELETE, "/v1/sessions/kitchen", &as_reader).await, 403);
    assert_eq!(status(server, Method::GET, "/metrics", &as_reader).await, 403);
    assert_eq!(status(server, Method::GET, "/metrics", &as_admin).await, 200);
    let answer = http(server, Method::GET, "/v1/sessions/robot~kitchen", &as_admin).await;
    assert_eq!(answer.json::<Value>().await.unwrap()["id"], "robot~kitchen");
    for public in
        ["/", "/capture", "/api", "/api/page.js", "/api/page.css", "/healthz", "/readyz", "/openapi.json"]
    {
        assert_eq!(status(server, Method::GET, public, &[]).await, 200, "{public}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_is_revoked_ends_what_is_under_way() {
    let lab = lab().await;
    lab.create(&lab.writer, "kitchen").await.unwrap();
    let mut client = lab.server.client().await;
    let request = v1::WatchMapRequest { session_id: "kitchen".into() };
    let mut watched = client.watch_map(with_token(&lab.writer, request)).await.unwrap().into_inner();
    assert!(watched.next().await.unwrap().is_ok(), "the session comes first");
    let token = format!("Bearer {}", lab.writer);
    let events = "/v1/sessions/kitchen/events";
    let mut events = http(&lab.server, Method::GET, events, &[("authorization", &token)]).await;
    assert!(events.chunk().await.unwrap().is_some());
    let (requests, outgoing) = tokio::sync::mpsc::channel(1);
    let open = v1::stream_frames_request::Message::Open(open_message("kitchen"));
    requests.send(v1::StreamFramesRequest { message: Some(open) }).await.unwrap();
    let outgoing = tokio_stream::wrappers::ReceiverStream::new(outgoing);
    let mut frames = client.stream_frames(with_token(&lab.writer, outgoing)).await.unwrap().into_inner();
    assert!(frames.message().await.unwrap().is_some(), "the stream is open");

    // By another program.
    lab.server.running().store().revoke_token("robot", 1).await.unwrap();
    let since = Instant::now();
    let ended = async {
        assert_eq!(frames.message().await.unwrap_err().code(), Code::Unauthenticated);
        assert_eq!(watched.next().await.unwrap().unwrap_err().code(), Code::Unauthenticated);
        while let Ok(Some(_)) = events.chunk().await {}
    };
    tokio::time::timeout(NOTICED_WITHIN, ended).await.expect("what is under way ends");
    println!("noticed after {:?}", since.elapsed());
    assert_eq!(status(&lab.server, Method::GET, "/v1/sessions", &[("authorization", &token)]).await, 401);
    // The other token of the same owner is good, and goes on where that one ended.
    assert_eq!(lab.ids(&lab.reader).await, ["kitchen"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ticket_is_for_reading_and_for_streams_of_our_own_pages() {
    let lab = lab().await;
    lab.create(&lab.writer, "kitchen").await.unwrap();
    let server = &lab.server;
    let token = format!("Bearer {}", lab.writer);
    let issued = http(server, Method::POST, "/v1/tickets", &[("authorization", &token)]).await;
    let cookie = issued.headers()["set-cookie"].to_str().unwrap().to_owned();
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
    assert!(!cookie.contains("Secure"), "it would not be sent back over http");
    let admission: Value = issued.json().await.unwrap();
    assert_eq!((&admission["role"], &admission["owner"]), (&json!("writer"), &json!("robot")));
    let ticket = cookie.split(';').next().unwrap().to_owned();
    let with_ticket = [("cookie", ticket.as_str())];
    assert_eq!(status(server, Method::GET, "/v1/sessions/kitchen", &with_ticket).await, 200);
    assert_eq!(status(server, Method::DELETE, "/v1/sessions/kitchen", &with_ticket).await, 401);
    assert_eq!(status(server, Method::POST, "/v1/tickets", &with_ticket).await, 401);

    let addr = server.running().http_addr;
    let stream = |origin: String| {
        let mut request = format!("ws://{addr}/v1/sessions/kitchen/stream").into_client_request().unwrap();
        request.headers_mut().insert("cookie", ticket.parse().unwrap());
        request.headers_mut().insert("origin", origin.parse().unwrap());
        request
    };
    assert!(connect_async(stream("http://evil.example".into())).await.is_err());
    let (mut socket, _) = connect_async(stream(format!("http://{addr}"))).await.unwrap();
    assert!(socket.next().await.unwrap().unwrap().to_text().unwrap().contains("opened"));
    lab.server.running().store().revoke_token("robot", 1).await.unwrap();
    let ended = async { while let Some(Ok(_)) = socket.next().await {} };
    tokio::time::timeout(NOTICED_WITHIN, ended).await.expect("the socket is closed");
    assert_eq!(status(server, Method::GET, "/v1/sessions/kitchen", &with_ticket).await, 401);
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_others_reach_no_server_without_tokens() {
    let server = TestServer::start_with(|config| {
        config.access.cors_origins = vec!["https://maps.example".into()];
    })
    .await;
    create_session(&mut server.client().await, "kitchen", camera(320, 240)).await.unwrap();
    let path = "/v1/sessions/kitchen";
    let rebound = http(&server, Method::GET, path, &[("host", "evil.example")]).await;
    assert_eq!(rebound.status(), StatusCode::MISDIRECTED_REQUEST);
    let problem: Value = rebound.json().await.unwrap();
    assert!(problem["detail"].as_str().unwrap().contains("access.hosts"), "{problem}");
    let foreign = [("origin", "http://evil.example")];
    assert_eq!(status(&server, Method::DELETE, path, &foreign).await, 403);
    assert_eq!(status(&server, Method::POST, &format!("{path}/optimize"), &foreign).await, 403);
    let allowed = http(&server, Method::GET, path, &[("origin", "https://maps.example")]).await;
    assert_eq!(allowed.headers()["access-control-allow-origin"], "https://maps.example");
    let asked = [
        ("origin", "https://maps.example"),
        ("access-control-request-method", "DELETE"),
        ("access-control-request-headers", "authorization"),
    ];
    let preflight = http(&server, Method::OPTIONS, path, &asked).await;
    assert_eq!(preflight.headers()["access-control-allow-origin"], "https://maps.example");
    let unasked = http(&server, Method::GET, path, &foreign).await;
    assert!(!unasked.headers().contains_key("access-control-allow-origin"));
    assert_eq!(status(&server, Method::DELETE, path, &[("origin", "https://maps.example")]).await, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn quotas_are_refused_with_a_sentence() {
    let world = SmallWorld::new(1);
    let server = TestServer::start().await;
    let quotas = TokenQuotas {
        max_sessions: Some(2),
        max_streams: Some(1),
        max_frames_per_s: Some(0.5),
        max_stored_bytes: None,
    };
    let token = server.make_token("robot", TokenRole::Writer, quotas).await;
    server.running().reload().await;
    let lab = Lab { server, admin: String::new(), writer: token.clone(), reader: String::new() };
    lab.create(&token, "a").await.unwrap();
    lab.create(&token, "b").await.unwrap();
    let refused = lab.create(&token, "c").await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted);
    assert!(refused.message().contains("2 sessions"), "{}", refused.message());

    let stream = |id: &'static str| {
        let (token, mut open) = (token.clone(), open_message(id));
        open.policy = v1::StreamPolicy::Realtime.into();
        let client = lab.server.client();
        async move {
            let (requests, outgoing) = tokio::sync::mpsc::channel(4);
            let open = v1::stream_frames_request::Message::Open(open);
            requests.send(v1::StreamFramesRequest { message: Some(open) }).await.unwrap();
            let outgoing = tokio_stream::wrappers::ReceiverStream::new(outgoing);
            let mut client = client.await;
            let answers = client.stream_frames(with_token(&token, outgoing)).await.unwrap().into_inner();
            (requests, answers)
        }
    };
    let (frames, mut answers) = stream("a").await;
    assert!(answers.message().await.unwrap().is_some());
    let second = stream("b").await.1.message().await.unwrap_err();
    assert_eq!(second.code(), Code::ResourceExhausted);
    assert_eq!(second.get_error_details().error_info().unwrap().reason, "QUOTA_EXCEEDED");
    // Two seconds' worth at once, which is one frame; the next one is too many. The image's size is wrong:
    // both are rejected, for different reasons.
    let mut reasons = Vec::new();
    for i in 0..2 {
        let message = v1::stream_frames_request::Message::Frame(frame(i, world.frame(0).image.unwrap()));
        frames.send(v1::StreamFramesRequest { message: Some(message) }).await.unwrap();
        let answer = answers.message().await.unwrap().unwrap().message.unwrap();
        if let v1::stream_frames_response::Message::Rejected(rejected) = answer {
            reasons.push((rejected.sequence, rejected.code));
        }
    }
    assert!(reasons.contains(&(1, "RATE_LIMITED".to_owned())), "{reasons:?}");
    assert!(!reasons.contains(&(0, "RATE_LIMITED".to_owned())), "{reasons:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn who_asks_too_often_is_told_when_to_come_again() {
    let server = TestServer::start_with(|config| {
        config.access.requests_per_s = 1;
        config.access.request_burst = 3;
    })
    .await;
    let token = server.token("robot", TokenRole::Reader).await;
    let mut client = server.client().await;
    let mut refusal = None;
    for _ in 0..5 {
        refusal = client.list_sessions(with_token(&token, list())).await.err().or(refusal);
    }
    let refusal = refusal.expect("five requests at once are too many");
    assert_eq!(refusal.code(), Code::ResourceExhausted);
    assert!(refusal.get_error_details().retry_info().unwrap().retry_delay.unwrap() > Duration::ZERO);
    let header = format!("Bearer {token}");
    let answer = http(&server, Method::GET, "/v1/sessions", &[("authorization", &header)]).await;
    assert_eq!(answer.status(), StatusCode::TOO_MANY_REQUESTS);
    assert!(answer.headers()["retry-after"].to_str().unwrap().parse::<u64>().unwrap() >= 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_opens_a_server_to_a_network_by_accident() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = server::Config::local(folder.path());
    config.http_addr = "0.0.0.0:0".parse().unwrap();
    let refused = server::Server::start(config.clone()).await.err().expect("it does not start").to_string();
    assert!(refused.contains("token create") && refused.contains("--insecure"), "{refused}");
    config.access.insecure = true;
    server::Server::start(config).await.expect("it was asked for").shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_that_is_not_used_makes_way_for_another_session() {
    let world = SmallWorld::new(1);
    let server = TestServer::start_with(|config| {
        config.limits.max_loaded_sessions = 1;
        config.sessions.idle_stream_s = 0.5;
    })
    .await;
    let mut client = server.client().await;
    for id in ["a", "b"] {
        create_session(&mut client, id, world.camera()).await.unwrap();
    }
    let mut idle = FrameStream::open(&mut client, open_message("a")).await.unwrap();
    let refused = FrameStream::open(&mut client, open_message("b")).await.err().expect("it is in use");
    assert_eq!(refused.code(), Code::ResourceExhausted);
    tokio::time::sleep(Duration::from_millis(700)).await;
    let mut used = FrameStream::open(&mut client, open_message("b")).await.unwrap();
    used.track(world.frame(0)).await.unwrap();
    let ended = idle.next().await.unwrap_err();
    assert_eq!(ended.get_error_details().error_info().unwrap().reason, "IDLE_STREAM");
    assert!(ended.message().contains("0.5 s"), "{}", ended.message());
}
