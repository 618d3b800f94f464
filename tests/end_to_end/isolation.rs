//! Nobody sees another's sessions: every call of the contract and every route of the interface, with another
//! owner's token, and with none. What there is to ask is read from the contract and the interface
//! themselves, so that a new call or route cannot be forgotten.

use bytes::{Buf, BufMut, Bytes};
use prost::Message as _;
use prost_types::{FileDescriptorSet, MethodDescriptorProto};
use proto::v1;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use store::TokenRole;
use tests::{SmallWorld, TestServer, open_message, with_token};
use tokio_stream::StreamExt;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::{Code, Status};

const SERVICE: &str = "monoslam.v1.SlamService";

/// Routes that tell nothing about anybody.
const PUBLIC: [&str; 3] = ["get /healthz", "get /readyz", "delete /v1/tickets"];
/// Routes that are about no one session.
const GENERAL: [&str; 9] = [
    "get /metrics",
    "get /v1/fleet",
    "get /v1/operations",
    "get /v1/operations/{operation}",
    "get /v1/sessions",
    "post /v1/localize",
    "post /v1/operations/{operation}/cancel",
    "post /v1/sessions",
    "post /v1/tickets",
];

/// Messages as bytes.
#[derive(Clone, Copy, Default)]
struct Raw;

impl Codec for Raw {
    type Encode = Bytes;
    type Decode = Bytes;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        *self
    }

    fn decoder(&mut self) -> Self {
        *self
    }
}

impl Encoder for Raw {
    type Item = Bytes;
    type Error = Status;

    fn encode(&mut self, item: Bytes, into: &mut EncodeBuf<'_>) -> Result<(), Status> {
        into.put(item);
        Ok(())
    }
}

impl Decoder for Raw {
    type Item = Bytes;
    type Error = Status;

    fn decode(&mut self, from: &mut DecodeBuf<'_>) -> Result<Option<Bytes>, Status> {
        Ok(Some(from.copy_to_bytes(from.remaining())))
    }
}

/// Two owners; the first has a session that was streamed into.
pub struct Owners {
    pub server: TestServer,
    pub ann: String,
    pub bob: String,
}

pub const SESSION: &str = "kitchen";
const NO_SESSION: &str = "nowhere";

pub async fn owners() -> Owners {
    let world = SmallWorld::new(1);
    let server = TestServer::start().await;
    let ann = server.token("ann", TokenRole::Writer).await;
    let bob = server.token("bob", TokenRole::Writer).await;
    let mut client = server.client().await;
    let new = v1::CreateSessionRequest {
        session_id: SESSION.into(),
        camera: Some(world.camera()),
        options: None,
        ..v1::CreateSessionRequest::default()
    };
    client.create_session(with_token(&ann, new)).await.unwrap();
    let messages = [
        v1::stream_frames_request::Message::Open(open_message(SESSION)),
        v1::stream_frames_request::Message::Frame(world.frame(0)),
    ];
    let messages = messages.map(|message| v1::StreamFramesRequest { message: Some(message) });
    let answers = client.stream_frames(with_token(&ann, tokio_stream::iter(messages))).await.unwrap();
    assert_eq!(answers.into_inner().filter_map(Result::ok).collect::<Vec<_>>().await.len(), 2);
    Owners { server, ann, bob }
}

/// The calls of the contract.
pub fn calls() -> Vec<MethodDescriptorProto> {
    let set = FileDescriptorSet::decode(proto::FILE_DESCRIPTOR_SET).unwrap();
    let services =
        set.file.into_iter().filter(|file| file.package() == "monoslam.v1").flat_map(|file| file.service);
    let service = services.into_iter().find(|service| service.name() == "SlamService").unwrap();
    assert!(service.method.len() >= 16);
    service.method
}

