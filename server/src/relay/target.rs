//! What a request needs of which server, without knowing more of it than its path and the name in it.

use crate::connections::Interface;
use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method};
use futures_util::StreamExt;
use http_body::Frame;
use http_body_util::{BodyExt, BodyStream, Full, StreamBody};
use std::time::Duration;
use tonic::codec::{Codec, CompressionEncoding, Streaming};

/// Bytes before each gRPC message.
const HEAD_BYTES: usize = 5;

/// Why a request is not answered by any server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// A stream of frames: the server that works with the session, or takes it.
    Stream,
    /// What happens in a session, which only the server that works with it knows.
    Watch,
    /// What that server has in memory alone, or must agree to.
    Owner,
    /// An operation, which only the server knows that works on it.
    Operation,
}

/// Which server a request needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    /// Why.
    pub need: Need,
    /// The session as the caller calls it, or the operation.
    pub name: String,
}

/// What was found out about a request, which stays as it was.
pub enum Sought {
    /// What it needs, if not just any server.
    Found(Option<Target>, Request),
    /// It is a stream of frames that was not opened yet.
    Unopened(Request),
}

/// What a request needs. The first message of a call, which says which session is meant, is waited for so
/// long.
pub async fn of(request: Request, interface: Interface, max_bytes: usize, patience: Duration) -> Sought {
    if interface == Interface::Http {
        return Sought::Found(of_route(request.method(), request.uri().path()), request);
    }
    let Some(need) = of_call(request.uri().path()) else { return Sought::Found(None, request) };
    let (parts, mut body) = request.into_parts();
    let mut kept = Vec::new();
    let reading = first_message(&mut body, &mut kept, max_bytes);
    let message = tokio::time::timeout(patience, reading).await;
    let is_late = message.is_err();
    let name = match message {
        Ok(Some(message)) => name_in(message, need, &parts, max_bytes).await,
        _ => None,
    };
    let request = Request::from_parts(parts, replayed(kept, body));
    if is_late && need == Need::Stream {
        return Sought::Unopened(request);
    }
    Sought::Found(name.map(|name| Target { need, name }), request)
}

/// What a request over HTTP needs. What changes something and stands nowhere here needs the owner.
fn of_route(method: &Method, path: &str) -> Option<Target> {
    let is_reading = matches!(*method, Method::GET | Method::HEAD);
    let segments: Vec<&str> = path.split('/').skip(1).collect();
    let (need, name) = match (segments.as_slice(), is_reading) {
        (["v1", "sessions", id, "stream"], true) => (Need::Stream, id),
        (["v1", "sessions", id, "events"], true) => (Need::Watch, id),
        // Which changes a page has seen is known where they were made, and so are the last images.
        (["v1", "sessions", id, "scene"] | ["v1", "sessions", id, "frames", ..], true) => (Need::Owner, id),
        // From the last commit, by whoever is asked.
        (["v1", "sessions", _, "localize"], false) => return None,
        (["v1", "sessions", id, ..], false) => (Need::Owner, id),
        (["v1", "operations", id, ..], _) => (Need::Operation, id),
        _ => return None,
    };
    Some(Target { need, name: (*name).to_owned() })
}

/// What a call needs.
fn of_call(path: &str) -> Option<Need> {
    match path.strip_prefix("/monoslam.v1.SlamService/")? {
        "StreamFrames" => Some(Need::Stream),
        "WatchMap" => Some(Need::Watch),
        "DeleteSession" | "UpdateSession" | "SetScale" | "OptimizeMap" | "MergeSessions" => Some(Need::Owner),
        "GetOperation" | "CancelOperation" => Some(Need::Operation),
        _ => None,
    }
}

/// What all requests that name a session, or an operation, have in common: the name is their first field.
#[derive(Clone, PartialEq, prost::Message)]
struct Named {
    #[prost(string, tag = "1")]
    name: String,
}

/// The first message of a stream of frames.
#[derive(Clone, PartialEq, prost::Message)]
struct Opening {
    #[prost(message, optional, tag = "1")]
    open: Option<Named>,
}

async fn name_in(message: Bytes, need: Need, parts: &Parts, max_bytes: usize) -> Option<String> {
    let encoding = encoding(&parts.headers)?;
    if need == Need::Stream {
        return decoded::<Opening>(message, encoding, max_bytes).await?.open.map(|open| open.name);
    }
    decoded::<Named>(message, encoding, max_bytes).await.map(|named| named.name)
}

