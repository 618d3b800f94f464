//! What clients send and do not finish takes no more memory than it may.

use crate::program::ServerProcess;
use bytes::Bytes;
use http_body_util::{BodyExt, StreamBody};
use hyper::body::Frame;
use hyper_util::rt::{TokioExecutor, TokioIo};
use proto::v1;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// Messages that are begun and not finished.
const N_MESSAGES: usize = 10;
/// Their length, bytes, and as much of it as is sent.
const MESSAGE_BYTES: usize = 60 << 20;
const SENT_BYTES: usize = MESSAGE_BYTES - (1 << 20);
/// What the server may hold of them, by its default.
const BUDGET_BYTES: u64 = 256 << 20;
/// What else the server may take on meanwhile, bytes.
const OTHER_BYTES: u64 = 64 << 20;

type Sending = mpsc::Sender<Result<Frame<Bytes>, std::io::Error>>;

/// Begins a message of a stream on a connection of its own, in the raw. How its call ended, once it has, in
/// the words of the server.
async fn begin(grpc_addr: SocketAddr) -> (Sending, tokio::task::JoinHandle<String>) {
    let socket = tokio::net::TcpStream::connect(grpc_addr).await.unwrap();
    let io = TokioIo::new(socket);
    let (mut sender, connection) =
        hyper::client::conn::http2::handshake(TokioExecutor::new(), io).await.unwrap();
    tokio::spawn(connection);
    let (sending, body) = mpsc::channel(1);
    let request = hyper::Request::post(format!("http://{grpc_addr}/monoslam.v1.SlamService/StreamFrames"))
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(StreamBody::new(ReceiverStream::new(body)))
        .unwrap();
    let answering = tokio::spawn(async move {
        let mut answer = sender.send_request(request).await.unwrap().into_body();
        while let Some(Ok(frame)) = answer.frame().await {
            if let Some(trailers) = frame.trailers_ref() {
                let text = |name| trailers.get(name).map_or("", |value| value.to_str().unwrap()).to_owned();
                return format!("{} {}", text("grpc-status"), text("grpc-message"));
            }
        }
        String::new()
    });
    (sending, answering)
}

/// Sends all of a message but its end, as far as the server takes it.
async fn send(sending: Sending) -> Sending {
    let mut head = vec![0];
    head.extend((MESSAGE_BYTES as u32).to_be_bytes());
    let chunk = Bytes::from(vec![0; 64 << 10]);
    let chunks = std::iter::repeat_n(chunk, SENT_BYTES >> 16);
    for data in std::iter::once(Bytes::from(head)).chain(chunks) {
        if sending.send(Ok(Frame::data(data))).await.is_err() {
            break;
        }
    }
    sending
}

#[tokio::test(flavor = "multi_thread")]
async fn unfinished_messages_take_what_they_may_and_the_rest_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(folder.path());
    let before = server.resident_bytes();
    let mut calls = Vec::new();
    for _ in 0..N_MESSAGES {
        let (sending, answering) = begin(server.grpc_addr).await;
        calls.push((tokio::spawn(send(sending)), answering));
    }
    // Those that fit are there, and those that do not have been told so.
    let mut most = before;
    let mut n_refused = 0;
    for _ in 0..100 {
        tokio::time::sleep(Duration::from_millis(100)).await;
        most = most.max(server.resident_bytes());
        n_refused = calls.iter().filter(|(_, answering)| answering.is_finished()).count();
    }
    let grown = most - before;
    eprintln!("{} MB more with {N_MESSAGES} messages of {} MB begun", grown >> 20, MESSAGE_BYTES >> 20);
    assert!(grown < BUDGET_BYTES + OTHER_BYTES, "{} MB more", grown >> 20);
    assert_eq!(n_refused, N_MESSAGES - BUDGET_BYTES as usize / MESSAGE_BYTES, "four fit");
    // Others are served meanwhile.
    let mut client = server.client().await;
    client.list_sessions(v1::ListSessionsRequest::default()).await.unwrap();
    for (sending, answering) in calls {
        if !answering.is_finished() {
            sending.abort();
            continue;
        }
        let ended = answering.await.unwrap();
        assert!(ended.starts_with("8 ") && ended.contains("as%20many%20as%20it%20may"), "{ended}");
    }
    assert!(server.terminate());
}

/// Opens a WebSocket and begins a message on it, in the raw. What the server answered to the handshake.
async fn begin_over_web_socket(http_addr: SocketAddr, id: &str) -> (tokio::net::TcpStream, String) {
    let mut socket = tokio::net::TcpStream::connect(http_addr).await.unwrap();
    let request = format!(
        "GET /v1/sessions/{id}/stream HTTP/1.1\r\nhost: {http_addr}\r\nconnection: upgrade\r\nupgrade: websocket\r\n\
         sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    socket.write_all(request.as_bytes()).await.unwrap();
    let mut answer = [0; 1000];
    let n_bytes = socket.read(&mut answer).await.unwrap();
    // Binary, whole, masked by zeros, with a length of 64 bits [RFC 6455, 5.2].
    let mut head = vec![0x82, 0x80 | 127];
    head.extend((MESSAGE_BYTES as u64).to_be_bytes());
    head.extend([0; 4]);
    socket.write_all(&head).await.unwrap();
    (socket, String::from_utf8_lossy(&answer[..n_bytes]).into_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn unfinished_messages_over_web_sockets_take_no_more_either() {
    let folder = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(folder.path());
    let mut client = server.client().await;
    for i in 0..N_MESSAGES {
        tests::create_session(&mut client, &format!("s{i}"), tests::camera(320, 240)).await.unwrap();
    }
    let before = server.resident_bytes();
    let mut sending = Vec::new();
    for i in 0..N_MESSAGES {
        let (mut socket, answer) = begin_over_web_socket(server.http_addr, &format!("s{i}")).await;
        assert!(answer.starts_with("HTTP/1.1 101"), "{answer}");
        sending.push(tokio::spawn(async move {
            let chunk = vec![0; 64 << 10];
            for _ in 0..SENT_BYTES >> 16 {
                if socket.write_all(&chunk).await.is_err() {
                    break;
                }
            }
            // What the server says last, if it does.
            let mut said = Vec::new();
            let _ = tokio::time::timeout(Duration::from_secs(12), socket.read_to_end(&mut said)).await;
            String::from_utf8_lossy(&said).into_owned()
        }));
    }
    let mut most = before;
    for _ in 0..100 {
        tokio::time::sleep(Duration::from_millis(100)).await;
        most = most.max(server.resident_bytes());
    }
    let grown = most - before;
    eprintln!(
        "{} MB more with {N_MESSAGES} messages over WebSockets of {} MB begun",
        grown >> 20,
        MESSAGE_BYTES >> 20
    );
    // Messages grow by doubling, so that what was read is in memory once and a half.
    assert!(grown < BUDGET_BYTES * 2 + OTHER_BYTES, "{} MB more", grown >> 20);
    client.list_sessions(v1::ListSessionsRequest::default()).await.unwrap();
    let mut n_refused = 0;
    for sending in sending {
        n_refused += usize::from(sending.await.unwrap().contains("as many as it may"));
    }
    assert!(n_refused >= 1, "nobody was told why");
    assert!(server.terminate());
}
