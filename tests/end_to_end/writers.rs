//! Who may write into a session, and what happens when a writer goes away.

use proto::v1;
use std::time::{Duration, Instant};
use tests::{FrameStream, TestServer, camera, create_session, frame, open_message, png};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tonic::Code;

fn good() -> v1::Image {
    png(320, 240, &[100; 320 * 240])
}

#[tokio::test]
async fn a_second_writer_is_told_so_and_may_take_over() {
    let server = TestServer::start().await;
    let (mut first_client, mut second_client) = (server.client().await, server.client().await);
    create_session(&mut first_client, "s", camera(320, 240)).await.unwrap();
    let mut first = FrameStream::open(&mut first_client, open_message("s")).await.unwrap();
    first.track(frame(0, good())).await.unwrap();
    assert_eq!(server.get_json("/v1/sessions/s").await["has_writer"], true);

    let refused = FrameStream::open(&mut second_client, open_message("s")).await.err().unwrap();
    assert_eq!(refused.code(), Code::FailedPrecondition);
    assert!(refused.message().contains("take_over"), "{refused}");
    first.track(frame(1, good())).await.unwrap();

    let take_over = v1::OpenStream { take_over: true, ..open_message("s") };
    let mut second = FrameStream::open(&mut second_client, take_over).await.unwrap();
    assert_eq!((second.opened.next_sequence, second.opened.durable_sequence), (2, Some(1)));
    let ended = first.next().await.unwrap_err();
    assert_eq!(ended.code(), Code::Aborted, "{ended}");
    assert!(!second.track(frame(2, good())).await.unwrap().repeated);
    second.finish().await.unwrap();
    assert_eq!(server.get_json("/v1/sessions/s").await["has_writer"], false);
}

#[tokio::test]
async fn a_stream_that_ends_well_can_be_followed_at_once() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(320, 240)).await.unwrap();
    for sequence in 0..5 {
        let mut stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
        assert_eq!(stream.opened.next_sequence, sequence);
        stream.track(frame(sequence, good())).await.unwrap();
        stream.finish().await.unwrap();
        // The end of the stream comes after the last frame was saved.
        assert_eq!(server.get_json("/v1/sessions/s").await["durable_sequence"], sequence);
    }
}

/// Passes bytes between a client and the server until it has passed so many towards the server, then hangs up
/// on both.
async fn hang_up_after(server: std::net::SocketAddr, n_bytes: usize) -> std::net::SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let addr = listener.local_addr().unwrap();
    tokio::spawn(async move {
        let (mut client, _) = listener.accept().await.unwrap();
        let mut upstream = TcpStream::connect(server).await.unwrap();
        let (mut from_client, mut to_client) = client.split();
        let (mut from_server, mut to_server) = upstream.split();
        let forth = async {
            let (mut left, mut buffer) = (n_bytes, vec![0; 4096]);
            while left > 0 {
                let room = left.min(buffer.len());
                let n_read = from_client.read(&mut buffer[..room]).await.unwrap_or(0);
                if n_read == 0 || to_server.write_all(&buffer[..n_read]).await.is_err() {
                    break;
                }
                left -= n_read;
            }
        };
        tokio::select! {
            () = forth => {}
            _ = tokio::io::copy(&mut from_server, &mut to_client) => {}
        }
    });
    addr
}

#[tokio::test]
async fn a_stream_that_stops_in_the_middle_of_a_message_leaves_the_session_as_it_is() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(320, 240)).await.unwrap();
    // Raw pixels are 76 800 bytes each: this hangs up inside the third frame.
    let proxy = hang_up_after(server.running().grpc_addr, 200_000).await;
    let mut fragile = tests::connect(proxy).await.unwrap();
    let mut stream = FrameStream::open(&mut fragile, open_message("s")).await.unwrap();
    let image = tests::raw_gray(320, 240, &[100; 320 * 240]);
    let mut n_answered = 0;
    for sequence in 0..5 {
        match stream.exchange(frame(sequence, image.clone())).await {
            Ok(_) => n_answered += 1,
            Err(_) => break,
        }
    }
    assert_eq!(n_answered, 2);

    let mut again = reopened(&mut client).await;
    assert_eq!((again.opened.next_sequence, again.opened.durable_sequence), (2, Some(1)));
    again.track(frame(2, image)).await.unwrap();
    again.finish().await.unwrap();
    assert_eq!(server.get_json("/v1/sessions/s").await["n_frames"], 3);
}

/// Opens the session as soon as the server has noticed that its writer is gone.
async fn reopened(client: &mut tests::Client) -> FrameStream {
    let start = Instant::now();
    loop {
        match FrameStream::open(client, open_message("s")).await {
            Ok(stream) => return stream,
            Err(status) => {
                assert_eq!(status.code(), Code::FailedPrecondition, "{status}");
                assert!(start.elapsed() < Duration::from_secs(10), "the server does not notice: {status}");
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        }
    }
}

#[tokio::test]
async fn an_idle_session_leaves_memory_and_comes_back() {
    let server = TestServer::start_with(|config| config.sessions.idle_unload_s = 0.1).await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(320, 240)).await.unwrap();
    let mut stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
    stream.track(frame(0, good())).await.unwrap();
    stream.finish().await.unwrap();
    let start = Instant::now();
    while server.get_json("/v1/sessions/s").await["loaded"] == true {
        assert!(start.elapsed() < Duration::from_secs(10), "the session stays in memory");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let mut stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
    assert_eq!(stream.opened.next_sequence, 1);
    stream.track(frame(1, good())).await.unwrap();
    stream.finish().await.unwrap();
}