/// How the messages of a call are compressed; `None` if in a way that is not known.
fn encoding(headers: &HeaderMap) -> Option<Option<CompressionEncoding>> {
    match headers.get("grpc-encoding").map_or("identity", |value| value.to_str().unwrap_or_default()) {
        "identity" => Some(None),
        "gzip" => Some(Some(CompressionEncoding::Gzip)),
        "zstd" => Some(Some(CompressionEncoding::Zstd)),
        _ => None,
    }
}

/// What a message says, with its length before it. What cannot be read is refused by who answers.
async fn decoded<M: prost::Message + Default + 'static>(
    message: Bytes,
    encoding: Option<CompressionEncoding>,
    max_bytes: usize,
) -> Option<M> {
    let decoder = tonic_prost::ProstCodec::<M, M>::default().decoder();
    let mut messages = Streaming::new_request(decoder, Full::new(message), encoding, Some(max_bytes));
    messages.message().await.ok().flatten()
}

/// The first message of a call, with its length before it, if it comes and is not too long. What was read of
/// the body is kept.
async fn first_message(
    body: &mut Body,
    kept: &mut Vec<Result<Frame<Bytes>, axum::Error>>,
    max_bytes: usize,
) -> Option<Bytes> {
    let mut read = Vec::new();
    loop {
        if let [_, a, b, c, d, ..] = read[..] {
            let n_bytes = HEAD_BYTES + u32::from_be_bytes([a, b, c, d]) as usize;
            if n_bytes > HEAD_BYTES + max_bytes {
                return None;
            }
            if read.len() >= n_bytes {
                read.truncate(n_bytes);
                return Some(read.into());
            }
        }
        let frame = body.frame().await?;
        let data = frame.as_ref().ok().and_then(Frame::data_ref).cloned();
        kept.push(frame);
        read.extend_from_slice(&data?);
    }
}

