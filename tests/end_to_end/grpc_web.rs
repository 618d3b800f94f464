//! gRPC-Web, as a page in a browser calls: over HTTP/1.1 on the port that pages come from.

use prost::Message;
use proto::v1;
use reqwest::header::{CONTENT_TYPE, HeaderValue};
use store::TokenRole;
use tests::{TestServer, camera, create_session};

const BINARY: &str = "application/grpc-web+proto";

/// A message with its head.
fn framed(message: &impl Message) -> Vec<u8> {
    let bytes = message.encode_to_vec();
    let mut framed = vec![0];
    framed.extend((bytes.len() as u32).to_be_bytes());
    framed.extend(bytes);
    framed
}

/// The messages of an answer, and its trailers, which are the last of them.
fn parts(mut bytes: &[u8]) -> (Vec<&[u8]>, String) {
    let mut messages = Vec::new();
    while let [flags, a, b, c, d, rest @ ..] = bytes {
        let (part, after) = rest.split_at(u32::from_be_bytes([*a, *b, *c, *d]) as usize);
        if flags & 0x80 != 0 {
            return (messages, String::from_utf8(part.to_vec()).unwrap());
        }
        messages.push(part);
        bytes = after;
    }
    panic!("an answer without trailers");
}

fn call(server: &TestServer, method: &str, message: &impl Message) -> reqwest::RequestBuilder {
    let url = format!("http://{}/monoslam.v1.SlamService/{method}", server.running().http_addr);
    reqwest::Client::new().post(url).header("content-type", BINARY).body(framed(message))
}

#[tokio::test]
async fn a_page_calls_by_grpc_web() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    for id in ["a", "b"] {
        create_session(&mut client, id, camera(320, 240)).await.unwrap();
    }
    let answer = call(&server, "ListSessions", &v1::ListSessionsRequest::default()).send().await.unwrap();
    assert_eq!(
        (answer.status().as_u16(), &answer.headers()["content-type"]),
        (200, &BINARY.parse().unwrap())
    );
    let bytes = answer.bytes().await.unwrap();
    let (messages, trailers) = parts(&bytes);
    let list = v1::ListSessionsResponse::decode(messages[0]).unwrap();
    assert_eq!(list.sessions.iter().map(|session| &*session.id).collect::<Vec<_>>(), ["a", "b"]);
    assert!(trailers.contains("grpc-status:0"), "{trailers}");

    // A stream of the server, which is empty here, and an error.
    let request = v1::QueryPointsRequest { session_id: "a".into(), ..Default::default() };
    let bytes = call(&server, "QueryPoints", &request).send().await.unwrap().bytes().await.unwrap();
    assert!(parts(&bytes).1.contains("grpc-status:0"));
    let request = v1::GetSessionRequest { session_id: "nothing".into() };
    let answer = call(&server, "GetSession", &request).send().await.unwrap();
    let status = answer.headers().get("grpc-status").cloned();
    let bytes = answer.bytes().await.unwrap();
    let is_not_found =
        status.is_some_and(|status| status == "5") || parts(&bytes).1.contains("grpc-status:5");
    assert!(is_not_found, "NOT_FOUND is 5");

    // As text, which is what libraries without binary answers use: an empty message.
    let text = call(&server, "ListSessions", &v1::ListSessionsRequest::default());
    // In place of the first one.
    let text = text.headers(
        [(CONTENT_TYPE, HeaderValue::from_static("application/grpc-web-text"))].into_iter().collect(),
    );
    let text = text.body("AAAAAAA=");
    let answer = text.send().await.unwrap();
    assert!(answer.status().is_success(), "{answer:?}");
    assert!(!answer.text().await.unwrap().is_empty());
}

#[tokio::test]
async fn the_door_stands_before_grpc_web_too() {
    let server = TestServer::start().await;
    let foreign = call(&server, "DeleteSession", &v1::DeleteSessionRequest::default());
    let foreign = foreign.header("origin", "https://evil.example").send().await.unwrap();
    assert_eq!(foreign.status(), 403, "a page of others changes nothing");
    let rebound = call(&server, "ListSessions", &v1::ListSessionsRequest::default());
    let rebound = rebound.header("host", "evil.example").send().await.unwrap();
    assert!(rebound.status().is_client_error(), "{rebound:?}");

    let reader = server.token("ann-reader", TokenRole::Reader).await;
    let ask = |method| call(&server, method, &v1::DeleteSessionRequest { session_id: "a".into() });
    assert_eq!(ask("GetSession").send().await.unwrap().status(), 401, "without a token");
    assert_eq!(ask("DeleteSession").bearer_auth(&reader).send().await.unwrap().status(), 403, "a reader");
    assert_eq!(ask("GetSession").bearer_auth(&reader).send().await.unwrap().status(), 200);
}

#[tokio::test]
async fn who_speaks_grpc_is_sent_to_its_port() {
    let server = TestServer::start().await;
    let mut client = tests::connect(server.running().http_addr).await.unwrap();
    let refused = client.list_sessions(v1::ListSessionsRequest::default()).await.unwrap_err();
    assert_eq!(refused.code(), tonic::Code::Unimplemented);
    assert!(refused.message().contains("gRPC port"), "{refused}");
}
