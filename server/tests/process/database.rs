//! A server on PostgreSQL: killed, and with its database stopped under it. Nothing that was acknowledged is
//! lost.

use crate::crash::stream;
use crate::program::{ServerProcess, run, said};
use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use std::time::{Duration, Instant};
use store::{Store, StoreOptions};
use testkit::postgres::{Cluster, shared_database};
use tests::{FrameStream, SmallWorld, camera, create_session, open_message, raw_gray};

/// Frames in all, and frames after which the server is killed.
const N_FRAMES: usize = 120;
const KILLED_AFTER: [usize; 2] = [30, 80];

/// Starts a server on a database.
pub fn server_on(url: &str, folder: &std::path::Path) -> ServerProcess {
    ServerProcess::start_with(folder, |command| {
        command.env("MONOSLAM_STORAGE__URL", url).env("MONOSLAM_STORAGE__CONNECT_TIMEOUT_S", "1");
    })
}

/// What is wrong with a database; nothing should be.
async fn assert_sound(url: &str) {
    let store = Store::connect(url, StoreOptions::default()).await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
    store.close().await.unwrap();
}

mod postgres {
    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn a_killed_server_goes_on_in_the_same_map() {
        let (url, folder) = (shared_database(), tempfile::tempdir().unwrap());
        let world = SmallWorld::new(1);
        let mut promised = None;
        for (kill, n_frames) in KILLED_AFTER.into_iter().enumerate() {
            let server = server_on(&url, folder.path());
            let mut client = server.client().await;
            if kill == 0 {
                create_session(&mut client, "room", world.camera()).await.unwrap();
            }
            let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
            assert!(frames.opened.durable_sequence >= promised, "{promised:?} was promised");
            let next = frames.opened.next_sequence as usize;
            let answers = stream(&mut frames, &world, next, n_frames - next).await;
            promised = answers.last().and_then(|answer| answer.durable_sequence).max(promised);
            server.kill();
            assert_sound(&url).await;
        }
        assert!(promised.is_some(), "nothing was promised");
        let server = server_on(&url, folder.path());
        let mut client = server.client().await;
        let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
        assert!(frames.opened.durable_sequence >= promised);
        assert!(frames.opened.n_keyframes >= 2, "there was a map before: {:?}", frames.opened);
        let next = frames.opened.next_sequence as usize;
        let answers = stream(&mut frames, &world, next, N_FRAMES - next).await;
        frames.finish().await.unwrap();
        let is_tracked = |answer: &&v1::FrameResult| answer.state() == v1::TrackingState::Tracked;
        let n_tracked = answers.iter().filter(is_tracked).count();
        assert!(n_tracked > answers.len() / 2, "{n_tracked} of {} frames are tracked", answers.len());
        let csv = tests::get(server.http_addr, "/v1/sessions/room/trajectory?format=csv").await.unwrap();
        assert!(
            csv.lines().skip(1).all(|line| line.split(',').nth(3) == Some("0")),
            "there are several submaps"
        );
        assert!(server.terminate(), "the server ends well when asked to");
        assert_sound(&url).await;
    }