/// A request about a session, of a form that is complete enough to be looked up.
pub fn request(method: &str, session: &str) -> Bytes {
    let session_id = session.to_owned();
    let message = match method {
        "StreamFrames" => {
            let message = Some(v1::stream_frames_request::Message::Open(open_message(session)));
            v1::StreamFramesRequest { message }.encode_to_vec()
        }
        "Localize" => {
            let image = Some(tests::raw_gray(480, 360, &[0; 480 * 360]));
            v1::LocalizeRequest { session_id, image, ..Default::default() }.encode_to_vec()
        }
        "ExportMap" => {
            let format = v1::MapFormat::Ply.into();
            v1::ExportMapRequest { session_id, format, submap_id: None }.encode_to_vec()
        }
        // Every other one begins with the session's id.
        _ => v1::GetSessionRequest { session_id }.encode_to_vec(),
    };
    message.into()
}

/// What comes of a call: the first answer, or how it was refused.
pub async fn call(
    server: &TestServer,
    method: &str,
    message: Bytes,
    token: Option<&str>,
) -> Result<Bytes, Status> {
    let channel = tonic::transport::Channel::from_shared(format!("http://{}", server.running().grpc_addr));
    let mut grpc = tonic::client::Grpc::new(channel.unwrap().connect().await.unwrap());
    grpc.ready().await.unwrap();
    let messages = tokio_stream::once(message);
    let request = match token {
        Some(token) => with_token(token, messages),
        None => tonic::Request::new(messages),
    };
    let path = format!("/{SERVICE}/{method}").parse().unwrap();
    let mut answers = grpc.streaming(request, path, Raw).await?.into_inner();
    Ok(answers.message().await?.unwrap_or_default())
}

fn refusal(refused: &Status, session: &str) -> (Code, String, Vec<u8>) {
    let (message, details) = (refused.message().replace(session, "…"), refused.details());
    let details = String::from_utf8_lossy(details).replace(session, "…").into_bytes();
    // The sentence is in the details too, after its length.
    (refused.code(), message, details.into_iter().filter(u8::is_ascii_graphic).collect())
}

#[tokio::test(flavor = "multi_thread")]
async fn no_call_tells_of_anothers_session() {
    let Owners { server, ann, bob } = owners().await;
    for method in calls() {
        let method = method.name();
        let unknown = call(&server, method, request(method, SESSION), None).await.unwrap_err();
        assert_eq!(unknown.code(), Code::Unauthenticated, "{method}");
        if ["ListSessions", "CreateSession"].contains(&method) {
            continue;
        }
        let others = call(&server, method, request(method, SESSION), Some(&bob)).await.unwrap_err();
        let nobodys = call(&server, method, request(method, NO_SESSION), Some(&bob)).await.unwrap_err();
        assert_eq!(others.code(), Code::NotFound, "{method}: {others:?}");
        assert_eq!(refusal(&others, SESSION), refusal(&nobodys, NO_SESSION), "{method}");
        if ["GetOperation", "CancelOperation"].contains(&method) {
            continue;
        }
        // And by its owner's name, which only administrators may say.
        let named = call(&server, method, request(method, "ann~kitchen"), Some(&bob)).await.unwrap_err();
        assert_eq!(named.code(), Code::InvalidArgument, "{method}");
    }
    let listed = call(&server, "ListSessions", Bytes::new(), Some(&bob)).await.unwrap();
    assert_eq!(v1::ListSessionsResponse::decode(listed).unwrap().sessions, []);
    // A name is taken by nobody else: that it were would tell.
    let new = v1::CreateSessionRequest {
        session_id: SESSION.into(),
        camera: Some(tests::camera(320, 240)),
        options: None,
        ..v1::CreateSessionRequest::default()
    };
    call(&server, "CreateSession", new.encode_to_vec().into(), Some(&bob)).await.unwrap();
    let mine = call(&server, "GetSession", request("GetSession", SESSION), Some(&ann)).await.unwrap();
    assert_eq!(v1::Session::decode(mine).unwrap().n_frames, 1, "hers is as it was");
}

