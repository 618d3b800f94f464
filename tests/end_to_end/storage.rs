//! Databases that cannot be written, or not by this version.

use proto::v1;
use server::{Config, Server};
use sqlx::{Connection, SqliteConnection};
use tests::{FrameStream, TestServer, camera, create_session, open_message};
use tonic::Code;

#[tokio::test]
async fn a_database_of_a_newer_version_is_refused_and_left_alone() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(320, 240)).await.unwrap();
    let (_, folder) = server.shut_down().await;
    let file = folder.path().join(server::DATABASE_FILE);
    let mut database = SqliteConnection::connect(file.to_str().unwrap()).await.unwrap();
    let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
                 VALUES (9999, 'from the future', 1, x'00', 0)";
    sqlx::query(newer).execute(&mut database).await.unwrap();
    database.close().await.unwrap();
    let before = std::fs::read(&file).unwrap();

    let error = Server::start(Config::local(folder.path())).await.err().expect("the server refuses to start");
    let sentence = format!("{error:#}");
    assert!(sentence.contains("9999") && sentence.contains("update"), "{sentence}");
    assert_eq!(std::fs::read(&file).unwrap(), before, "the database was touched");
}

#[tokio::test]
async fn a_full_disk_ends_the_stream_with_a_clear_error_and_loses_nothing_that_was_promised() {
    // Room for the session's row and a few frames, but not for a thousand.
    let server = TestServer::start_with(|config| config.limits.max_database_bytes = Some(300 << 10)).await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(320, 240)).await.unwrap();
    let image = tests::raw_gray(320, 240, &[100; 320 * 240]);
    let mut next_sequence = 0;
    let mut promised = None;
    let status = loop {
        assert!(next_sequence < 20_000, "the disk never fills up");
        let mut stream = match FrameStream::open(&mut client, open_message("s")).await {
            Ok(stream) => stream,
            Err(status) => break status,
        };
        promised = stream.opened.durable_sequence;
        let sender = stream.sender();
        let (first, image) = (next_sequence, image.clone());
        let sending = tokio::spawn(async move {
            for sequence in first..first + 500 {
                let frame = tests::frame(sequence, image.clone());
                let message = Some(v1::stream_frames_request::Message::Frame(frame));
                if sender.send(v1::StreamFramesRequest { message }).await.is_err() {
                    break;
                }
            }
        });
        let mut failure = None;
        for _ in 0..500 {
            match stream.next().await {
                Ok(_) => {}
                Err(status) => {
                    failure = Some(status);
                    break;
                }
            }
        }
        sending.await.unwrap();
        let failure = match failure {
            None => stream.finish().await.err(),
            failure => failure,
        };
        if let Some(status) = failure {
            break status;
        }
        next_sequence += 500;
    };
    assert_eq!(status.code(), Code::ResourceExhausted, "{status}");
    assert!(status.message().contains("room"), "{status}");

    // Reading goes on, and what was promised is there and whole.
    let session = server.get_json("/v1/sessions/s").await;
    assert_eq!(session["durable_sequence"].as_u64(), promised);
    assert_eq!(session["n_frames"].as_u64(), Some(promised.map_or(0, |sequence| sequence + 1)));
    let problems = server.running().service().store().check().await.unwrap();
    assert!(problems.is_empty(), "{problems:?}");
}