    /// A server's data folder moves to PostgreSQL and back, and the session goes on in each.
    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn a_data_folder_moves_to_postgresql_and_back() {
        let (url, folders) = (shared_database(), [(); 3].map(|()| tempfile::tempdir().unwrap()));
        let [first, second, third] = &folders;
        let world = SmallWorld::new(1);
        let server = ServerProcess::start(first.path());
        let mut client = server.client().await;
        create_session(&mut client, "room", world.camera()).await.unwrap();
        let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
        stream(&mut frames, &world, 0, 40).await;
        frames.finish().await.unwrap();
        let place = |folder: &tempfile::TempDir| format!("sqlite:{}", folder.path().display());
        let migrate = |from: &str, to: &str| run(&["migrate", "--from", from, "--to", to]);
        let output = migrate(&place(first), &url);
        assert!(
            !output.status.success() && said(&output).contains("another server uses"),
            "{}",
            said(&output)
        );
        assert!(server.terminate());

        let output = migrate(&place(first), &url);
        assert!(output.status.success() && said(&output).contains("room: copied"), "{}", said(&output));
        let server = server_on(&url, second.path());
        let mut client = server.client().await;
        let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
        let next = frames.opened.next_sequence as usize;
        assert!(next >= 40 && frames.opened.n_keyframes >= 2, "{:?}", frames.opened);
        let answers = stream(&mut frames, &world, next, 20).await;
        let is_tracked = |answer: &v1::FrameResult| answer.state() == v1::TrackingState::Tracked;
        assert!(answers.iter().any(is_tracked), "it does not find its place again");
        frames.finish().await.unwrap();
        let output = migrate(&url, &place(third));
        assert!(!output.status.success() && said(&output).contains("servers work"), "{}", said(&output));
        assert!(server.terminate());

        for words in ["room: copied", "room: is there already"] {
            let output = migrate(&url, &place(third));
            assert!(output.status.success() && said(&output).contains(words), "{}", said(&output));
        }
        crate::program::check(third.path());
        let server = ServerProcess::start(third.path());
        let request = v1::GetSessionRequest { session_id: "room".into() };
        let session = server.client().await.get_session(request).await.unwrap().into_inner();
        assert!(session.n_frames > next as u64);
        let output = migrate(&url, "mysql://h/db");
        assert!(!output.status.success() && said(&output).contains("expected"), "{}", said(&output));
        assert!(server.terminate());
    }

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn a_database_that_stops_and_starts_under_a_stream_loses_nothing() {
        let (mut cluster, folder) = (Cluster::start(), tempfile::tempdir().unwrap());
        let server = server_on(&cluster.url(), folder.path());
        let mut client = server.client().await;
        create_session(&mut client, "s", camera(160, 120)).await.unwrap();
        let image = raw_gray(160, 120, &[100; 160 * 120]);
        let mut frames = FrameStream::open(&mut client, open_message("s")).await.unwrap();
        let mut sequence = 0;
        let mut next = async |frames: &mut FrameStream| {
            frames.send(Request::Frame(tests::frame(sequence, image.clone()))).await;
            sequence += 1;
            match frames.next().await {
                Ok(Some(Response::Result(result))) => Ok(result),
                Ok(other) => panic!("unexpected answer {other:?}"),
                Err(status) => Err(status),
            }
        };
        let mut promised = None;
        let begun = Instant::now();
        while promised < Some(5) {
            promised = next(&mut frames).await.unwrap().durable_sequence;
            assert!(begun.elapsed() < Duration::from_secs(30), "nothing is saved");
        }
        cluster.stop();
        tokio::time::sleep(Duration::from_millis(100)).await;
        // Tracking goes on, and what was saved stays what it is.
        let first = next(&mut frames).await.expect("tracking goes on").durable_sequence;
        let mut status = None;
        for _ in 0..20 {
            match next(&mut frames).await {
                Ok(result) => assert_eq!(result.durable_sequence, first),
                Err(refused) => {
                    status = Some(refused);
                    break;
                }
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let ready = tests::get(server.http_addr, "/readyz").await;
        eprintln!("while the database is away: {status:?}, readyz {ready:?}");
        cluster.start_again();
        // Until what waited is saved, frames are refused.
        let begun = Instant::now();
        let (sequence, frames) = loop {
            assert!(begun.elapsed() < Duration::from_secs(30), "it does not go on");
            tokio::time::sleep(Duration::from_millis(200)).await;
            let open = v1::OpenStream { take_over: true, ..open_message("s") };
            let Ok(mut frames) = FrameStream::open(&mut client, open).await else { continue };
            let (saved, sequence) = (frames.opened.durable_sequence, frames.opened.next_sequence);
            assert!(saved >= first, "{first:?} was promised, {saved:?} is there");
            frames.send(Request::Frame(tests::frame(sequence, image.clone()))).await;
            if let Ok(Some(Response::Result(_))) = frames.next().await {
                break (sequence, frames);
            }
        };
        frames.finish().await.unwrap();
        let request = v1::GetSessionRequest { session_id: "s".into() };
        let session = client.get_session(request).await.unwrap().into_inner();
        assert_eq!(session.durable_sequence, Some(sequence));
        assert_eq!(session.n_frames, sequence + 1, "a frame is missing");
        assert!(server.terminate());
        assert_sound(&cluster.url()).await;
    }
}
