//! Databases that cannot be written, or not by this version.

use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use server::{Config, Server};
use sqlx::{Connection, SqliteConnection};
use tests::{FrameStream, TestServer, camera, create_session, open_message};
use tonic::{Code, Status};

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

/// Frames sent over one stream.
const N_PER_STREAM: u64 = 500;

/// Sends frames from `first` on and reads their answers; what was promised to be saved and how the stream
/// ended.
async fn stream_frames(
    mut stream: FrameStream,
    first: u64,
    image: &v1::Image,
) -> (Option<u64>, Result<(), Status>) {
    let (sender, image) = (stream.sender(), image.clone());
    let sending = tokio::spawn(async move {
        for sequence in first..first + N_PER_STREAM {
            let message = Some(Request::Frame(tests::frame(sequence, image.clone())));
            if sender.send(v1::StreamFramesRequest { message }).await.is_err() {
                break;
            }
        }
    });
    let mut promised = stream.opened.durable_sequence;
    for _ in 0..N_PER_STREAM {
        match stream.next().await {
            Ok(Some(Response::Result(result))) => promised = promised.max(result.durable_sequence),
            Ok(other) => panic!("unexpected answer {other:?}"),
            Err(status) => return (promised, Err(status)),
        }
    }
    sending.await.unwrap();
    match stream.finish().await {
        // The end of the stream promises that everything is saved.
        Ok(_) => (Some(first + N_PER_STREAM - 1), Ok(())),
        Err(status) => (promised, Err(status)),
    }
}

#[tokio::test]
async fn a_full_disk_ends_the_stream_with_a_clear_error_and_loses_nothing_that_was_promised() {
    // Room for the empty database, and a little more.
    let (_, folder) = TestServer::start().await.shut_down().await;
    let empty_bytes = std::fs::metadata(folder.path().join(server::DATABASE_FILE)).unwrap().len();
    let server =
        TestServer::start_with(|config| config.limits.max_database_bytes = Some(empty_bytes + (64 << 10)))
            .await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(160, 120)).await.unwrap();
    create_session(&mut client, "other", camera(160, 120)).await.unwrap();
    let image = tests::raw_gray(160, 120, &[100; 160 * 120]);

    let (mut first, mut promised) = (0, None);
    let status = loop {
        assert!(first < 20_000, "the disk never fills up");
        let stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
        let (now_promised, outcome) = stream_frames(stream, first, &image).await;
        promised = promised.max(now_promised);
        match outcome {
            Ok(()) => first += N_PER_STREAM,
            Err(status) => break status,
        }
    };
    assert_eq!(status.code(), Code::ResourceExhausted, "{status}");
    assert!(status.message().contains("room"), "{status}");

    // Reading goes on, and what was promised is there and whole.
    let session = server.get_json("/v1/sessions/s").await;
    let durable = session["durable_sequence"].as_u64();
    assert!(durable >= promised, "{durable:?} is saved, {promised:?} was promised");
    assert_eq!(session["n_frames"].as_u64(), durable.map(|sequence| sequence + 1));
    let problems = server.running().store().check().await.unwrap();
    assert!(problems.is_empty(), "{problems:?}");
}

#[tokio::test]
async fn a_database_that_is_deleted_under_the_server_is_told_and_nothing_more_is_promised() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(160, 120)).await.unwrap();
    let image = tests::raw_gray(160, 120, &[100; 160 * 120]);
    let stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
    let (promised, outcome) = stream_frames(stream, 0, &image).await;
    outcome.unwrap();
    assert_eq!(server.get("/readyz").await, "ready\n");

    std::fs::remove_file(server.folder().join(server::DATABASE_FILE)).unwrap();
    let stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
    let (now_promised, outcome) = stream_frames(stream, N_PER_STREAM, &image).await;
    let status = outcome.unwrap_err();
    assert!(status.message().contains("removed or replaced"), "{status}");
    assert_eq!(now_promised.max(promised), promised, "frames were promised that no file holds");
    let ready = reqwest::get(format!("http://{}/readyz", server.running().http_addr)).await.unwrap();
    assert_eq!(ready.status(), 503);
    assert!(ready.text().await.unwrap().contains("removed or replaced"));
    let health = async {
        let address = format!("http://{}", server.running().grpc_addr);
        let channel = tonic::transport::Channel::from_shared(address).unwrap().connect().await.unwrap();
        let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
        let service = "monoslam.v1.SlamService".to_owned();
        let asked = tonic_health::pb::HealthCheckRequest { service };
        while health.check(asked.clone()).await.unwrap().into_inner().status != NOT_SERVING {
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(std::time::Duration::from_secs(10), health).await.expect("health notices");
}

/// Of the health service's answers.
const NOT_SERVING: i32 = 2;
