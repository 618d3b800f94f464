//! The end in order: streams are told, everything is saved, the database is whole.

use proto::v1;
use server::{Config, Server, Shutdown};
use std::time::{Duration, Instant};
use store::{Store, StoreOptions};
use tests::{FrameStream, TestServer, camera, create_session, frame, open_message, png};
use tonic::Code;

fn good() -> v1::Image {
    png(320, 240, &[100; 320 * 240])
}

#[tokio::test]
async fn a_shutdown_saves_what_was_tracked_and_tells_the_client() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(320, 240)).await.unwrap();
    let mut stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
    for sequence in 0..3 {
        stream.track(frame(sequence, good())).await.unwrap();
    }
    let start = Instant::now();
    let (shutdown, told) = tokio::join!(server.shut_down(), stream.next());
    let (outcome, folder) = shutdown;
    assert_eq!(outcome, Shutdown::Complete);
    assert!(start.elapsed() < Duration::from_secs(10), "the shutdown took {:?}", start.elapsed());
    assert_eq!(told.unwrap_err().code(), Code::Unavailable);

    let store =
        Store::open(folder.path().join(server::DATABASE_FILE), StoreOptions::default()).await.unwrap();
    assert_eq!(store.get_session("s").await.unwrap().last_frame.map(|(sequence, _)| sequence), Some(2));
    assert!(store.check().await.unwrap().is_empty());
}

#[tokio::test]
async fn a_client_that_does_not_read_its_answers_cannot_hold_a_shutdown_up() {
    let server = TestServer::start_with(|config| config.shutdown_grace_s = 10.0).await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(320, 240)).await.unwrap();
    let stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
    let sender = stream.sender();
    let image = good();
    // Sends until flow control stops it, and reads nothing.
    let sending = tokio::spawn(async move {
        for sequence in 0.. {
            let message = Some(v1::stream_frames_request::Message::Frame(frame(sequence, image.clone())));
            if sender.send(v1::StreamFramesRequest { message }).await.is_err() {
                break;
            }
        }
    });
    tokio::time::sleep(Duration::from_millis(500)).await;
    let start = Instant::now();
    // The stream is kept, so that the connection stays open while the server ends.
    let (outcome, _folder) = server.shut_down().await;
    assert!(
        start.elapsed() < Duration::from_secs(20),
        "the shutdown took {:?}: {outcome:?}",
        start.elapsed()
    );
    drop(stream);
    sending.abort();
}

#[tokio::test]
async fn two_servers_cannot_share_a_database() {
    let server = TestServer::start().await;
    let error = Server::start(Config::local(server.folder()))
        .await
        .err()
        .expect("the second server refuses to start");
    assert!(error.to_string().contains("another server"), "{error:#}");
    // Somebody tidies up.
    std::fs::remove_file(server.folder().join("monoslam.lock")).unwrap();
    let error = Server::start(Config::local(server.folder())).await.err().expect("it is refused again");
    assert!(error.to_string().contains("another server"), "{error:#}");
    let (outcome, folder) = server.shut_down().await;
    assert_eq!(outcome, Shutdown::Complete);
    let next = Server::start(Config::local(folder.path())).await.expect("the folder is free again");
    assert_eq!(next.shutdown().await, Shutdown::Complete);
}
