//! Damaged pages of the database: found at start, told, and the matter of the session they belong to.

use proto::v1;
use server::{Config, ErrorCode};
use sqlx::{Connection, SqliteConnection};
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
use tests::{FrameStream, SmallWorld, TestServer, create_session, open_message};
use tonic::Code;
use tonic_types::StatusExt;

/// Frames of each session: enough for a map with keyframes whose features fill pages of their own.
const N_FRAMES: usize = 30;

/// A server that has mapped two sessions, `hall` first, and was ended.
async fn two_maps() -> tempfile::TempDir {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let world = SmallWorld::new(1);
    for id in ["hall", "kitchen"] {
        let camera = world.camera();
        create_session(&mut client, id, camera).await.unwrap();
        let mut stream = FrameStream::open(&mut client, open_message(id)).await.unwrap();
        for i in 0..N_FRAMES {
            stream.send(v1::stream_frames_request::Message::Frame(world.frame(i))).await;
            stream.next().await.unwrap();
        }
        stream.finish().await.unwrap();
    }
    let (_, folder) = server.shut_down().await;
    folder
}

/// Overwrites a page of a table, the first of its kind in the order of rows, as a bad disk might.
async fn damage(folder: &Path, table: &str, kind: &str) {
    let file = folder.join(server::DATABASE_FILE);
    let mut database = SqliteConnection::connect(file.to_str().unwrap()).await.unwrap();
    let pages = "SELECT pageno FROM dbstat WHERE name = ? AND pagetype = ? ORDER BY path LIMIT 1";
    let page: i64 =
        sqlx::query_scalar(pages).bind(table).bind(kind).fetch_one(&mut database).await.expect("such a page");
    let page_bytes: i64 = sqlx::query_scalar("PRAGMA page_size").fetch_one(&mut database).await.unwrap();
    database.close().await.unwrap();
    let mut file = std::fs::File::options().write(true).open(file).unwrap();
    file.seek(SeekFrom::Start(((page - 1) * page_bytes) as u64)).unwrap();
    file.write_all(&vec![0x5a; page_bytes as usize]).unwrap();
}

async fn start(folder: &Path, change: impl FnOnce(&mut Config)) -> server::Running {
    let mut config = Config::local(folder);
    change(&mut config);
    server::Server::start(config).await.expect("damage in a session keeps no server from its others")
}

/// What comes of opening a stream.
async fn opened(running: &server::Running, id: &str) -> Result<v1::Session, tonic::Status> {
    let mut client = tests::connect(running.grpc_addr).await.unwrap();
    let stream = FrameStream::open(&mut client, open_message(id)).await?;
    let session = stream.opened.clone();
    stream.finish().await?;
    Ok(session)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_session_is_closed_and_the_others_work() {
    let folder = two_maps().await;
    damage(folder.path(), "keyframe_features", "overflow").await;
    let running = start(folder.path(), |_| {}).await;
    let ready = tests::get(running.http_addr, "/readyz").await.expect("the others are served");
    assert!(ready.starts_with("ready\n1 session is damaged"), "{ready}");
    let metrics = tests::get(running.http_addr, "/metrics").await.unwrap();
    assert!(metrics.contains("monoslam_sessions_damaged 1"), "{metrics}");

    let status = opened(&running, "hall").await.unwrap_err();
    assert_eq!(status.code(), Code::DataLoss, "{status}");
    assert_eq!(status.get_error_details().error_info().unwrap().reason, ErrorCode::SessionDamaged.name());
    assert!(status.message().contains("restore") && status.message().contains("delete"), "{status}");
    let kitchen = opened(&running, "kitchen").await.unwrap();
    assert!(kitchen.n_keyframes > 0 && kitchen.damage.is_none(), "{kitchen:?}");

    // Lists say which it is, and it can be deleted and made anew.
    let list: serde_json::Value =
        serde_json::from_str(&tests::get(running.http_addr, "/v1/sessions").await.unwrap()).unwrap();
    let damage = |i: usize| list["sessions"][i]["damage"].clone();
    assert!(damage(0).is_string() && damage(1).is_null(), "{list}");
    let mut client = tests::connect(running.grpc_addr).await.unwrap();
    client.delete_session(v1::DeleteSessionRequest { session_id: "hall".into() }).await.unwrap();
    create_session(&mut client, "hall", SmallWorld::new(1).camera()).await.unwrap();
    assert_eq!(opened(&running, "hall").await.unwrap().n_keyframes, 0);
    drop(client);
    running.shutdown().await;
    // What could not be cleared away keeps no server from starting.
    let running = start(folder.path(), |_| {}).await;
    assert!(opened(&running, "kitchen").await.is_ok());
    running.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_large_database_is_looked_at_beside_the_streams_and_what_is_found_later_counts() {
    let folder = two_maps().await;
    damage(folder.path(), "keyframe_features", "overflow").await;
    let running = start(folder.path(), |config| config.storage.check_beside_above_bytes = 0).await;
    let found = async {
        while !tests::get(running.http_addr, "/readyz").await.unwrap().contains("1 session is damaged") {
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(std::time::Duration::from_secs(30), found).await.expect("the damage is found");
    assert_eq!(opened(&running, "hall").await.unwrap_err().code(), Code::DataLoss);
    running.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn damage_that_nobody_looked_for_is_met_when_the_session_is_loaded() {
    let folder = two_maps().await;
    damage(folder.path(), "keyframe_features", "overflow").await;
    let running = start(folder.path(), |config| config.storage.check_at_start = false).await;
    assert_eq!(tests::get(running.http_addr, "/readyz").await.unwrap(), "ready\n");
    let status = opened(&running, "hall").await.unwrap_err();
    assert!(status.code() == Code::DataLoss && status.message().contains("restore"), "{status}");
    assert!(tests::get(running.http_addr, "/readyz").await.unwrap().contains("1 session is damaged"));
    assert!(opened(&running, "kitchen").await.is_ok());
    running.shutdown().await;
}
