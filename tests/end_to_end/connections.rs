//! Connections that do nothing do not keep streams from running, nor the server from ending.

use std::time::{Duration, Instant};
use tests::{FrameStream, SmallWorld, TestServer, create_session, open_message};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

async fn raw(server: &TestServer, bytes: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(server.running().http_addr).await.unwrap();
    stream.write_all(bytes).await.unwrap();
    stream
}

/// What the server says until it closes the connection.
async fn last_words(stream: &mut TcpStream, within: Duration) -> String {
    let mut said = Vec::new();
    let read = tokio::time::timeout(within, stream.read_to_end(&mut said)).await;
    assert!(read.is_ok(), "the connection is still open, having said {:?}", String::from_utf8_lossy(&said));
    String::from_utf8_lossy(&said).into_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn two_thousand_idle_connections_beside_two_streams() {
    let world = SmallWorld::new(1);
    let server = TestServer::start_with(|config| {
        config.connections.max_total = 1500;
        config.connections.max_per_address = 2500;
        config.connections.header_timeout_s = 300.0;
    })
    .await;
    let mut client = server.client().await;
    let mut streams = Vec::new();
    for id in ["a", "b"] {
        create_session(&mut client, id, world.camera()).await.unwrap();
        streams.push(FrameStream::open(&mut client, open_message(id)).await.unwrap());
    }
    let mut idle = Vec::new();
    for i in 0..2000 {
        let (http, grpc) = (server.running().http_addr, server.running().grpc_addr);
        idle.push(TcpStream::connect(if i % 2 == 0 { http } else { grpc }).await.unwrap());
    }
    for i in 0..8 {
        for stream in &mut streams {
            stream.track(world.frame(i)).await.unwrap();
        }
    }
    assert_eq!(server.get("/healthz").await, "ok\n", "those that were idle longest made way");
    for stream in streams {
        stream.finish().await.unwrap();
    }
    let session = server.get_json("/v1/sessions/a").await;
    assert_eq!(session["durable_sequence"], 7);
    let began = Instant::now();
    assert_eq!(server.shut_down().await.0, server::Shutdown::Complete);
    assert!(began.elapsed() < Duration::from_secs(5), "shutting down took {:?}", began.elapsed());
    drop(idle);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_stands_still_is_closed_and_what_is_too_much_is_told_why() {
    let server = TestServer::start_with(|config| {
        config.connections.header_timeout_s = 0.5;
        config.connections.body_timeout_s = 0.5;
        config.connections.idle_timeout_s = 0.5;
        config.connections.max_per_address = 2;
    })
    .await;
    let within = Duration::from_secs(5);
    last_words(&mut raw(&server, b"").await, within).await;
    last_words(&mut raw(&server, b"GET / HT").await, within).await;
    let asked = b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n";
    assert!(last_words(&mut raw(&server, asked).await, within).await.contains("200 OK"));
    let half = b"POST /v1/sessions HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n\
                 content-length: 100\r\n\r\n{";
    let answer = last_words(&mut raw(&server, half).await, within).await;
    assert!(answer.contains("400 Bad Request") && answer.contains("problem+json"), "{answer}");

    let events = |id: &str| format!("GET /v1/sessions/{id}/events HTTP/1.1\r\nhost: localhost\r\n\r\n");
    let folder_camera = tests::camera(320, 240);
    create_session(&mut server.client().await, "a", folder_camera).await.unwrap();
    let mut busy = Vec::new();
    for _ in 0..2 {
        let mut stream = raw(&server, events("a").as_bytes()).await;
        stream.read_u8().await.expect("the answer begins");
        busy.push(stream);
    }
    let refused = last_words(&mut raw(&server, asked).await, within).await;
    assert!(refused.contains("503") && refused.contains("2 connections of this address"), "{refused}");
    let refused = tests::connect(server.running().grpc_addr).await;
    let refused = match refused {
        Err(error) => format!("{error:?}"),
        Ok(mut client) => {
            format!("{:?}", client.list_sessions(proto::v1::ListSessionsRequest::default()).await)
        }
    };
    assert!(refused.contains("ResourceExhausted") && refused.contains("2 connections"), "{refused}");
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_that_are_half_there_do_not_hold_up_the_end() {
    let server = TestServer::start().await;
    let mut held = vec![raw(&server, b"").await, raw(&server, b"GET / HT").await];
    let half = b"POST /v1/sessions HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n\
                 content-length: 100\r\n\r\n{";
    held.push(raw(&server, half).await);
    held.push(TcpStream::connect(server.running().grpc_addr).await.unwrap());
    tokio::time::sleep(Duration::from_millis(300)).await;
    let began = Instant::now();
    assert_eq!(server.shut_down().await.0, server::Shutdown::Complete);
    assert!(began.elapsed() < Duration::from_secs(4), "shutting down took {:?}", began.elapsed());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_was_idle_for_long_goes_on() {
    let server = TestServer::start_with(|config| config.connections.idle_timeout_s = 0.5).await;
    let mut client = server.client().await;
    for _ in 0..3 {
        client.list_sessions(proto::v1::ListSessionsRequest::default()).await.unwrap();
        tokio::time::sleep(Duration::from_millis(1200)).await;
    }
    // A stream that pauses is no idle connection.
    let world = SmallWorld::new(1);
    create_session(&mut client, "a", world.camera()).await.unwrap();
    let mut stream = FrameStream::open(&mut client, open_message("a")).await.unwrap();
    tokio::time::sleep(Duration::from_millis(1500)).await;
    stream.track(world.frame(0)).await.unwrap();
    stream.finish().await.unwrap();
}