/// Every route of the interface with its method.
pub async fn routes(server: &TestServer) -> Vec<(String, String)> {
    let document: Value = server.get_json("/openapi.json").await;
    let paths = document["paths"].as_object().unwrap();
    let methods = |(path, methods): (&String, &Value)| {
        let methods: Vec<String> = methods.as_object().unwrap().keys().cloned().collect();
        methods.into_iter().map(|method| (method, path.clone())).collect::<Vec<_>>()
    };
    let routes: Vec<_> = paths.iter().flat_map(methods).collect();
    assert!(routes.len() >= 25, "{routes:?}");
    routes
}

pub async fn ask(
    server: &TestServer,
    (method, path): &(String, String),
    session: &str,
    token: Option<&str>,
) -> (u16, String) {
    let mut path = path.replace("{id}", session);
    for (name, value) in [("{kf}", "1"), ("{p}", "1"), ("{sequence}", "0"), ("{operation}", "op-0")] {
        path = path.replace(name, value);
    }
    assert!(!path.contains('{'), "{path}: a part that this test does not know");
    if path.ends_with("/map") {
        path.push_str("?format=ply");
    }
    let url = format!("http://{}{path}", server.running().http_addr);
    let client = reqwest::Client::new();
    let request = client.request(method.to_uppercase().parse().unwrap(), url);
    let request = match path.rsplit('/').next().unwrap() {
        "localize" | "mask" => {
            request.header("content-type", "image/png").body(tests::png(480, 360, &[255; 480 * 360]).data)
        }
        "motion" => request.header("content-type", "text/csv").body("5,0,0,0,0,9.81,0\n"),
        "merge" => {
            request.header("content-type", "application/json").body(json!({"from": "kitchen"}).to_string())
        }
        "scale" => {
            request.header("content-type", "application/json").body(json!({"metres_per_unit": 2}).to_string())
        }
        _ => request.header("content-type", "application/json").body("{}"),
    };
    let request = match token {
        Some(token) => request.header("authorization", format!("Bearer {token}")),
        None => request,
    };
    let answer = request.send().await.unwrap();
    let status = answer.status().as_u16();
    let is_endless = status == 200 && path.ends_with("/events");
    (status, if is_endless { String::new() } else { answer.text().await.unwrap().replace(session, "…") })
}

#[tokio::test(flavor = "multi_thread")]
async fn no_route_tells_of_anothers_session() {
    let Owners { server, ann, bob } = owners().await;
    let mut general = BTreeSet::new();
    let mut n_asked = 0;
    for route in routes(&server).await {
        let name = format!("{} {}", route.0, route.1);
        let (status, answer) = ask(&server, &route, SESSION, None).await;
        if PUBLIC.contains(&name.as_str()) {
            assert!(!answer.contains("ann") && status < 300, "{name}: {status} {answer}");
            continue;
        }
        assert_eq!(status, 401, "{name}: {answer}");
        if !route.1.contains("{id}") {
            general.insert(name);
            continue;
        }
        let others = ask(&server, &route, SESSION, Some(&bob)).await;
        assert_eq!(others.0, 404, "{name}: {}", others.1);
        assert_eq!(others, ask(&server, &route, NO_SESSION, Some(&bob)).await, "{name}");
        assert_eq!(ask(&server, &route, "ann~kitchen", Some(&bob)).await.0, 400, "{name}");
        n_asked += 1;
    }
    assert!(n_asked >= 20, "{n_asked}");
    assert_eq!(general.iter().map(String::as_str).collect::<Vec<_>>(), GENERAL);
    let list = ("get".to_owned(), "/v1/sessions".to_owned());
    assert_eq!(ask(&server, &list, SESSION, Some(&bob)).await.1, r#"{"sessions":[],"next_page_token":null}"#);
    assert!(ask(&server, &list, SESSION, Some(&ann)).await.1.contains(r#""id":"…""#));
}