/// A body as it was before some of it was read.
fn replayed(kept: Vec<Result<Frame<Bytes>, axum::Error>>, rest: Body) -> Body {
    Body::new(StreamBody::new(futures_util::stream::iter(kept).chain(BodyStream::new(rest))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost::Message;
    use proto::v1;

    fn framed(message: &impl Message) -> Vec<u8> {
        let bytes = message.encode_to_vec();
        [&[0], &(bytes.len() as u32).to_be_bytes()[..], &bytes].concat()
    }

    /// A call whose body comes in pieces of so many bytes.
    fn call(path: &str, sent: &[u8], n_bytes: usize) -> Request {
        let pieces: Vec<_> = sent
            .chunks(n_bytes)
            .map(|piece| Ok::<_, axum::Error>(Frame::data(Bytes::copy_from_slice(piece))))
            .collect();
        let body = Body::new(StreamBody::new(futures_util::stream::iter(pieces)));
        Request::builder().uri(format!("/monoslam.v1.SlamService/{path}")).body(body).unwrap()
    }

    async fn target_of(request: Request, max_bytes: usize) -> (Option<Target>, Request) {
        match of(request, Interface::Grpc, max_bytes, Duration::from_secs(5)).await {
            Sought::Found(target, request) => (target, request),
            Sought::Unopened(_) => panic!("nothing came"),
        }
    }

    #[tokio::test]
    async fn a_stream_that_is_not_opened_yet_loses_nothing() {
        let (sender, receiver) = tokio::sync::mpsc::channel(4);
        let body = StreamBody::new(tokio_stream::wrappers::ReceiverStream::new(receiver));
        let path = "/monoslam.v1.SlamService/StreamFrames";
        let request = Request::builder().uri(path).body(Body::new(body)).unwrap();
        let open = v1::OpenStream { session_id: "kitchen".into(), ..Default::default() };
        let open = v1::StreamFramesRequest { message: Some(v1::stream_frames_request::Message::Open(open)) };
        let bytes = framed(&open);
        let piece = |bytes: &[u8]| Ok::<_, axum::Error>(Frame::data(Bytes::copy_from_slice(bytes)));
        sender.send(piece(&bytes[..7])).await.unwrap();
        let soon = Duration::from_millis(20);
        let Sought::Unopened(request) = of(request, Interface::Grpc, 1 << 20, soon).await else {
            panic!("half a message was read")
        };
        sender.send(piece(&bytes[7..])).await.unwrap();
        let (target, _) = target_of(request, 1 << 20).await;
        assert_eq!(target.unwrap().name, "kitchen");
    }

    #[tokio::test]
    async fn the_session_of_a_call_is_found_and_the_call_stays_what_it_is() {
        let open = v1::OpenStream { session_id: "kitchen".into(), take_over: true, ..Default::default() };
        let open = v1::StreamFramesRequest { message: Some(v1::stream_frames_request::Message::Open(open)) };
        let frame = v1::Frame { sequence: 7, ..Default::default() };
        let frame =
            v1::StreamFramesRequest { message: Some(v1::stream_frames_request::Message::Frame(frame)) };
        let both = [framed(&open), framed(&frame)].concat();
        for n_bytes in [1, 4, 13, 1000] {
            let (target, request) = target_of(call("StreamFrames", &both, n_bytes), 1 << 20).await;
            assert_eq!(target, Some(Target { need: Need::Stream, name: "kitchen".into() }), "{n_bytes}");
            assert_eq!(request.into_body().collect().await.unwrap().to_bytes(), both, "{n_bytes}");
        }
        let (target, _) = target_of(call("StreamFrames", &framed(&frame), 1000), 1 << 20).await;
        assert_eq!(target, None, "a stream that was not opened");
        let (target, request) = target_of(call("StreamFrames", &both, 1000), 4).await;
        assert_eq!(target, None, "a first message that is too long");
        assert_eq!(request.into_body().collect().await.unwrap().to_bytes(), both);
    }

    #[tokio::test]
    async fn every_request_has_its_name_first() {
        let into = v1::MergeSessionsRequest { into: "a".into(), from: "b".into() };
        let scale =
            v1::SetScaleRequest { session_id: "a".into(), metres_per_unit: Some(2.0), ..Default::default() };
        let options = v1::SessionOptions::default();
        let update = v1::UpdateSessionRequest { session_id: "a".into(), options: Some(options) };
        let sent = [
            ("MergeSessions", framed(&into)),
            ("SetScale", framed(&scale)),
            ("UpdateSession", framed(&update)),
            ("DeleteSession", framed(&v1::DeleteSessionRequest { session_id: "a".into() })),
            ("OptimizeMap", framed(&v1::OptimizeMapRequest { session_id: "a".into() })),
            ("WatchMap", framed(&v1::WatchMapRequest { session_id: "a".into() })),
            ("GetOperation", framed(&v1::GetOperationRequest { operation_id: "a".into() })),
            ("CancelOperation", framed(&v1::CancelOperationRequest { operation_id: "a".into() })),
        ];
        for (path, bytes) in sent {
            let (target, _) = target_of(call(path, &bytes, 1000), 1 << 20).await;
            assert_eq!(target.expect(path).name, "a", "{path}");
        }
        let (target, _) = target_of(call("GetSession", &[], 1), 1 << 20).await;
        assert_eq!(target, None, "what is stored is anybody's to answer");
    }

    #[test]
    fn routes_need_the_owner_for_changes_and_for_what_is_in_its_memory() {
        let need = |method: Method, path: &str| of_route(&method, path).map(|target| target.need);
        assert_eq!(need(Method::GET, "/v1/sessions/a/stream"), Some(Need::Stream));
        assert_eq!(need(Method::GET, "/v1/sessions/a/events"), Some(Need::Watch));
        assert_eq!(need(Method::GET, "/v1/sessions/a/scene"), Some(Need::Owner));
        assert_eq!(need(Method::GET, "/v1/sessions/a/frames/7/image"), Some(Need::Owner));
        assert_eq!(need(Method::DELETE, "/v1/sessions/a"), Some(Need::Owner));
        assert_eq!(need(Method::POST, "/v1/sessions/a/unheard"), Some(Need::Owner));
        assert_eq!(need(Method::POST, "/v1/operations/x/cancel"), Some(Need::Operation));
        for path in
            ["/v1/sessions", "/v1/sessions/a", "/v1/sessions/a/map", "/v1/operations", "/metrics", "/"]
        {
            assert_eq!(need(Method::GET, path), None, "{path}");
        }
        assert_eq!(need(Method::POST, "/v1/sessions"), None);
        assert_eq!(need(Method::POST, "/v1/sessions/a/localize"), None);
    }
}
